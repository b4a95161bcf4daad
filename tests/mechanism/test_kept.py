"""The compiled code is made once and kept on disk; see also `tests/edges/test_caches.py`."""

import fcntl
import os
import platform
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from mdb_services.mechanism.evolution import kept
from mdb_services.mechanism.evolution.kept import Kept
from tests.edges.test_caches import CODE, LEARN

KEPT_ONLY = "from mdb_services.mechanism.evolution import native; native.load(compiling=False)"


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Kept:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    return Kept("evolution-1.code")


def python(code: str, bound_s: float = 110.0, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": ":".join(filter(None, sys.path))} | variables
    environment.pop("PYTEST_DISABLE_PLUGIN_AUTOLOAD", None)  # `mdb test` names its own
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=bound_s, check=False)


def test_who_may_not_compile_says_that_nothing_is_kept(tmp_path: Path) -> None:
    assert python(KEPT_ONLY, NUMBA_CACHE_DIR=str(tmp_path)).stderr.strip().endswith("NotKeptError")


def test_who_finds_the_code_kept_does_without_the_compiler() -> None:
    code = f"import sys\n{LEARN}\nprint('numba' in sys.modules)"
    python(code)  # it may have to compile
    done = python(code)
    assert done.stdout == "True\nFalse\n", done.stderr


def test_what_is_kept_is_read_again(cache: Kept) -> None:
    assert cache.read() is None
    cache.write(CODE)
    assert cache.read() == CODE
    assert [path.name for path in cache.places[0].parent.iterdir()] == ["evolution-1.code"]


def test_only_one_process_compiles_and_the_others_take_what_it_made(cache: Kept) -> None:
    order: list[str] = []

    def other() -> None:
        with Kept("evolution-1.code").alone():
            order.append("other")

    with cache.alone():
        waiting = threading.Thread(target=other)
        waiting.start()
        waiting.join(0.3)
        order.append("first")
    waiting.join(30)
    assert order == ["first", "other"]


def test_who_compiles_and_is_frozen_is_not_waited_for_without_end(
    cache: Kept, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept, "WAIT_S", 0.2)
    cache.write(CODE)
    with cache.places[0].with_suffix(".lock").open("wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with cache.alone():
            assert cache.read() == CODE


@pytest.mark.long
@pytest.mark.skipif(platform.machine() != "x86_64", reason="names processors of this kind")
@pytest.mark.timeout(300)
@pytest.mark.parametrize("processor", ["haswell +avx2,+fma,+avx,+sse4.2,+sse2,+bmi2,+popcnt", "generic"])
def test_on_processors_with_narrower_vectors_all_is_the_same(processor: str, tmp_path: Path) -> None:
    name, _, features = processor.partition(" ")
    variables = {"NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_CPU_NAME": name}
    if features:
        variables["NUMBA_CPU_FEATURES"] = features
    files = [str(Path(__file__).with_name(name)) for name in ("test_kernel.py", "test_operators.py")]
    words = ["-q", "-p", "no:cacheprovider", "-k", "kernel or threads", *files]
    code = f"import sys, pytest; sys.exit(pytest.main({words}))"
    done = python(code, 280.0, **variables)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [path.suffix for path in tmp_path.iterdir() if path.suffix == ".code"] == [".code"]
