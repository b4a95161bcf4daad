"""`deploy/compose` as it is, in small checkouts of its own: it finds itself, and checks its environment each time.

The packages that the project needs are lent by PYTHONPATH from those of this test, so nothing is downloaded.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]

ROOT = Path(__file__).parents[2]
PARTS = ("protocol", "services", "sim", "deploy", "README.md", "LICENSE", "pyproject.toml")
LENT = sysconfig.get_path("purelib")
BOUND_S = 180.0
TOLD = "import mdb_deploy, sys; print(mdb_deploy.__file__); print(sys.prefix)"


def checkout(at: Path) -> Path:
    """Make a checkout of this project's code in which nothing has to be downloaded."""
    at.mkdir(parents=True)
    leave = shutil.ignore_patterns("__pycache__", "gallery", "*.egg-info")
    for part in PARTS:
        source = ROOT / part
        shutil.copytree(source, at / part, ignore=leave) if source.is_dir() else shutil.copy(source, at / part)
    (at / "requirements").mkdir()
    for name in ("brain", "pybullet"):
        (at / "requirements" / f"{name}.txt").write_text("# all is lent\n")
    return at


def compose(script: Path, *words: str, cwd: Path | None = None, **env: str) -> subprocess.CompletedProcess[str]:
    """Run a checkout's script; the compiler is switched off, for kernels are not what is tried here."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MDB_", "UV_", "LC_"))}
    environment |= {"PYTHONPATH": LENT, "MDB_PYTHON": sys._base_executable, "NUMBA_DISABLE_JIT": "1"} | env  # type: ignore[attr-defined]
    command = ["bash", str(script), *words]
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=BOUND_S, check=False
    )


def works(root: Path, *, script: Path | None = None, cwd: Path | None = None, **env: str) -> str:
    """Have a checkout's script print the version; return what it said. Its own code must have run."""
    done = compose(script or root / "deploy" / "compose", "--version", cwd=cwd, **env)
    assert done.returncode == 0, done.stderr
    assert f"{root.resolve()}/.venv/bin/python" in done.stdout
    python = root / ".venv" / "bin" / "python"
    told = subprocess.run(
        [python, "-P", "-c", TOLD], capture_output=True, text=True, check=True, env={"LC_ALL": "C.UTF-8"}
    ).stdout
    package, prefix = told.splitlines()
    assert Path(package).parents[2] == root.resolve(), "the code of this checkout"
    assert Path(prefix) == root.resolve() / ".venv"
    return done.stderr


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkout that is set up."""
    root = checkout(tmp_path_factory.mktemp("there") / "project")
    assert "making an environment" in works(root)
    return root


@pytest.mark.edge("the script finds itself", "CDPATH exported; called by a relative path")
def test_cdpath(made: Path) -> None:
    assert works(made, script=Path("deploy/compose"), cwd=made, CDPATH=f"{made.parent}:{made}:/") == ""


@pytest.mark.edge("the script finds itself", "reached by links: relative, of a link, from another folder")
def test_links(made: Path, tmp_path: Path) -> None:
    (tmp_path / "first").symlink_to(made / "deploy" / "compose")
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "mdb-compose").symlink_to("../first")
    assert works(made, script=tmp_path / "bin" / "mdb-compose", cwd=tmp_path) == ""


@pytest.mark.edge("the environment is checked, not assumed", "set-up interrupted before pip was there, then again")
def test_interrupted(made: Path) -> None:
    shutil.rmtree(next((made / ".venv" / "lib").glob("python*/site-packages/pip")))
    assert "it has no pip" in works(made)
    assert works(made) == ""


@pytest.mark.edge("the environment is checked, not assumed", "Python taken away; replaced by another")
def test_python_replaced(made: Path) -> None:
    library = next((made / ".venv" / "lib").glob("python*"))
    library.rename(library.with_name("python3.9"))
    assert "is another than it was made with" in works(made)
    for link in (made / ".venv" / "bin").glob("python*"):
        link.unlink()
        link.symlink_to("/nowhere/python")
    assert "its Python is gone" in works(made)


@pytest.mark.edge("the environment is checked, not assumed", "a copied checkout, with its environment")
def test_copied(made: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(made, copy, symlinks=True)
    assert "moved or copied" in works(copy)
    assert works(made) == "", "the original's is left as it was"


@pytest.mark.edge("the environment is checked, not assumed", "MDB_VENV is a folder of something else")
def test_a_folder_of_something_else_is_left_alone(made: Path, tmp_path: Path) -> None:
    (tmp_path / "letters").write_text("mine")
    done = compose(made / "deploy" / "compose", "--version", MDB_VENV=str(tmp_path))
    assert done.returncode == 2
    assert "is no environment of Python's" in done.stderr
    assert (tmp_path / "letters").read_text() == "mine"


@pytest.mark.edge("the environment is checked, not assumed", "PYTHONPATH has another copy of the project")
def test_another_copy_on_the_path(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "deploy" / "mdb_deploy", tmp_path / "mdb_deploy")
    done = compose(made / "deploy" / "compose", "--version", PYTHONPATH=f"{tmp_path}:{LENT}")
    assert done.returncode == 2
    assert "take it out of PYTHONPATH" in done.stderr


@pytest.mark.edge("locale, path", "below folders named é and 'with spaces', LC_ALL=C; moved there")
def test_a_path_beyond_ascii(made: Path, tmp_path: Path) -> None:
    there = tmp_path / "é" / "with spaces"
    there.parent.mkdir()
    made.rename(there)
    try:
        assert "moved or copied" in works(there, LC_ALL="C")
        assert works(there, LC_ALL="C") == ""
    finally:
        there.rename(made)
