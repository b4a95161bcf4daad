"""Every space that an experiment file can ask for keeps the `Space` contract."""

import sys

import pytest

from mdb_services.mechanism.actions.spaces import SEARCHES, Ranges
from tests.conformance.space_conformance import ChoicesConformance, RangesConformance, flat, rng

TURN = {"turn": (-90.0, 90.0)}
TURNS = tuple({"turn": turn} for turn in (0.0, -20.0, -45.0, -90.0, 20.0, 45.0, 90.0))
WHEELS = {"left": (-1.0, 1.0), "right": (-0.5, 0.5)}
DRIVES = tuple(
    {"left": left, "right": right} for left, right in [(1, 0.5), (-1, -0.5), (1, -0.5), (0, 0), (0.2, 0.1), (0, 0)]
)
ARM = {"shoulder": (-1.5, 0.5), "elbow": (0.0, 1.0), "speed": (0.0, 20.0)}


class TestTurns(ChoicesConformance):
    """The paper's choices: one actuator."""

    ends = TURN
    choices = TURNS


class TestDrives(ChoicesConformance):
    """Choices of several actuators, two of them the same action."""

    ends = WHEELS
    choices = DRIVES


class RangesOfOne(RangesConformance):
    ends = TURN


class RangesOfThree(RangesConformance):
    ends = ARM
    near, never = 0.1, 0.35


class TestRefineOne(RangesOfOne):
    method = "refine"


class TestRefineThree(RangesOfThree):
    method = "refine"


class TestCmaOne(RangesOfOne):
    method = "cma"


class TestCmaThree(RangesOfThree):
    method = "cma"


@pytest.mark.parametrize("suites", [RangesOfOne, RangesOfThree])
def test_every_search_runs_the_suite(suites: type[RangesConformance]) -> None:
    assert SEARCHES.keys() == {suite.method for suite in suites.__subclasses__()}


def test_without_cmaes_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cmaes", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install .*\[learners\]"):
        Ranges(ARM, "cma", 64).look(flat, rng())
