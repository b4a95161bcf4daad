"""Which studies there are: names, what they are about, usual seeds. Plain data, which the command line can afford.

What each compares is in `tables`, what is shown of it in `report.sections`.
"""

from __future__ import annotations

from dataclasses import dataclass

PHASE = 500
"""Iterations of a phase (paper, section 3)."""


@dataclass(frozen=True)
class Study:
    """A named comparison over many seeds."""

    name: str
    what: str
    seeds: str
    own_schedule: bool = False
    """Whether it makes its own phases, all of one length, in the place of the file's."""


@dataclass(frozen=True)
class Variant:
    """An experiment file with something changed, or with another player than the brain."""

    name: str
    overrides: tuple[str, ...] = ()
    player: str = "brain"
    """Who plays, see `running.BRAIN`."""
    applies: bool = True
    """Whether there is anything to change in this experiment."""
    file: str | None = None
    """The shipped experiment in whose place it is run; None: the one that is asked for."""


REPORTED = (
    Study("reproduction", "figures 4 to 6 of the paper, with graded and with binary reward", "4101-4150"),
    Study("paper", "the paper as written, and what each of our additions brings", "4101-4106"),
    Study("teachers", "teachers as they are: late, wrong, silent, binary, relative", "4101-4104"),
    Study("learners", "other learners in the closed loop, and players without our mechanism", "4101-4104"),
    Study("memory", "teachers A, B, A, B, A, who err or not, with long-term memory and without", "4101-4104", True),
    Study("life", "five teachers in a row, and the robot alone after each", "4101-4106", True),
    Study("alone", "the goal: each phase alone against that seed's ideal", "4101-4200"),
)
"""What the report is made of, in its order."""
STUDIES = {
    study.name: study
    for study in (
        *REPORTED,
        Study("ablation", "as shipped against one ingredient less: table and figure", "11-20"),
        Study("readapt", "a body that changes: before, at, after; learning on and off", "6101-6110"),
        Study("machines", "machines taught by an experiment file alone: how long, and how good alone", "5301-5305"),
        Study(
            "rivals", "the same machines by others: Stable-Baselines3 from reward, a TAMER-like learner", "5301-5305"
        ),
        Study("comings", "teachers A, B, A, B, A: how fast one who comes back is obeyed again", "11-20", True),
    )
}
"""The studies of `mdb study`, by name."""
ACCEPTANCE = Study("acceptance", "many seeds, judged by the acceptance table", "1-5")
