"""Caches are optional: what cannot be kept, or read again, is compiled."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mdb_services.mechanism.evolution.kept import Kept

CODE = bytes(range(256)) * 100
LEARN = """
import numpy as np
from mdb_services.mechanism.learners import make_learner
from mdb_services.mechanism.networks.network import Shape
from mdb_services.mechanism.settings import EvolutionConfig
learner, rows = make_learner("pbga", Shape(1, (1,), 1), EvolutionConfig(), 0, "test"), np.zeros((2, 1), np.float32)
print(learner.learn(rows, rows, version=0).error < 1)
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Kept:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    return Kept("evolution-1.code")


def python(code: str, cache: str) -> subprocess.CompletedProcess[str]:
    environment = {"NUMBA_CACHE_DIR": cache, "HOME": "/proc/nowhere", "PYTHONPATH": ":".join(filter(None, sys.path))}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=110.0, check=False)


@pytest.mark.long
@pytest.mark.edge("caches are optional", "no folder can be written: no home, a read-only checkout")
def test_without_any_place_it_is_compiled_each_time() -> None:
    done = python(LEARN, "/proc/nowhere")
    assert (done.stdout, done.returncode) == ("True\n", 0), done.stderr


@pytest.mark.edge("caches are optional", "what was kept is damaged: emptied, cut short, other bytes")
@pytest.mark.parametrize("damaged", [b"", b"\x80\x04", bytes(4), b"nothing of ours", CODE])
def test_what_is_damaged_is_as_if_it_were_not_kept(damaged: bytes, cache: Kept) -> None:
    cache.write(CODE)
    whole = cache.places[0].read_bytes()
    for bad in (damaged, whole[:-1], whole[:2], whole[:9000] + b"?" + whole[9001:]):
        cache.places[0].write_bytes(bad)
        assert cache.read() is None
    cache.write(CODE)
    assert cache.read() == CODE


@pytest.mark.edge("caches are optional", "its disk is full when it is written")
def test_a_disk_that_is_full_keeps_nothing(cache: Kept) -> None:
    cache.places[0].parent.mkdir()
    cache.places[0].with_suffix(f".{os.getpid()}").symlink_to("/dev/full")  # where it is written first
    cache.write(CODE)
    assert cache.read() is None
    assert list(cache.places[0].parent.iterdir()) == []


@pytest.mark.edge("caches are optional", "a folder stands in its place, or its folder cannot be made")
def test_a_place_that_cannot_be_written_is_left_out(cache: Kept) -> None:
    cache.places[0].mkdir(parents=True)  # neither read nor written, also by root
    cache.write(CODE)
    assert cache.read() is None
    cache.places = [Path("/proc/nowhere/evolution-1.code")]
    cache.write(CODE)
    assert cache.read() is None
    with cache.alone():
        pass
