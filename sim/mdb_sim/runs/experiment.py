"""The whole experiment file: the brain's part, the robot and its world, the teacher and the phases.

Owns the sections that only the simulation reads, and the builders of its two services.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import msgspec
import tomli_w
from msgspec import Meta

from mdb_protocol.bus import Bus
from mdb_protocol.errors import ConfigError
from mdb_services.experiment.brain import BrainConfig, brain_config
from mdb_services.experiment.sections import Section
from mdb_services.experiment.reading import convert, read_file
from mdb_sim.body import Robot, RobotConfig, RobotError, make_robot
from mdb_sim.robot.service import RobotService
from mdb_sim.teaching.schedule import TeacherSection, schedule_of
from mdb_sim.teaching.sound import Player
from mdb_sim.robot.state_file import StateFile
from mdb_sim.teaching.service import ScriptedTeacher

ROBOT_FILE = "robot.state"
"""Where the robot was, in a run folder."""


class RobotSection(Section, frozen=True, kw_only=True):
    """`[robot]`: which body, how fast, and its world."""

    body: str = "pybullet"
    """"pybullet", "kinematic", or "package.module:Factory"."""
    action_s: Annotated[float, Meta(ge=0, le=60)] = 0.05
    """In the concurrent pace an action takes at least this long (a real Pioneer 2: about 1.1 s)."""
    world: RobotConfig = msgspec.field(default_factory=RobotConfig)


class Simulation(msgspec.Struct, frozen=True, kw_only=True):
    """The simulation's part of an experiment file."""

    robot: RobotSection = msgspec.field(default_factory=RobotSection)
    teacher: TeacherSection | None = None


class Experiment:
    """An experiment file, read and checked: `brain` for the services, `robot` and `teacher` for the simulation."""

    def __init__(self, content: dict[str, Any], source: object) -> None:
        """Take a file's content; ConfigError names what is wrong, where, and what was expected."""
        known = {*BrainConfig.__struct_fields__, *Simulation.__struct_fields__}
        for name in content:
            if name not in known:
                raise ConfigError(f"{source}: unknown section {name!r}; sections are {', '.join(sorted(known))}")
        self.content = content
        self.brain = brain_config(content, source)
        simulation = convert(content, Simulation, source)
        self.robot, self.teacher = simulation.robot, simulation.teacher
        actions, turns = self.brain.optimizer.actions, len(self.robot.world.turns_deg)
        if self.robot.body in ("pybullet", "kinematic") and actions != turns:
            raise ConfigError(f"{source}: optimizer.actions is {actions}, but robot.world.turns_deg has {turns}")
        if self.teacher is not None:
            try:
                schedule_of(self.teacher, self.brain.experiment.seed, self.robot.world)
            except ValueError as error:
                raise ConfigError(f"{source}: teacher: {error}") from error
            if self.teacher.sound is not None and self.brain.ear is None:
                raise ConfigError(f"{source}: teacher.sound needs an [ear]; --set ear.detector=template gives it one")

    @classmethod
    def read(cls, path: Path, overrides: Iterable[str] = ()) -> Experiment:
        """Read a file with overrides applied; see `reading.read_file`."""
        return cls(read_file(path, overrides), path)

    def write(self, path: Path) -> None:
        """Write the resolved experiment, overrides included: what a run folder keeps."""
        path.write_text(tomli_w.dumps(self.content), encoding="utf-8")

    def body(self, *, gui: bool = False) -> Robot:
        """Make the robot's body; ConfigError when it cannot be had."""
        try:
            return make_robot(self.robot.body, self.robot.world, gui=gui)
        except RobotError as error:
            raise ConfigError(str(error)) from error

    def robot_service(self, bus: Bus, run: Path | None = None, *, gui: bool = False) -> RobotService:
        """Build the robot, with its state kept in the run folder; ConfigError when the body cannot be had."""
        body = self.body(gui=gui)
        action_s = 0.0 if self.brain.lockstep else self.robot.action_s
        power_safe = self.brain.store.durability == "power"
        file = StateFile(run / ROBOT_FILE, power_safe=power_safe) if run is not None else None
        return RobotService(bus, body, self.brain.experiment.seed, action_s, file)

    @property
    def scripted_teachers(self) -> frozenset[str]:
        """The liveliness tokens of the teachers who belong to the experiment; empty without a `[teacher]`."""
        script = f"{ScriptedTeacher.role}/{ScriptedTeacher.instance}"
        return frozenset({script}) if self.teacher is not None else frozenset()

    def teacher_service(self, bus: Bus) -> ScriptedTeacher:
        """Build the scripted teacher; ConfigError when the file has no `[teacher]`."""
        if self.teacher is None:
            raise ConfigError("the experiment file has no [teacher] section with [[teacher.phase]] entries")
        seed, ear, player = self.brain.experiment.seed, self.brain.ear, None
        if self.teacher.sound is not None and ear is not None:
            player = Player(self.teacher.sound, ear.notes_hz, seed)
        return ScriptedTeacher(bus, schedule_of(self.teacher, seed, self.robot.world), player)
