"""Runs are read and never written: of another user, of a brain that is at work; and words in them stay words."""

import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console

from mdb_deploy.cli.main import main
from mdb_deploy.running import status
from mdb_deploy.runs import ltm
from mdb_deploy.trials.evidence import Findings
from mdb_protocol import codec, messages
from mdb_protocol.errors import TakenError
from mdb_services.experiment.run_folder import MEMORY_FILE
from mdb_services.memory.file import MemoryFile
from mdb_services.memory.reading import opened
from tests.edges.trial import GOLDEN
from tests.edges.trial import run as in_a_fork
from tests.services import languages
from tests.services.languages import Student
from tests.services.store_rig import ITERATIONS, Rig, taken


def lived(path: Path) -> Rig:
    """A store at work, with models in its long-term memory."""
    rig = Rig(path, languages.config(experiment={"pace": "concurrent", "iterations": ITERATIONS}))
    student = Student()
    for i in range(60):
        rig.give(languages.pair(i, "A"))
        for change in taken(rig.changes):
            rig.show(student.follow(change))
    return rig


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return Path(shutil.copytree(GOLDEN, tmp_path / "run"))


@pytest.fixture
def anothers(run: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A run in a folder in which nobody may write, seen from a folder of our own."""
    lived(run / MEMORY_FILE).store.close()
    (run / f"{MEMORY_FILE}-lock").unlink()
    for path in run.iterdir():
        path.chmod(0o444)
    run.chmod(0o555)
    own = run.parent / "own"
    own.mkdir()
    monkeypatch.chdir(own)
    yield run
    run.chmod(0o755)


def powerless(words: list[str]) -> subprocess.CompletedProcess[str]:
    """Run `mdb`; for it a folder without a right to write is one, also where the tests are root's."""
    command = [sys.executable, "-m", "mdb_deploy.cli", *words]
    return subprocess.run(
        command, preexec_fn=without_powers, capture_output=True, text=True, timeout=100, check=False
    )


def without_powers() -> None:
    """Give up root's powers over files, for whatever is executed now, too (prctl(2), capset(2) version 3)."""
    library = ctypes.CDLL(None, use_errno=True)
    secure_bits, no_root = 28, 0b11
    head, none = (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
    if (os.geteuid() == 0 and library.prctl(secure_bits, no_root)) or library.capset(head, none):
        raise OSError(ctypes.get_errno(), "the powers of root cannot be given up")


def looks(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize(
    "words",
    [
        "ltm list RUN",
        "ltm show RUN",
        "ltm export RUN --out x.ltm",
        "export RUN",
        "plot RUN",
        "replay RUN robot --tolerance 1e-9",
    ],
)
def test_a_run_in_a_folder_that_takes_nothing_is_read_and_nothing_in_it_changes(anothers: Path, words: str) -> None:
    before = looks(anothers)
    done = powerless([str(anothers) if word == "RUN" else word for word in words.split()])
    assert done.returncode == 0, done.stdout + done.stderr
    assert looks(anothers) == before


def test_a_brain_at_work_is_read_and_its_memory_not_touched(tmp_path: Path) -> None:
    path = tmp_path / MEMORY_FILE
    rig = lived(path)
    assert path.with_name(f"{MEMORY_FILE}-wal").stat().st_size > 0
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir() if not file.name.endswith("-shm")}
    with opened(path) as file:
        assert [row[0] for row in file.rows("SELECT count(*) FROM pair")] == [60]
    models = ltm.read(tmp_path)
    assert models
    assert list(map(codec.encode, models)) == list(map(codec.encode, rig.store._file.long_term()))
    after = {file.name: file.read_bytes() for file in tmp_path.iterdir() if not file.name.endswith("-shm")}
    assert after == before
    rig.store.close()


def test_a_memory_file_has_one_writer_and_who_brings_models_to_it_is_refused(run: Path, tmp_path: Path) -> None:
    exported = tmp_path / "x.ltm"
    at_work = MemoryFile(run / MEMORY_FILE)
    with pytest.raises(TakenError, match="another process writes"):
        MemoryFile(run / MEMORY_FILE)
    lived(tmp_path / MEMORY_FILE).store.close()
    assert ltm.export(tmp_path, (), exported) > 0
    code, said, *_ = in_a_fork(["ltm", "import", str(exported), str(run)])
    assert code == 2
    assert "models:" not in said
    at_work.close()
    MemoryFile(run / MEMORY_FILE).close()


@pytest.mark.parametrize(
    "name", ["[/bad]", "\x1b[2J", "[link=http://x]a[/link]", ":smile:", "\u202eabc", "x" * 100_000]
)
def test_a_status_shows_words_as_words(name: str) -> None:
    said = messages.Status(
        role="robot", instance="body", pid=1, uptime_s=1.0, values={name: 1.0}, refused={name: 2}, dropped={}
    )
    console = Console(width=200, record=True, file=open(os.devnull, "w"))  # noqa: SIM115 - it ends with the console
    console.print(status._tables({name: [status.Row(f"robot/{name}", said), status.Row("a/b", None, name)]}, name))
    text = console.export_text()
    assert not any(letter in text for letter in "\x1b\u202e")
    assert ("[/bad]" in text) == (name == "[/bad]")
    assert (":smile:" in text) == (name == ":smile:")
    assert len(text) < 100_000


def test_an_error_is_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ltm", "list", str(tmp_path / "\x1b[2J\u202e")]) == 2
    said = capsys.readouterr().err
    assert "\x1b" not in said
    assert "\\x1b[2J\\u202e" in said


def test_a_witness_who_heard_nothing_confirms_nothing() -> None:
    assert not Findings(acknowledged=0, stored=9, lost=[], altered=[], doubled=[], missing=[]).holds
