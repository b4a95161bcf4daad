"""Process replay: one service alone hears what it heard in a recorded run, and must say what it said then.

After openpilot's process replay. Owns which service writes which keys, and the feeding; what counts as the same is
in `compare`. Nothing waits: clocks stand still.

The log of a lockstep run has all that a service's outputs follow from. That of a concurrent one does not say which
models had come to the memory store when a pair came, or to the optimizer when it acted, so those two cannot be
replayed from it; an evolver can, since each model says on which memory it was learnt. Robot and teacher can, too,
but of latest values that were lost under load there is nothing to compare. When a teacher with a process of his own
came and went is in no log: he is taken for there from the beginning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, Self

from mdb_protocol import codec, files, keys, messages
from mdb_protocol.bus import read
from mdb_protocol.errors import MdbError
from mdb_protocol.keys import Key
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.waiting import Raw
from mdb_services import evolver
from mdb_services.acting import optimizer, teachers
from mdb_services.experiment.run_folder import BEGINNING_FILE, EXPERIMENT_FILE, MEMORY_FILE
from mdb_services.hearing import ear
from mdb_services.memory import store as memory_store
from mdb_services.memory.file import MemoryFile
from mdb_services.memory.reading import MOST_FILE
from mdb_services.recorder import Recorded, read_log
from mdb_services.shell.service import Service, close
from mdb_sim.robot import service as robot_service
from mdb_sim.runs.compare import EXACTLY, Compare, Comparison
from mdb_sim.runs.experiment import Experiment
from mdb_sim.teaching import service as teacher_service

MOST_STEPS = 1000
"""Steps that a service may take after one message; more is an error of the service."""


class Run(NamedTuple):
    """A recorded run; `beginning` is the memory store's file as it was before the first pair, if there was one."""

    experiment: Experiment
    log: list[Recorded]
    beginning: Path | None = None

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read a run folder; MdbError when it holds no experiment or no log."""
        beginning = folder / BEGINNING_FILE
        experiment = Experiment.read(folder / EXPERIMENT_FILE)
        log = list(read_log(folder, experiment.brain.experiment.brain))
        return cls(experiment, log, beginning if beginning.exists() else None)

    def with_actions_done(self) -> Iterator[Recorded]:
        """Yield the log with the actions that are only in it as done: the recorder has missed them."""
        action, known = keys.ACTION.at(self.experiment.brain.experiment.brain), -1
        for recorded in self.log:
            message = recorded.message
            done = message.done if isinstance(message, messages.Perception) else None
            if done is not None and done.iteration > known:
                yield Recorded(keys.ACTION, action, done, recorded.time_s)
            if isinstance(message, messages.Action):
                known = message.iteration
            yield recorded

    def teachers(self) -> set[str]:
        """Return the instances of role teacher that were alive."""
        if self.experiment.teacher is not None:
            return {teacher_service.ScriptedTeacher.instance}
        return {r.message.teacher for r in self.log if isinstance(r.message, messages.Command | messages.AudioFrame)}

    def learnt(self, model: str) -> set[int]:
        """Return the versions of a model's memory on which it was learnt."""
        models = (r.message for r in self.log if isinstance(r.message, messages.CurrentModel))
        return {message.version for message in models if message.model == model}


class Role(NamedTuple):
    """A service of an experiment: how it is built, with a folder for its files, and the keys that it alone writes."""

    build: Callable[[MemoryBus, Path], Service]
    writes: tuple[str, ...]
    model: str | None = None
    """Of an evolver."""
    exact: bool = True
    """Whether the log, in its pace, has all that the outputs follow from."""
    gaps: bool = False
    """Whether it reads or writes latest values in the pace in which the recorder, or it, may miss some."""

    def wrote(self, key: str) -> bool:
        """Whether a key is one of its own."""
        return any(fnmatchcase(key, pattern) for pattern in self.writes)


def roles(experiment: Experiment) -> dict[str, Role]:
    """Return the services of an experiment that say the same in each run of a seed, by name."""
    brain, teacher = experiment.brain, experiment.teacher
    lockstep, seed = brain.lockstep, brain.experiment.seed

    def at(*rows: Key, **parameters: str) -> tuple[str, ...]:
        return tuple(row.at(brain.experiment.brain, **parameters) for row in rows)

    def memory(bus: MemoryBus, folder: Path) -> Service:
        return memory_store.MemoryStore(bus, brain, MemoryFile(folder / MEMORY_FILE), _stopped)

    def learn(model: str, bus: MemoryBus, _: Path) -> Service:
        return evolver.Evolver(bus, brain, model)

    def move(bus: MemoryBus, _: Path) -> Service:
        body, rules = experiment.body(), experiment.robot.rules
        changes = experiment.robot.changes
        return robot_service.RobotService(bus, body, rules, seed, changes=changes, clock=_stopped, deadlines=False)

    found = {"memory": Role(memory, at(keys.MEMORY_CHANGE, keys.CONTEXT, keys.PAIR_STORED), exact=lockstep)}
    for name in (model.name for model in brain.model):
        found[f"evolver/{name}"] = Role(partial(learn, name), at(keys.CURRENT_MODEL, model=name), model=name)
    acts = at(keys.ACTION, keys.PAIR, keys.ITERATION, keys.FINISHED)
    found["optimizer"] = Role(lambda bus, _: optimizer.Optimizer(bus, brain, _stopped), acts, exact=lockstep)
    found["robot"] = Role(move, at(keys.PERCEPTION, keys.SCENE), gaps=not lockstep)
    if teacher is not None:
        names = {teacher_service.ScriptedTeacher.instance, *(p.teacher for p in teacher.phase if p.teacher)}
        own = [at(keys.COMMAND, keys.AUDIO, keys.FEEDBACK, teacher=name) for name in sorted(names)]
        says = sum(own, at(keys.PHASE))
        found["teacher"] = Role(lambda bus, _: experiment.teacher_service(bus), says, gaps=not lockstep)
    if brain.ear is not None:
        found["ear"] = Role(lambda bus, _: ear.Ear(bus, brain), at(keys.HEARD))
    return found


def _stopped() -> float:
    """A clock that stands still: nothing times out, nothing is sent again, and no action comes too late."""
    return 0.0


@dataclass(frozen=True)
class Outcome:
    """What came of a replay: messages heard, values compared, and the first difference in words, if there is one.

    `unmatched` are values without a counterpart where messages may have been lost, `said` all that it says now.
    """

    role: str
    heard: int
    compared: int
    unmatched: int
    difference: str | None
    said: int

    @property
    def silent(self) -> bool:
        """Whether it heard the run and says nothing, as nothing of it is in the log."""
        return self.heard > 0 and not (self.compared or self.said or self.unmatched)

    @property
    def holds(self) -> bool:
        """Whether something was checked, and no difference found."""
        return self.difference is None and (self.compared > 0 or self.silent)


def replay(run: Run, name: str, compare: Compare = EXACTLY) -> Outcome:
    """Replay the service `name` of `roles` to the end of the log or to the first difference.

    MdbError when the run has no such service, or the log does not say enough.
    """
    role = _role(run, name)
    learnt = None if role.model is None or run.experiment.brain.lockstep else run.learnt(role.model)
    comparison, heard, answers = Comparison(compare, gaps=role.gaps), 0, _Answers(run, role)
    with alone(run, role) as (service, bus, said):
        drive(service)
        for recorded in answers.in_order(run.with_actions_done() if role.gaps else run.log):
            if role.wrote(recorded.key):
                comparison.record(recorded.key, recorded.message)
            elif bus.feed(raw_of(recorded)):
                heard += 1
                if learnt is None or getattr(recorded.message, "version", None) in learnt:
                    drive(service)
            for raw in said():
                message = _message(raw, bus)
                answers.asked(message)
                comparison.say(raw.key, message)
            if comparison.difference is not None:
                break
        else:
            comparison.end()
    return Outcome(name, heard, comparison.compared, comparison.unmatched, comparison.difference, comparison.said)


class _Answers:
    """Puts what answers the service after what it answers: acknowledgements after pairs, outcomes after actions.

    The recorder hears each sender in order, but not all senders in one: on a busy machine an action's outcome can be
    in the log before the command without which the action was never chosen.
    """

    def __init__(self, run: Run, role: Role) -> None:
        self._answered = role.wrote(keys.PAIR.at(run.experiment.brain.experiment.brain))
        self._sent: set[tuple[int, bool]] = set()
        actions = (r.message.iteration for r in run.log if isinstance(r.message, messages.Action))
        self._acted = min(actions, default=0) - 1
        """The last action that was said. One before the log's first action is of an earlier process."""
        self._early: list[Recorded] = []

    def asked(self, message: messages.Message) -> None:
        """Take what the service has said."""
        if isinstance(message, messages.Pair):
            self._sent.add((message.iteration, message.feedback is not None))
        elif isinstance(message, messages.Action):
            self._acted = max(self._acted, message.iteration)

    def in_order(self, log: Iterable[Recorded]) -> Iterator[Recorded]:
        """Yield the log, what came too early as soon as it is not, and in the end all the rest."""
        for recorded in log:
            if self._is_early(recorded):
                self._early.append(recorded)
            else:
                yield recorded
            while (due := next((early for early in self._early if not self._is_early(early)), None)) is not None:
                self._early.remove(due)
                yield due
        yield from self._early

    def _is_early(self, recorded: Recorded) -> bool:
        if not self._answered:
            return False
        match recorded.message:
            case messages.PairStored(iteration=iteration, judged=judged):
                return (iteration, judged) not in self._sent
            case messages.Perception(done=messages.Action(iteration=iteration)):
                return iteration > self._acted
        return False


def _role(run: Run, name: str) -> Role:
    found = roles(run.experiment)
    if name not in found:
        raise MdbError(f"no service {name!r} to be replayed; this run has {', '.join(found)}")
    if not found[name].exact:
        others = ", ".join(other for other, role in found.items() if role.exact)
        raise MdbError(
            f"recorded in concurrent pace: what had come to {name} when it went on is not in the log. {others} can "
            "be replayed; with --pace lockstep all can"
        )
    return found[name]


@contextmanager
def alone(run: Run, role: Role) -> Iterator[tuple[Service, MemoryBus, Callable[[], Iterator[Raw]]]]:
    """Build a service alone, with its bus and what it has said since it was last asked.

    A memory store that never hears anything answers its queries as at the beginning of the run.
    """
    fabric, name = Fabric(), run.experiment.brain.experiment.brain
    bus, others = MemoryBus(fabric, name), MemoryBus(fabric, name)
    for teacher in run.teachers():
        others.token(teachers.ROLE, teacher)
    with TemporaryDirectory() as first, TemporaryDirectory() as second:
        for folder in (first, second):
            if run.beginning is not None:
                files.copy(run.beginning, Path(folder) / MEMORY_FILE, MOST_FILE)
        store = roles(run.experiment)["memory"].build(others, Path(first))
        tap = others.tap()
        service = role.build(bus, Path(second))
        try:
            yield service, bus, lambda: (raw for raw in iter(tap.take, None) if role.wrote(raw.key))
        finally:
            close([service, store])


def drive(service: Service) -> None:
    """Let a service do all that it can do now."""
    for _ in range(MOST_STEPS):
        if not service.step():
            return
    raise MdbError(f"{service.role}/{service.instance} does not come to rest: {MOST_STEPS} steps after one message")


def raw_of(recorded: Recorded) -> Raw:
    """Return a message of the log as the bus carries it."""
    return Raw(recorded.key, codec.encode(recorded.message), codec.encoding_of(type(recorded.message)))


def _message(raw: Raw, bus: MemoryBus) -> messages.Message:
    row = keys.find(bus.brain, raw.key)
    assert row is not None
    return read(row, bus.brain, raw)
