"""The template: of what services are forks; each scenario has a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="a template needs Linux")


@pytest.mark.parametrize("what", ["speaks", "serves", "gives", "leaves", "stays_alone", "dies", "freezes", "is_late"])
def test_a_service_that_is_a_fork(what: str, tmp_path: Path) -> None:
    command = [sys.executable, "-P", "-m", "tests.deploy.template_user", what, str(tmp_path)]
    paths = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": paths}
    done = subprocess.run(command, capture_output=True, text=True, timeout=150, env=environment, check=False)
    log = tmp_path / "log"
    assert done.returncode == 0, done.stderr + (log.read_text() if log.exists() else "")
