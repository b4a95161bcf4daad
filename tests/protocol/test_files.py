"""Files of others are opened within bounds, and their words are shown as words."""

import os
import stat
from pathlib import Path

import pytest

from mdb_protocol import files
from mdb_protocol.errors import DamageError
from mdb_protocol.words import MOST, shown


def test_a_file_is_read_whole_and_not_beyond_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"x" * 100)
    assert files.content(path, 100) == b"x" * 100
    with pytest.raises(DamageError, match="has 100 bytes; at most 99 bytes are read"):
        files.content(path, 99)
    with pytest.raises(FileNotFoundError):
        files.content(tmp_path / "none")


def test_a_file_that_says_it_is_empty_and_is_not_has_its_bound_too() -> None:
    with pytest.raises(DamageError, match="more than 10 bytes"):
        files.content(Path("/proc/self/maps"), 10)


def test_what_is_no_file_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, kind in ((tmp_path, "a folder"), (tmp_path / "pipe", "a named pipe"), (Path("/dev/zero"), "a device")):
        with pytest.raises(DamageError, match=f"is {kind}, and is not read"):
            files.content(path)


def test_a_copy_ends_at_the_first_hole_and_is_ours(tmp_path: Path) -> None:
    path, copied = tmp_path / "a", tmp_path / "b"
    path.write_bytes(b"x" * 8192)
    path.chmod(0o444)
    os.truncate(path, 2**33)
    files.copy(path, copied)
    assert copied.read_bytes() == b"x" * 8192
    assert copied.stat().st_mode & stat.S_IWUSR


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("plain, and größer: 観測", "plain, and größer: 観測"),
        ("[/bad] :smile:", "[/bad] :smile:"),
        ("\x1b[2J\x07\r\n", "\\x1b[2J\\x07\\r\\n"),
        ("\x9b31m", "\\x9b31m"),
        ("abc\u202edef\u2066", "abc\\u202edef\\u2066"),
        ("a\u200bb\ufeff\u2028", "a\\u200bb\\ufeff\\u2028"),
        ("\ud800", "\\ud800"),
        ("e" + "\u0301" * 1000, "e" + "\u0301" * 4),
        (7, "7"),
    ],
)
def test_words_are_shown_as_what_they_are(text: object, seen: str) -> None:
    assert shown(text) == seen


def test_long_words_are_cut_and_lines_stay_where_they_are_wanted() -> None:
    assert shown("x" * (MOST + 5)) == "x" * MOST + "... (5 more characters)"
    assert shown("one\ntwo\x1b", lines=True) == "one\ntwo\\x1b"


def test_a_lock_is_made_and_kept_and_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    for _ in range(2):
        files.lock_file(path).close()
    path.write_text("kept")
    files.lock_file(path).close()
    assert path.read_text() == "kept"
    link, pipe = tmp_path / "link", tmp_path / "pipe"
    link.symlink_to(path)
    os.mkfifo(pipe)
    with pytest.raises(OSError, match="symbolic links"):
        files.lock_file(link)
    with pytest.raises(DamageError, match="no ordinary file"):
        files.lock_file(pipe)
