"""Caches are optional: what cannot be kept, or read again, is compiled."""

import subprocess
import sys
from pathlib import Path

import pytest

COMPILE = """
from mdb_services.mechanism.evolution.compiling import compiled
space = {}
path = sys.argv[1]
exec(compile(open(path).read() if path != "nowhere.py" else TEXT, path, "exec"), space)
print(compiled(space["double"])(21))
"""
TEXT = "def double(x):\n    return 2 * x\n"
CODE = f"import sys\nTEXT = {TEXT!r}\n{COMPILE}"


def doubled(path: str, cache: str) -> None:
    environment = {"NUMBA_CACHE_DIR": cache, "HOME": "/proc/nowhere", "PYTHONPATH": ":".join(filter(None, sys.path))}
    command = [sys.executable, "-c", CODE, path]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60.0, check=False)
    assert (done.stdout, done.returncode) == ("42\n", 0), done.stderr


@pytest.mark.edge("caches are optional", "no folder can be written: no home, a read-only checkout")
def test_without_any_place_it_is_compiled_each_time() -> None:
    doubled("nowhere.py", "/proc/nowhere")


@pytest.mark.edge("caches are optional", "what was kept is damaged: emptied, cut short, other bytes")
@pytest.mark.parametrize("damage", [b"", b"\x80\x04", b"nothing of numba's"])
def test_what_is_damaged_is_compiled_again(damage: bytes, tmp_path: Path) -> None:
    source, cache = tmp_path / "source.py", tmp_path / "cache"
    source.write_text(TEXT)
    doubled(str(source), str(cache))
    kept = [path for path in cache.rglob("*.nb*") if path.is_file()]
    assert {path.suffix for path in kept} == {".nbi", ".nbc"}, "an index and the code"
    for path in kept:
        path.write_bytes(damage)
    doubled(str(source), str(cache))


@pytest.mark.edge("caches are optional", "its disk is full when it is written")
def test_a_cache_that_cannot_be_written_is_left_out(tmp_path: Path) -> None:
    source, cache = tmp_path / "source.py", tmp_path / "cache"
    source.write_text(TEXT)
    doubled(str(source), str(cache))
    for path in [path for path in cache.rglob("*.nb*") if path.is_file()]:
        path.unlink()
        path.mkdir()  # neither read nor written, also by root
    doubled(str(source), str(cache))
