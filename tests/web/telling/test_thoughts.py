"""What is told of each choice is what the brain itself foresaw, took, and said in its report."""

import importlib.util
from pathlib import Path
from typing import Any

import pytest

from mdb_deploy.web.telling.plan import MOST_SHOWN, Plan
from mdb_deploy.web.telling.thoughts import thought
from mdb_protocol import messages as m
from tests.web.telling.conftest import Made
from tests.web.telling.told import experiment_of, log_of, thoughts_of

CLOSE = 2e-4
"""Sums of a few rows and of many at once differ in single precision."""


def chosen(told: dict[str, Any]) -> dict[str, Any]:
    [only] = [action for action in told["actions"] if action["chosen"]]
    return dict(only)


def best(told: dict[str, Any]) -> float:
    return max(float(action["promise"]) for action in told["actions"])


def check_as_reported(run: Path) -> int:
    """Each thought is what the report says; return how many were foreseen."""
    foreseen = 0
    for told, report in thoughts_of(run):
        assert (told["iteration"], told["mode"], told["note"]) == (report.iteration, report.mode, report.note)
        assert chosen(told)["choice"] == report.choice
        assert chosen(told)["values"] == pytest.approx(report.action, abs=1e-6)
        assert told["came"] == {"feedback": pytest.approx(report.feedback, abs=1e-4), "event": report.event}
        assert told["why"].endswith(".")
        if report.predicted is not None:
            foreseen += 1
            assert chosen(told)["satisfaction"] == pytest.approx(report.predicted, abs=CLOSE)
            assert told["predicted"] == pytest.approx(report.predicted, abs=CLOSE)
    return foreseen


def test_bars_and_report_of_the_papers_robot_agree(pioneer: Path) -> None:
    assert check_as_reported(pioneer) >= 75
    for told, _ in thoughts_of(pioneer):
        turns = [action["values"]["turn"] for action in told["actions"]]
        assert turns == [-90.0, -45.0, -20.0, 0.0, 20.0, 45.0, 90.0]


def test_who_obeys_does_what_promises_most(pioneer: Path) -> None:
    badges = dict[str, int]()
    for told, report in thoughts_of(pioneer):
        badges[told["badge"]] = badges.get(told["badge"], 0) + 1
        assert told["badge"] == ("explores" if report.explored else "obeys" if report.note is not None else "alone")
        if told["badge"] == "obeys":
            assert chosen(told)["promise"] == pytest.approx(best(told), abs=CLOSE)
            assert told["badge_words"] == "obeys one"
            assert told["why"].startswith(f"Note {report.note}: it expects {chosen(told)['promise']:+.2f} of '")
        elif told["badge"] == "alone":
            assert chosen(told)["promise"] >= best(told) - 0.2 - CLOSE  # the mode's margin
            assert told["badge_words"] == "on its own, by what it learnt from one"
            assert told["why"].startswith("No teacher is there. It ")
        elif report.iteration < 25:
            assert told["why"] == "The first 25 iterations are random, so that it sees everything once."
        elif report.mode == "random":
            assert told["why"] == f"It can foresee nothing here, so it tries '{chosen(told)['name']}' by chance."
        else:
            assert told["why"].startswith(f"Note {report.note}: it tries '{chosen(told)['name']}': ")
    assert set(badges) == {"explores", "obeys", "alone"}


@pytest.mark.parametrize(
    ("name", "needs", "choices"),
    [
        ("cartpole", "gymnasium", True),
        ("pendulum", "gymnasium", False),
        ("arm", "pybullet", False),
        ("reacher", "mujoco", False),
    ],
)
def test_other_machines_are_told_as_they_are(run_of: Made, name: str, needs: str, choices: bool) -> None:
    if importlib.util.find_spec(needs) is None:
        pytest.skip(f"{needs} is not installed")
    run = run_of(name, "experiment.iterations=40", "optimizer.random_iterations=15", "teacher.phase.alone.start=30")
    assert check_as_reported(run) >= 30
    for told, _ in thoughts_of(run):
        values = [tuple(action["values"].values()) for action in told["actions"]]
        assert values == sorted(values)
        assert len(values) == len(set(values))
        assert len(values) in ((2,) if choices else range(MOST_SHOWN - 2, MOST_SHOWN + 1))  # two may be of the spread
        if told["badge"] == "obeys":
            assert chosen(told)["promise"] >= best(told) - 0.1  # a few more points were looked at here


def test_what_is_not_known_is_left_out(pioneer: Path) -> None:
    """An action of models that are gone, one without an intention, one that is none of the experiment's."""
    plan = Plan(experiment_of(pioneer))
    actions = [each.message for each in log_of(pioneer) if isinstance(each.message, m.Action)]
    last = [action for action in actions if action.intention and not action.intention.explored][-1]
    told = thought(plan, last, {})
    assert chosen(told)["satisfaction"] == told["predicted"]
    assert {action["promise"] for action in told["actions"]} == {None}
    assert "not known here" in told["why"]
    bare = m.Action(iteration=3, action={"turn": 0.0}, choice=0, valid_for_s=1.0)
    assert thought(plan, bare, {})["why"] == "It does 'ahead'."
    other = m.Action(iteration=3, action={"fly": 0.0}, choice=99, valid_for_s=1.0)
    assert not any(action["chosen"] for action in thought(plan, other, {})["actions"])
