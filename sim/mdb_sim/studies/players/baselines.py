"""What the brain is compared with: players without its mechanism, in the same world, with the same teachers.

Owns the loop of a player and the plain players; those that learn are in `gaussian` and `tamer`. A run gives the
record that a brain's run gives, so the same measures hold. A player sees what the brain sees: readings, notes,
feedback; the plain ones that see the truth or know the language say so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol, TypeVar

from mdb_protocol import keys, messages
from mdb_protocol.errors import ConfigError
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_services.mechanism.networks import streams
from mdb_services.recorder import Recorded
from mdb_sim.body import Body, Numbers, Reading
from mdb_sim.robot.course import Course
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.record import RunRecord, record_of
from mdb_sim.studies.ideal import ideal_policy
from mdb_sim.studies.players.gaussian import GaussianPlayer
from mdb_sim.studies.players.tamer import TamerPlayer
from mdb_sim.teaching.schedule import Schedule
from mdb_sim.teaching.service import ScriptedTeacher

M = TypeVar("M")


class Player(Protocol):
    """Whoever chooses actions in the place of the brain."""

    def act(self, iteration: int, reading: Reading, note: int | None, truth: Numbers) -> Numbers:
        """Return the action for an iteration that begins with this reading, after this note."""

    def did(self, iteration: int, reading: Reading, note: int | None, action: Numbers) -> None:
        """Take what was done in an iteration: while exploration is forced, another action than `act` returned."""

    def learn(self, iteration: int, feedback: float) -> None:
        """Take the feedback for the action of an iteration."""


class _Plain:
    """A player that learns nothing."""

    def did(self, iteration: int, reading: Reading, note: int | None, action: Numbers) -> None:
        """See `Player`."""

    def learn(self, iteration: int, feedback: float) -> None:
        """See `Player`."""


class IdealPlayer(_Plain):
    """Sees the truth, and always faces the object: what can be captured at all."""

    def __init__(self, experiment: Experiment, schedule: Schedule) -> None:
        del schedule
        self._policy = ideal_policy(experiment)

    def act(self, iteration: int, reading: Reading, note: int | None, truth: Numbers) -> Numbers:
        """See `Player`."""
        del iteration, reading, note
        return dict(self._policy(truth))


class RandomPlayer(_Plain):
    """Any action, each as likely."""

    def __init__(self, experiment: Experiment, schedule: Schedule) -> None:
        del schedule
        self._seed, self._space = experiment.brain.experiment.seed, experiment.brain.space()

    def act(self, iteration: int, reading: Reading, note: int | None, truth: Numbers) -> Numbers:
        """See `Player`."""
        del reading, note, truth
        rng = streams.generator(self._seed, "baseline/random", iteration)
        return self._space.values(self._space.random(rng), 0)


class ObedientPlayer(RandomPlayer):
    """Knows every teacher's language and obeys each note as it sounds; without a note it acts at random."""

    def __init__(self, experiment: Experiment, schedule: Schedule) -> None:
        super().__init__(experiment, schedule)
        self._schedule = schedule
        choices = [choice.values for choice in experiment.brain.choice]
        policy = schedule.policy
        self._meant = [
            max(choices, key=lambda values, w=wanted: policy.expected(w, values) or 0.0)  # type: ignore[misc]
            for wanted in range(len(policy.commands))
        ]
        """The action for each command."""

    def act(self, iteration: int, reading: Reading, note: int | None, truth: Numbers) -> Numbers:
        """See `Player`."""
        language = self._schedule.at(iteration).language
        if note is None or language is None:
            return super().act(iteration, reading, note, truth)
        return self._meant[language.command(note)]


PLAYERS: dict[str, Callable[[Experiment, Schedule], Player]] = {
    "ideal": IdealPlayer,
    "obedient": ObedientPlayer,
    "random": RandomPlayer,
    "gaussian": GaussianPlayer,
    "tamer": TamerPlayer,
}
"""The players by name."""
OF_ANY_ACTION = ("random", "tamer")
"""Those who need no list of choices."""


def play(experiment: Experiment, name: str, run: Path) -> RunRecord:
    """Run an experiment with a player in the place of the brain; nothing is written but the experiment."""
    if name not in PLAYERS:
        raise ConfigError(f"no player {name!r}; expected one of {', '.join(PLAYERS)}")
    if experiment.teacher is None:
        raise ConfigError("a baseline needs the scripted teacher; the experiment file has no [teacher] section")
    if not experiment.brain.choice and name not in OF_ANY_ACTION:
        raise ConfigError(
            f"player {name!r} chooses among [[choice]] entries; the experiment file has none; expected one of "
            f"{', '.join(OF_ANY_ACTION)}"
        )
    run.mkdir(parents=True, exist_ok=True)
    experiment.write(run / EXPERIMENT_FILE)
    schedule = experiment.schedule()
    player = PLAYERS[name](experiment, schedule)
    body = experiment.body()
    try:
        return record_of(run, experiment, list(_log(experiment, schedule, player, body)))
    finally:
        body.close()


class _Teacher:
    """The scripted teacher over a bus of its own: he is shown a scene, and answers at once."""

    def __init__(self, experiment: Experiment, schedule: Schedule) -> None:
        fabric, brain = Fabric(), experiment.brain.experiment.brain
        self._bus = MemoryBus(fabric, brain)
        self._notes, self._feedback = self._bus.subscriber(keys.COMMAND), self._bus.subscriber(keys.FEEDBACK)
        self._phases = self._bus.subscriber(keys.PHASE)
        self._scenes = self._bus.publisher(keys.SCENE)
        self._script = ScriptedTeacher(MemoryBus(fabric, brain), schedule)

    def shown(self, scene: messages.Scene) -> tuple[int | None, list[messages.Feedback], list[messages.Phase]]:
        """Return the note for the next action, what is said of the actions before, and the phase that begins."""
        self._scenes.put(scene)
        while self._script.step():
            pass
        notes = [command.note for command in _taken(self._notes.take) if command.note is not None]
        return (notes[0] if notes else None), list(_taken(self._feedback.take)), list(_taken(self._phases.take))


def _taken(take: Callable[[], M | None]) -> Iterator[M]:
    while (message := take()) is not None:
        yield message


def _log(experiment: Experiment, schedule: Schedule, player: Player, body: Body) -> Iterator[Recorded]:
    """Yield what a recorder would have written of a run: phases, scenes and reports."""
    seed, random_iterations = experiment.brain.experiment.seed, experiment.brain.optimizer.random_iterations
    teacher, anything = _Teacher(experiment, schedule), RandomPlayer(experiment, schedule)
    course = Course(body, experiment.robot.rules, seed)
    choices = [choice.values for choice in experiment.brain.choice]
    note, _, phases = teacher.shown(course.last.scene())
    yield from (Recorded(keys.PHASE, "", phase, 0.0) for phase in phases)
    yield Recorded(keys.SCENE, "", course.last.scene(), 0.0)
    for iteration in range(experiment.brain.experiment.iterations):
        before = course.last
        explored = iteration < random_iterations
        chooser = anything if explored else player
        action = chooser.act(iteration, before.reading, note, before.now)
        player.did(iteration, before.reading, note, action)
        step = course.act(action)
        next_note, feedback, phases = teacher.shown(step.scene())
        value = None
        for judged in feedback:
            if judged.value is not None:
                credited = iteration if judged.iteration is None else judged.iteration
                player.learn(credited, judged.value)
                value = judged.value if credited == iteration else value
        report = messages.IterationReport(
            iteration=iteration,
            mode="baseline",
            action=action,
            choice=choices.index(action) if choices else None,
            explored=explored,
            predicted=None,
            note=note,
            feedback=value,
            event=step.event,
            prequential={},
            versions={},
        )
        yield Recorded(keys.ITERATION, "", report, 0.0)
        yield Recorded(keys.SCENE, "", step.scene(), 0.0)
        yield from (Recorded(keys.PHASE, "", phase, 0.0) for phase in phases)
        note = next_note
