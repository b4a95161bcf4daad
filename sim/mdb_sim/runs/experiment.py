"""The whole experiment file: the brain's part, the robot and its world, the teacher and the phases.

Owns the sections that only the simulation reads, and the builders of its two services.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import msgspec
import tomli_w
from msgspec import Meta

from mdb_protocol import files
from mdb_protocol.bus import Bus
from mdb_protocol.errors import ConfigError, DamageError
from mdb_services.experiment.brain import BrainConfig, brain_config
from mdb_services.experiment.reading import MOST_BYTES, convert, nearest, read_file
from mdb_services.experiment.sections import Section
from mdb_sim.bodies.finding import check_window, get_ready, make_body, spec_of
from mdb_sim.body import Body, BodyError
from mdb_sim.robot.course import Rules
from mdb_sim.robot.service import RobotService
from mdb_sim.robot.state_file import StateFile
from mdb_sim.runs.machine import differences
from mdb_sim.teaching.policies.plain import Named
from mdb_sim.teaching.policy import Policy, make_policy
from mdb_sim.teaching.schedule import Schedule, TeacherSection, schedule_of
from mdb_sim.teaching.service import ScriptedTeacher
from mdb_sim.teaching.sound import Player

ROBOT_FILE = "robot.state"
"""Where the robot was, in a run folder."""


_kept: dict[bytes, Experiment] = {}
"""See `Experiment.keep`: by what they write."""


class ChangeSection(Section, frozen=True, kw_only=True):
    """`[[robot.change]]`: what of the body is another before the action of an iteration."""

    at: Annotated[int, Meta(ge=1)]
    set: Annotated[dict[str, Any], Meta(min_length=1)]


class RobotSection(Section, frozen=True, kw_only=True):
    """`[robot]`: which body, how fast, and what of its events counts."""

    body: str = "pybullet"
    """One of `finding.BODIES`, or "package.module:Factory"."""
    options: dict[str, Any] = msgspec.field(default_factory=dict)
    """What the body is made with."""
    period_s: Annotated[float, Meta(ge=0.001, le=3600)] | None = None
    """The robot acts every so many seconds, whether an action came or not; without it after each action it waits."""
    hold_s: Annotated[float, Meta(gt=0, le=3600)] = 1.0
    """How long a body goes on with an action while nobody commands it; then it is halted."""
    change: tuple[ChangeSection, ...] = ()
    successes: tuple[str, ...] = ()
    """The events that are successes."""
    ends: tuple[str, ...] = ()
    """The events after which the robot is put elsewhere, and an episode begins."""
    episode_iterations: Annotated[int, Meta(ge=1, le=10_000_000)] | None = None
    """An episode ends after so many actions at the latest, with the event "timeout"."""
    action_s: Annotated[float, Meta(ge=0, le=60)] = 0.05
    """In the concurrent pace an action takes at least this long (a real Pioneer 2: about 1.1 s)."""

    @property
    def changes(self) -> dict[int, dict[str, Any]]:
        """What changes before the action of which iteration."""
        found: dict[int, dict[str, Any]] = {}
        for change in self.change:
            found[change.at] = found.get(change.at, {}) | change.set
        return found

    @property
    def rules(self) -> Rules:
        """What is counted."""
        return Rules(frozenset(self.successes), frozenset(self.ends), self.episode_iterations)


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
                raise ConfigError(f"{source}: unknown section {name!r}{nearest(name, known)}")
        self.content = content
        self.brain = brain_config(content, source)
        simulation = convert(content, Simulation, source)
        self.robot, self._wants = simulation.robot, simulation.teacher
        self.teacher = self._wants if self._wants is not None and self._wants.phase else None
        """The scripted teachers'; None: there are none."""
        self._source = source
        if self._wants is not None:
            try:
                self.policy() if self.teacher is None else self.schedule()
            except ValueError as error:
                raise ConfigError(f"{source}: teacher: {error}") from error
            if self.teacher is not None and self.teacher.sound is not None and self.brain.ear is None:
                raise ConfigError(f"{source}: teacher.sound needs an [ear]; --set ear.detector=template gives it one")

    @classmethod
    def read(cls, path: Path, overrides: Iterable[str] = ()) -> Experiment:
        """Read a file with overrides applied; see `reading.read_file`."""
        if not overrides and _kept:
            with suppress(OSError, DamageError):  # of which is told below
                if (kept := _kept.get(files.content(path, MOST_BYTES))) is not None:
                    return kept
        return cls(placed(read_file(path, overrides), path), path)

    def write(self, path: Path) -> None:
        """Write the resolved experiment, overrides included: what a run folder keeps."""
        path.write_bytes(self._written)

    def keep(self) -> None:
        """Keep it for whoever reads what it writes: forks of this process then share what was read and checked."""
        _kept[self._written] = self

    @cached_property
    def _written(self) -> bytes:
        return tomli_w.dumps(self.content).encode()

    @property
    def folder(self) -> Path | None:
        """Where the experiment file lay, if that is known."""
        folder = self.brain.experiment.folder
        return None if folder is None else Path(folder)

    def policy(self) -> Policy | None:
        """Return what can be wanted of the robot: by `[teacher]`, or else one command a choice; None when that is not
        known. TeacherError when the policy cannot be had.
        """
        if self._wants is not None:
            return make_policy(self._wants.policy, self._wants.options, self.folder)
        names = [choice.name for choice in self.brain.choice]
        return Named(names) if names else None

    def schedule(self) -> Schedule:
        """Return the phases; ConfigError when the file has none, TeacherError when its policy cannot be had."""
        if self.teacher is None:
            raise ConfigError("the experiment file has no [teacher] section with [[teacher.phase]] entries")
        return schedule_of(self.teacher, self.brain.experiment.seed, self.folder)

    def check_machine(self, *, elsewhere: bool = False, gui: bool = False) -> None:
        """Raise ConfigError that names each difference between the file and the body that it names.

        Imports what the body needs, so it is asked for before a run, not whenever a file is read. A robot `elsewhere`
        is not known yet; `mdb check-robot` looks at it. gui: its window is wanted, so it must have one.
        """
        try:
            if gui:
                check_window(self.robot.body, self.folder)
            spec = None if elsewhere else spec_of(self.robot.body, self.robot.options, self.folder)
        except BodyError as error:
            raise ConfigError(f"{self._source}: {error}") from error
        policy = self.schedule().policy if self.teacher is not None else None
        found = differences(self.brain, self.robot, spec, policy)
        if found:
            body = "" if elsewhere else f"body {self.robot.body!r} is another one: "
            raise ConfigError(f"{self._source}: {body}" + "; ".join(found))

    def body(self, *, gui: bool = False) -> Body:
        """Make the robot's body; ConfigError when it cannot be had."""
        try:
            return make_body(self.robot.body, self.robot.options, self.folder, gui=gui)
        except BodyError as error:
            raise ConfigError(str(error)) from error

    def get_ready(self) -> None:
        """Do what is to be done for the robot's body before the process has threads."""
        get_ready(self.robot.body, self.folder)

    def robot_service(self, bus: Bus, run: Path | None = None, *, gui: bool = False) -> RobotService:
        """Build the robot; ConfigError when the body cannot be had.

        In a run folder, as a process of its own, its state is kept there and it acts in a thread.
        """
        body = self.body(gui=gui)
        action_s = 0.0 if self.brain.lockstep else self.robot.action_s
        power_safe = self.brain.store.durability == "power"
        file = StateFile(run / ROBOT_FILE, power_safe=power_safe) if run is not None else None
        seed = self.brain.experiment.seed
        period_s = None if self.brain.lockstep else self.robot.period_s
        return RobotService(
            bus,
            body,
            self.robot.rules,
            seed,
            changes=self.robot.changes,
            action_s=action_s if period_s is None else 0.0,
            fixed_pace=self.brain.lockstep,
            period_s=period_s,
            hold_s=self.robot.hold_s,
            file=file,
            threaded=run is not None,
        )

    @property
    def scripted_teachers(self) -> frozenset[str]:
        """The liveliness tokens of the teachers who belong to the experiment; empty without a `[teacher]`."""
        script = f"{ScriptedTeacher.role}/{ScriptedTeacher.instance}"
        return frozenset({script}) if self.teacher is not None else frozenset()

    def teacher_service(self, bus: Bus) -> ScriptedTeacher:
        """Build the scripted teacher; ConfigError when the file has no `[teacher]`."""
        schedule = self.schedule()
        assert self.teacher is not None
        seed, ear, player = self.brain.experiment.seed, self.brain.ear, None
        if self.teacher.sound is not None and ear is not None:
            player = Player(self.teacher.sound, ear.notes_hz, seed)
        return ScriptedTeacher(bus, schedule, player)


def placed(content: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return a file's content with the folder in which it lay, if something may be found there by its name."""
    sections = ((content.get("robot"), "body"), (content.get("teacher"), "policy"))
    names = [section.get(name) for section, name in sections if isinstance(section, dict)]
    experiment = content.get("experiment")
    if isinstance(experiment, dict) and any(isinstance(name, str) and ":" in name for name in names):
        experiment.setdefault("folder", str(path.resolve().parent))
    return content
