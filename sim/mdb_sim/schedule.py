"""Who teaches when and in which language: the phases of an experiment.

Owns the `[teacher]` section. Pure: what is wanted and how an action is judged is in `teacher`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from msgspec import Meta

from mdb_services.config import Name, Section
from mdb_sim.robot import Placement, RobotConfig
from mdb_sim.teacher import Language, graded_feedback, wanted_action


class PhaseSection(Section, frozen=True, kw_only=True):
    """`[[teacher.phase]]`: from iteration `start` on; without a teacher the robot is alone."""

    start: Annotated[int, Meta(ge=0)]
    name: Annotated[str, Meta(min_length=1, max_length=100)]
    teacher: Name | None = None
    language: str | None = None
    """"ordered", "reversed", "paper", or "random": a permutation drawn from the run's seed and the teacher."""


class TeacherSection(Section, frozen=True, kw_only=True):
    """`[teacher]`: how the scripted teacher judges, and its phases."""

    feedback: Literal["graded", "binary"] = "graded"
    phase: Annotated[tuple[PhaseSection, ...], Meta(min_length=1)]
