"""The tutorial `deploy/examples/ENVIRONMENT.md`, step by step, with the commands that stand there."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mdb_deploy import Run

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"
TUTORIAL = (EXAMPLES / "ENVIRONMENT.md").read_text()
COMMANDS = [shlex.split(line) for line in re.findall(r"```sh\n(.*?)\n```", TUTORIAL, re.DOTALL)]
INIT, TRY, TEACH, EXPORT, ANALYSE = COMMANDS
(BALANCE,) = re.findall(r"```python\n(.*?)```", TUTORIAL, re.DOTALL)
BOUND_S = 110.0


def follow(command: list[str], folder: Path, run: Path | None = None) -> str:
    """Do as the tutorial says; return what was printed."""
    replaced = {
        "mdb": [sys.executable, "-m", "mdb_deploy.cli"],
        "python": [sys.executable],
        "deploy/examples/analysis.py": [str(EXAMPLES / "analysis.py")],
        "RUN": [str(run)],
    }
    words = [part for word in command for part in replaced.get(word, [word])]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=BOUND_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def run_of(printed: str) -> Path:
    (found,) = re.findall(r"^results: (.*)$", printed, re.MULTILINE)
    return Path(found)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("gymnasium")
    made = tmp_path_factory.mktemp("tutorial")
    follow(INIT, made)
    with (made / "my-cart" / "my_cart_teacher.py").open("a") as teacher:  # of step 3; here, since it is imported once
        teacher.write(f"\n\n{BALANCE}")
    return made


def test_steps_1_and_2_what_init_writes_runs_and_is_judged_by_the_reward(folder: Path) -> None:
    assert {path.name for path in (folder / "my-cart").iterdir()} >= {"experiment.toml", "my_cart_teacher.py"}
    run = Run(run_of(follow(TRY, folder)))
    feedback, event = run.iterations["feedback"], run.iterations["event"]
    assert len(feedback) == 300
    assert (feedback == np.where(event == "terminated", -1.0, 0.0)).all()


@pytest.mark.slow
def test_steps_3_and_4_a_teacher_of_one_s_own_and_what_came_of_it(folder: Path) -> None:
    path = run_of(follow(TEACH, folder))
    done = Run(path).iterations
    fallen = done["event"] == "terminated"
    assert np.nanmean(done["feedback"][400:700]) > 0.8, "it obeys"
    assert fallen[:200].sum() >= 4
    assert fallen[720:].sum() <= 2, "alone it balances"
    files = follow(EXPORT, folder, path).split()
    assert [Path(file).name for file in files] == [
        "iterations.csv", "pairs.csv", "models.csv", "contexts.csv", "scenes.csv",
    ]  # fmt: skip
    printed = follow(ANALYSE, folder, path)
    assert "alone: 300 iterations" in printed
    assert "model direct: " in printed
    assert "1000 pairs, of which 700 were judged" in printed
