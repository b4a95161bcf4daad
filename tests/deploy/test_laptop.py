"""A teacher's laptop: the base packages are enough to teach by a script, and what is missing is said."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXTRAS = {
    "cryptography", "mcap", "numba", "psutil", "yaml", "rich", "tomli_w", "zstandard", "matplotlib", "pybullet",
    "cmaes", "textual", "sounddevice", "swift_f0",
}  # fmt: skip
WITHOUT = f"""
import sys
class Gone:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {sorted(EXTRAS)}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name.partition(".")[0])
sys.meta_path.insert(0, Gone())
"""


def run(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run code as on a machine on which only the base packages are installed."""
    command = [sys.executable, "-c", WITHOUT + code, *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)


def test_the_extras_are_those_that_pyproject_names() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    base = {name.partition(">=")[0] for name in project["dependencies"]}
    assert base == {"eclipse-zenoh", "msgpack", "msgspec", "numpy", "structlog"}


@pytest.mark.long
def test_a_scripted_teacher_needs_the_base_packages_only() -> None:
    script = ROOT / "deploy" / "examples" / "teacher.py"
    done = run(f"import runpy; runpy.run_path({str(script)!r})", "tcp/127.0.0.1:1", "1")
    assert "BusError: no router answers at tcp/127.0.0.1:1" in done.stderr, "all imports went well"


@pytest.mark.parametrize(
    ("words", "extra"), [(["teach"], "teach"), (["status"], "brain"), (["up"], "brain"), (["keys", "init"], "brain")]
)
def test_what_is_missing_is_said_with_its_remedy(words: list[str], extra: str, tmp_path: Path) -> None:
    where = f"import os; os.chdir({str(tmp_path)!r})"
    code = f"{where}; from mdb_deploy.cli.main import main; raise SystemExit(main({words}))"
    done = run(code)
    assert done.returncode == 2, done.stderr
    assert f"multilevel-darwinist-brain[{extra}]" in done.stderr
    assert "Traceback" not in done.stderr
