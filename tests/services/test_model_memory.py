"""The memories of a model through a whole story: stored, left, recalled, restarted, on a real file.

Teachers speak language A, then B, then A again; a student, in the place of an evolver, knows the language that
explains the memory best (`languages.py`).
"""

import shutil
import sqlite3
from collections.abc import Container, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from mdb_protocol import codec, keys, messages
from mdb_protocol.errors import MdbError
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.evolver import Evolver
from mdb_services.experiment.brain import BrainConfig
from mdb_services.mechanism.networks.network import Network
from mdb_services.memory.file import MemoryFile
from mdb_services.memory.store import RETRY_S, MemoryStore
from tests.services.languages import NAME, SPEAKS, Student, config, current, done, feedback, language_of, pair
from tests.services.small import BRAIN
from tests.services.store_rig import Rig, taken

STORY = "A" * 20 + "B" * 20 + "A" * 20
"""The language of each iteration; each begins with two pairs that the one before foresees wrongly."""

Plain = dict[str, Any]


@dataclass
class Told:
    """What a memory store said, pair by pair."""

    changes: list[Plain] = field(default_factory=list)
    events: list[Plain] = field(default_factory=list)
    snapshots: list[Plain] = field(default_factory=list)
    values: list[Plain] = field(default_factory=list)
    long_term: list[list[Plain]] = field(default_factory=list)


class Lesson:
    """A memory store, a student who follows it, and all that the store says."""

    def __init__(self, path: Path, settings: BrainConfig | None = None, student: Student | None = None) -> None:
        self.rig = Rig(path, settings or config())
        self.student = student or Student()
        self.told = Told()
        if self.student.model is not None:
            self.rig.show(self.student.model)

    def hear(self, *pairs: messages.Pair, show: bool = True) -> None:
        """Give pairs to the store, one by one, and the student's model of each version to it, unless told not to."""
        for one in pairs:
            self.rig.give(one)
            models = []
            for change in taken(self.rig.changes):
                if change.version == self.student.mirror.version:  # a store that begins says its last change again
                    continue
                models.append(self.student.follow(change))
                self.told.changes.append(codec.to_plain(change))
            for model in models if show else []:
                self.rig.show(model)
            self.told.events += [codec.to_plain(event) for event in taken(self.rig.events)]
            self.told.snapshots.append(self.rig.snapshots()[NAME])
            self.told.values.append(self.values())
            self.told.long_term.append([codec.to_plain(model) for model in self.rig.store._file.long_term()])

    def live(self, start: int = 0, stop: int = len(STORY), story: str = STORY) -> None:
        self.hear(*(pair(i, story[i]) for i in range(start, stop)))

    def values(self) -> Plain:
        """What the store says of its memories, not of what it was given twice or could not write."""
        aside = ("duplicates", "unwritten", "disk_refuses")
        return {name: value for name, value in self.rig.store.values().items() if name not in aside}

    def events(self) -> list[tuple[int, str, int | None]]:
        return [(event["iteration"], event["kind"], event["stored"]) for event in self.told.events]

    def model(self, id: int) -> messages.LongTermModel:
        (found,) = [model for model in self.rig.store._file.long_term(NAME) if model.id == id]
        return found


@pytest.fixture
def lesson(tmp_path: Path) -> Iterator[Lesson]:
    made = Lesson(tmp_path / "memory.sqlite")
    yield made
    made.rig.store.close()


def lived(path: Path, settings: BrainConfig) -> Told:
    """The whole story without a restart."""
    told = Lesson(path, settings)
    told.live()
    told.rig.store.close()
    return told.told


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Told:
    return lived(tmp_path_factory.mktemp("straight") / "memory.sqlite", config())


# ---- the story ----


def test_a_good_and_stable_model_is_stored_with_pairs_of_its_context(lesson: Lesson) -> None:
    lesson.live(0, 6)
    assert lesson.events() == []
    lesson.live(6, 20)
    assert lesson.events() == [(6, "stored", 1), (12, "stored", 1), (18, "stored", 1)], "every 6 good pairs"
    model = lesson.model(1)
    assert language_of(model) == "A"
    assert sorted((one.note, one.choice) for one in model.pairs) == [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert all(one.action == done(one.choice) for one in model.pairs)
    assert all(one.feedback == feedback("A", one.note, one.choice) for one in model.pairs)
    assert model.error < 1e-6
    assert (model.experiment, model.brain, model.seed) == ("languages", BRAIN, 3)
    assert (model.iteration, model.touched, model.uses, model.origin) == (18, 19, 0, "")
    assert model.reads == {
        "note": "one_hot of 2", "action": "rank of 0, 90", "feedback": "scalar -1 to 1",
    }  # fmt: skip


def test_a_model_that_knows_less_leaves_the_stored_one_as_it_is(lesson: Lesson) -> None:
    lesson.live(0, 20)
    before = lesson.model(1)
    for i in range(20, 32):  # only right actions from now on: for them a network will do that praises everything
        lesson.rig.show(current(Network([np.zeros((0, 4)), np.array([[1.0]])]), i))
        lesson.rig.give(pair(i, "A", choice=i % 2, feedback=1.0))
    assert taken(lesson.rig.events) == []
    after = lesson.model(1)
    assert after.touched > before.touched
    assert codec.to_plain(after) == codec.to_plain(msgspec.structs.replace(before, touched=after.touched))


def test_a_bad_model_is_not_stored(lesson: Lesson) -> None:
    for i in range(30):
        lesson.rig.show(current(SPEAKS["silence"], i))
        lesson.rig.give(pair(i, "A"))
    assert taken(lesson.rig.events) == []
    assert lesson.rig.store._file.long_term() == []


def test_a_change_of_teacher_empties_the_memory_of_the_one_before(lesson: Lesson) -> None:
    lesson.live(0, 21)
    held = set(lesson.told.snapshots[-1]["pairs"])
    assert lesson.events()[3:] == []
    lesson.live(21, 22)
    assert lesson.events()[3:] == [(21, "changed", None)]
    insert, change = lesson.told.changes[-2:]
    assert (insert["version"], change["version"]) == (22, 23)
    assert set(change["evicted"]) == (held | {21}) - {20, 21} - set(insert["evicted"])
    assert (change["pairs"], change["inputs"], len(change["freed"])) == ([], [], 6)
    snapshot = lesson.told.snapshots[-1]
    assert sorted(snapshot["pairs"]) == [20, 21]
    assert (snapshot["version"], len(lesson.student.mirror)) == (23, 2)
    assert lesson.student.seeds == ["A"], "what was stored is a seed, though it does not fit"
    assert lesson.values()[f"changing.{NAME}"] == 1
    (stored,) = taken(lesson.rig.stored)[-1:]
    assert stored.versions == {NAME: 23}, "in lockstep the next iteration waits for what was learnt from it"


def test_a_new_context_is_learnt_known_and_stored_next_to_the_old_one(lesson: Lesson) -> None:
    lesson.live(0, 40)
    assert lesson.events()[4:] == [(25, "known", None), (27, "stored", 2), (33, "stored", 2), (39, "stored", 2)]
    assert [language_of(model) for model in lesson.rig.store._file.long_term()] == ["A", "B"]
    assert lesson.values()[f"changing.{NAME}"] == 0


def test_the_first_teacher_returns_and_what_was_learnt_is_recalled_at_once(lesson: Lesson) -> None:
    lesson.live(0, 40)
    lesson.student.seeds.clear()
    sample = lesson.model(1).pairs
    lesson.live(40, 42)
    assert lesson.events()[8:] == [(41, "changed", None), (41, "recalled", 1)]
    assert lesson.told.events[-1]["error"] < 1e-6
    change = lesson.told.changes[-1]
    assert change["pairs"] == [-1, -2, -3, -4]
    assert lesson.student.seeds == ["A", "B"], "the best first"
    snapshot = lesson.told.snapshots[-1]
    assert sorted(snapshot["pairs"]) == [-4, -3, -2, -1, 40, 41]
    rows = {(tuple(i), t[0]) for i, t in zip(snapshot["inputs"], snapshot["targets"], strict=True)}
    assert len(rows) == 4, "two of the sample's four pairs have come again, the other two are known by it alone"
    for one in sample:
        row = (float(one.note == 0), float(one.note == 1), 2.0 * one.choice - 1)
        assert (row, one.feedback) in rows
    assert (lesson.model(1).uses, lesson.model(1).touched) == (1, 43)
    assert lesson.values()[f"changing.{NAME}"] == 0
    lesson.live(42, 60)
    assert lesson.events()[10:] == [(47, "stored", 1), (53, "stored", 1), (59, "stored", 1)]
    assert (lesson.model(1).uses, lesson.model(1).iteration) == (1, 59)
    assert all(value[f"usual_error.{NAME}"] < 1e-6 for value in lesson.told.values[42:]), "no wrong prediction since"


def test_what_the_mirror_holds_is_what_the_store_holds(straight: Told) -> None:
    student = Student()
    changes = [
        {name: np.array(value) if isinstance(value, list) and name != "seeds" else value for name, value in c.items()}
        for c in straight.changes
    ]
    held: dict[int, Plain] = {snapshot["version"]: snapshot for snapshot in straight.snapshots}
    for change in changes:
        rows = {"inputs": change["inputs"].reshape(-1, 3), "targets": change["targets"].reshape(-1, 1)}
        whole = {name: change[name].astype(np.int64) for name in ("slots", "pairs", "freed", "evicted")}
        student.follow(messages.MemoryChange(**change | rows | whole | {"seeds": []}))
        if (snapshot := held.get(change["version"])) is not None:
            inputs, targets, ids = student.mirror.arrays()
            assert student.mirror.slots.tolist() == snapshot["slots"]
            assert ids.tolist() == snapshot["pairs"]
            assert inputs.tolist() == snapshot["inputs"]
            assert targets.tolist() == snapshot["targets"]
    assert student.mirror.version == straight.snapshots[-1]["version"]


def test_a_snapshot_says_which_networks_were_recalled_when_the_context_began(straight: Told) -> None:
    def seeds(iteration: int) -> list[str]:
        return [language_of(messages.ModelWeights(layers=seed["layers"], weights=np.array(seed["weights"])))
                for seed in straight.snapshots[iteration]["seeds"]]  # fmt: skip

    assert [seeds(iteration) for iteration in (20, 21, 40, 41, 59)] == [[], ["A"], ["A"], ["A", "B"], ["A", "B"]]


# ---- restarts and failures ----

LATE = config(
    memory={"recency": 0.3, "distance": 1.0, "current_error": 0.5, "entry_error": 1.0},
    long_term={"stable_pairs": 6, "sample": 4, "fit_pairs": 4},
)
"""A stored model is tried two pairs after the change was noticed, and the errors decide who leaves."""


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> Told:
    return lived(tmp_path_factory.mktemp("late") / "memory.sqlite", LATE)


def test_a_stored_model_that_fits_later_is_recalled_then(late: Told) -> None:
    events = [(event["iteration"], event["kind"]) for event in late.events]
    assert events[8:] == [(41, "changed"), (43, "recalled"), (49, "stored"), (55, "stored")]
    assert late.changes[-1]["version"] == 60 + 3
    assert sorted(late.snapshots[43]["pairs"]) == [-4, -3, -2, -1, 40, 41, 42, 43]


POINTS = [1, 4, 7, 21, 22, 25, 28, 41, 42, 45]


def restarted(path: Path, settings: BrainConfig, points: Container[int]) -> Told:
    """The story with restarts before these iterations, each of which finds all as it was."""
    lesson = Lesson(path, settings)
    for i in range(len(STORY)):
        if i in points:
            before = (lesson.rig.snapshots(), lesson.values())
            lesson.rig.restart()
            assert (lesson.rig.snapshots(), lesson.values()) == before
        lesson.live(i, i + 1)
    lesson.rig.store.close()
    return lesson.told


@pytest.mark.parametrize("points", [*([point] for point in POINTS), range(60)], ids=str)
def test_a_story_with_restarts_goes_on_like_one_without(tmp_path: Path, straight: Told, points: list[int]) -> None:
    assert restarted(tmp_path / "memory.sqlite", config(), points) == straight


@pytest.mark.parametrize("points", [[42], [43], [44], [46], range(60)], ids=str)
def test_so_does_one_in_which_a_model_fits_later(tmp_path: Path, late: Told, points: list[int]) -> None:
    assert restarted(tmp_path / "memory.sqlite", LATE, points) == late


def test_recalled_pairs_have_no_error_at_entry_before_and_after_a_restart(tmp_path: Path) -> None:
    settings = config(memory={"recency": 1.0, "entry_error": 0.5})
    expected = lived(tmp_path / "straight.sqlite", settings)
    assert [event["iteration"] for event in expected.events if event["kind"] == "recalled"] == [41]
    assert restarted(tmp_path / "memory.sqlite", settings, [42]) == expected


@pytest.mark.parametrize("points", [(12, 21), (21, 41), (42,)], ids=str)
def test_a_store_that_was_killed_goes_on_where_the_file_ends(
    tmp_path: Path, straight: Told, points: tuple[int, ...]
) -> None:
    """The file is copied while it is in use, write-ahead log and all: nothing was closed in order."""
    (tmp_path / "0").mkdir()
    lesson = Lesson(tmp_path / "0" / "memory.sqlite")
    for number, (start, stop) in enumerate(pairwise((0, *points, len(STORY))), start=1):
        lesson.live(start, stop)
        shutil.copytree(tmp_path / f"{number - 1}", tmp_path / f"{number}")
        dead, lesson = lesson, Lesson(tmp_path / f"{number}" / "memory.sqlite", student=lesson.student)
        lesson.told = dead.told
        dead.rig.store.close()
    assert lesson.told == straight


@pytest.mark.parametrize("at", [3, 6, 21, 25, 41, 47])
def test_a_failing_write_leaves_the_memories_as_they_are_on_disk(
    tmp_path: Path, straight: Told, at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    lesson = Lesson(tmp_path / "memory.sqlite")
    lesson.live(0, at)
    rig = lesson.rig
    before = (rig.snapshots(), lesson.values())

    def add(*_: object) -> None:
        raise sqlite3.OperationalError("disk I/O error")

    rig.pairs.put(pair(at, STORY[at]))
    for _ in range(2):
        rig.now += RETRY_S
        with monkeypatch.context() as patch:
            patch.setattr(rig.store._file, "add", add)
            rig.store.step()
        assert (rig.snapshots(), lesson.values()) == before
        assert [taken(inbox) for inbox in (rig.changes, rig.events)] == [[], []]
    rig.now += RETRY_S
    lesson.live(at)
    assert lesson.told == straight


def test_a_write_that_fails_half_way_is_undone(tmp_path: Path, straight: Told) -> None:
    lesson = Lesson(tmp_path / "memory.sqlite")
    lesson.live(0, 41)
    rig = lesson.rig
    before = (rig.snapshots(), lesson.values())
    database = rig.store._file._db
    for table in ("recalled", "change", "context", "seed", "long_term"):
        database.execute(f"CREATE TRIGGER t BEFORE INSERT ON {table} BEGIN SELECT RAISE(FAIL, 'no {table}'); END")
        rig.pairs.put(pair(41, STORY[41]))
        with pytest.raises(sqlite3.IntegrityError, match=f"no {table}"):
            rig.store.step()
        database.execute("DROP TRIGGER t")
        assert (rig.snapshots(), lesson.values()) == before
        assert not database.in_transaction
    lesson.live(41)
    assert lesson.told == straight


@pytest.mark.parametrize("damage", [
    "UPDATE recalled SET payload = x'c1'", "UPDATE seed SET payload = x'c1'", "UPDATE long_term SET payload = x'c1'",
    "DELETE FROM recalled", "UPDATE change SET slot = 1000 WHERE pair = -1", "DROP TABLE context",
])  # fmt: skip
def test_a_damaged_memory_is_a_clear_error(lesson: Lesson, damage: str) -> None:
    lesson.live(0, 42)
    lesson.rig.store.close()
    with sqlite3.connect(lesson.rig.path) as database:
        database.execute(damage)
        if "DROP" in damage:
            database.execute("CREATE TABLE context (a, b)")
    with pytest.raises(MdbError, match=r"memory\.sqlite cannot be used.*mdb rescue"):
        lesson.rig.restart()


# ---- what makes the difference ----


def heard(start: int, *said: tuple[int, int], language: str) -> list[messages.Pair]:
    """Pairs of notes and choices, one an iteration."""
    return [pair(i, language, note=note, choice=choice) for i, (note, choice) in enumerate(said, start=start)]


def test_a_model_recalled_by_chance_is_left_after_a_few_pairs(lesson: Lesson) -> None:
    lesson.live(0, 40)
    lesson.hear(*heard(40, (1, 0), (0, 1), language="C"))  # punished for both, as in A
    assert lesson.events()[8:] == [(41, "changed", None), (41, "recalled", 1)]
    lesson.hear(*heard(42, (1, 1), (1, 1), language="C"))  # as in B
    assert lesson.events()[10:][0] == (43, "changed", None)
    kept = lesson.told.snapshots[-1]["pairs"]
    assert sorted(pair for pair in kept if pair >= 0) == [40, 41, 42, 43], "all that was heard in the new language"


HESITANT = {"threshold": 3.0, "known_pairs": 4, "margin": 0.2}
"""Two missed pairs are not yet a change."""
MISSED = [(1, 1), (1, 0), (1, 1)]
"""Of these, A says the contrary of C in the first and the last."""


def after_c(path: Path, **sections: Plain) -> Lesson:
    """A lesson in A, then in C, by one who hesitates to call anything a change."""
    memory = {"stable_pairs": 6, "sample": 4} | sections.get("long_term", {})
    lesson = Lesson(path, config(context=HESITANT | sections.get("context", {}), long_term=memory))
    lesson.live(0, 40, "A" * 20 + "C" * 20)
    return lesson


def test_a_context_that_is_known_needs_less_evidence_than_a_new_one(tmp_path: Path) -> None:
    lesson = after_c(tmp_path / "memory.sqlite")
    lesson.hear(*heard(40, *MISSED, language="A"))
    assert lesson.events()[-2:] == [(42, "changed", None), (42, "recalled", 1)]
    assert sorted(lesson.told.snapshots[-1]["pairs"]) == [-4, -3, -2, -1, 40, 41, 42]


@pytest.mark.parametrize(
    "sections",
    [
        {"long_term": {"missed_error": 4.5}},
        {"long_term": {"fit_pairs": 3}},
        {"long_term": {"capacity": 0}},
        {"context": {"known_pairs": 30}},
    ],
    ids=str,
)
def test_what_is_not_surely_a_return_is_no_change(tmp_path: Path, sections: dict[str, Plain]) -> None:
    lesson = after_c(tmp_path / "memory.sqlite", **sections)
    events = lesson.events()
    lesson.hear(*heard(40, *MISSED, language="A"))
    assert lesson.events() == events


def test_a_single_odd_pair_recalls_nothing(lesson: Lesson) -> None:
    lesson.live(0, 40, "A" * 20 + "C" * 20)
    events = lesson.events()
    lesson.hear(*heard(40, (1, 1), language="A"), *heard(41, (0, 0), (1, 1), (1, 0), language="C"))
    assert lesson.events() == events


def test_a_model_of_the_context_itself_is_not_recalled(tmp_path: Path) -> None:
    """One that is stored before the new context counts as known."""
    lesson = Lesson(tmp_path / "memory.sqlite", config(context={"known_pairs": 12}))
    lesson.live(0, 40)
    assert lesson.events()[3:] == [
        (21, "changed", None), (27, "stored", 2), (33, "known", None), (33, "stored", 2), (39, "stored", 2),
    ]  # fmt: skip


def test_errors_of_a_model_from_before_the_recall_do_not_count(lesson: Lesson) -> None:
    """In the concurrent pace the evolver may be some pairs behind; the recalled model is not to blame."""
    lesson.live(0, 42)
    late = current(SPEAKS["B"], 43)
    for i in range(42, 46):
        lesson.rig.show(late)
        lesson.hear(pair(i, "A"), show=False)
    assert lesson.events()[10:] == []
    assert lesson.values()[f"usual_error.{NAME}"] < 1e-6
    lesson.rig.restart()
    lesson.rig.show(late)
    lesson.hear(pair(46, "A"), show=False)
    assert lesson.values()[f"usual_error.{NAME}"] < 1e-6
    lesson.rig.show(current(SPEAKS["B"], 44))
    lesson.hear(pair(47, "A"), pair(48, "A"), show=False)
    assert lesson.events()[-1][1] != "stored", "but one that was learnt since then does"
    assert (48, "changed", None) in lesson.events()


def test_without_forgetting_the_old_pairs_leave_first_in_first_out(tmp_path: Path) -> None:
    settings = config(context={"known_pairs": 4, "forget": False}, memory={"recency": 0.1, "distance": 1.0},
                      long_term={"capacity": 0})  # fmt: skip
    lesson = Lesson(tmp_path / "memory.sqlite", settings)
    lesson.live(0, 20)
    held = lesson.told.snapshots[-1]["pairs"]
    lesson.live(20, 24)
    changes = [change for change in lesson.told.changes if change["version"] > 20]
    assert [change["pairs"] for change in changes] == [[20], [21], [], [22], [23]]
    assert changes[2]["freed"] == changes[2]["evicted"] == []
    old = [sorted(id for id in snapshot["pairs"] if id < 20) for snapshot in lesson.told.snapshots[19:]]
    assert [len(ids) for ids in old] == [8, 7, 6, 5, 4]
    assert old[3:] == [old[2][1:], old[2][2:]], "since the change the oldest leave"
    assert sorted(held) == old[0]
    assert lesson.events() == [(21, "changed", None)]


def test_the_setting_is_temporal_until_the_new_context_is_known(lesson: Lesson) -> None:
    lesson.rig.settings = config(memory={"distance": 2.0})
    lesson.rig.restart()
    for stop, distance in ((21, 2.0), (22, 0.0), (25, 0.0), (26, 2.0), (40, 2.0), (42, 2.0)):
        lesson.live(len(lesson.told.snapshots), stop)
        assert lesson.rig.store._memories[NAME].stm.config.distance == distance
        lesson.rig.restart()
        assert lesson.rig.store._memories[NAME].stm.config.distance == distance


def test_a_disabled_detector_and_long_term_memory_change_and_store_nothing(tmp_path: Path) -> None:
    settings = config(context={"enabled": False}, long_term={"capacity": 0})
    lesson = Lesson(tmp_path / "memory.sqlite", settings)
    lesson.live()
    assert lesson.events() == []
    assert lesson.rig.store._file.long_term() == []
    assert lesson.told.snapshots[-1]["version"] == len(STORY)


def test_recalled_pairs_have_ids_of_their_own_each_time(tmp_path: Path) -> None:
    story = STORY + "B" * 20 + "A" * 20
    lesson = Lesson(tmp_path / "memory.sqlite")
    for start in range(0, 100, 20):
        lesson.live(start, start + 20, story)
        lesson.rig.restart()
    recalled = [id for change in lesson.told.changes for id in change["pairs"] if id < 0]
    assert recalled == [-1, -2, -3, -4, -5, -6, -7, -8, -9, -10, -11, -12]
    assert [(event["iteration"], event["stored"]) for event in lesson.told.events if event["kind"] == "recalled"] == [
        (41, 1), (61, 2), (81, 1),
    ]  # fmt: skip
    assert [(model.id, model.uses) for model in lesson.rig.store._file.long_term()] == [(1, 2), (2, 1)]


def test_what_is_forgotten_is_gone_from_the_file(tmp_path: Path) -> None:
    lesson = Lesson(tmp_path / "memory.sqlite", config(long_term={"stable_pairs": 6, "sample": 4, "capacity": 1}))
    lesson.live(0, 40)
    assert [(model.id, language_of(model)) for model in lesson.rig.store._file.long_term()] == [(2, "B")]
    lesson.rig.restart()
    lesson.live(40, 48)
    assert lesson.events()[-3:] == [(41, "changed", None), (45, "known", None), (47, "stored", 3)], "learnt again"
    assert [model.id for model in lesson.rig.store._file.long_term()] == [3]


# ---- models of another run ----


def lesson_with(path: Path, *models: messages.LongTermModel, settings: BrainConfig | None = None) -> Lesson:
    with MemoryFile(path) as file:
        file.keep_long_term(models)
    return Lesson(path, settings)


def brought(id: int, language: str, **fields: Any) -> messages.LongTermModel:
    """A model as `mdb ltm import` writes it."""
    layers, weights = SPEAKS[language].to_arrays()
    model = messages.LongTermModel(
        id=id,
        model=NAME,
        reads=config().reads(config().model[0]),
        layers=layers,
        weights=weights,
        error=0.01,
        pairs=[pair(i, language) for i in range(4)],
        origin="elsewhere",
    )
    return msgspec.structs.replace(model, **fields)


def test_a_run_begins_with_the_most_useful_model_of_another_and_its_sample(tmp_path: Path) -> None:
    lesson = lesson_with(tmp_path / "memory.sqlite", brought(1, "A", uses=3), brought(2, "B", uses=1))
    (snapshot,) = lesson.rig.outside.query(keys.MEMORY_SNAPSHOT, 1.0)
    assert (snapshot.version, snapshot.pairs.tolist()) == (1, [-1, -2, -3, -4])
    assert [language_of(seed) for seed in snapshot.seeds] == ["A"]
    assert lesson.values()[f"long_term.{NAME}"] == 2
    before = lesson.rig.snapshots()
    lesson.rig.restart()
    assert lesson.rig.snapshots() == before, "only once"


def test_a_run_that_began_with_a_model_goes_on_with_it(tmp_path: Path) -> None:
    lesson = lesson_with(tmp_path / "memory.sqlite", brought(1, "A", uses=3))
    lesson.student.mirror.restore(lesson.rig.store._memories[NAME].stm.state())
    lesson.live(0, 22, STORY)
    assert lesson.events() == [(5, "stored", 1), (11, "stored", 1), (17, "stored", 1), (21, "changed", None)]
    assert lesson.model(1).uses == 3


@pytest.mark.parametrize("restart", [False, True])
def test_a_run_that_began_with_the_wrong_model_leaves_it(tmp_path: Path, restart: bool) -> None:
    lesson = lesson_with(tmp_path / "memory.sqlite", brought(1, "A"), brought(2, "B", uses=1))
    lesson.student.mirror.restore(lesson.rig.store._memories[NAME].stm.state())
    lesson.hear(pair(0, "A"))
    if restart:
        lesson.rig.restart()
    lesson.hear(pair(1, "A"))
    assert lesson.events() == [(1, "changed", None), (1, "recalled", 1)]


def test_a_run_that_has_begun_begins_with_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "memory.sqlite"
    lesson = Lesson(path)
    lesson.live(0, 3)
    before = lesson.rig.snapshots()
    lesson.rig.store.close()
    with MemoryFile(path) as file:
        file.keep_long_term([brought(1, "B")])
    lesson.rig.restart()
    assert lesson.rig.snapshots() == before
    assert lesson.values()[f"long_term.{NAME}"] == 1


def test_an_evolver_begins_with_the_model_that_was_brought(tmp_path: Path) -> None:
    lesson = lesson_with(tmp_path / "memory.sqlite", brought(1, "A"))
    published = lesson.rig.outside.subscriber(keys.CURRENT_MODEL)
    evolver = Evolver(MemoryBus(lesson.rig.fabric, BRAIN), lesson.rig.settings, NAME)
    for _ in range(5):
        evolver.step()
    (model,) = taken(published)
    assert (model.version, model.error < 1e-6) == (1, True)
    lesson.rig.store.step()
    (kept,) = lesson.rig.outside.query(keys.KEPT_MODEL, 1.0)
    assert kept.weights.tolist() == model.weights.tolist()


READS = config().reads(config().model[0])


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"reads": READS | {"note": "one_hot of 3"}}, "model communication 2 of the long-term memory reads other"),
        ({"reads": dict(reversed(READS.items()))}, "reads other variables"),
        ({"reads": {}}, "reads other variables"),
        ({"pairs": []}, "reads other variables"),
        ({"pairs": [msgspec.structs.replace(pair(0, "A"), note=5)]}, "reads other variables"),
        ({"layers": [2, 0, 1], "weights": np.zeros(1)}, r"layers \[2, 0, 1\]"),
        ({"layers": [3, 0, 2], "weights": np.zeros(2)}, r"layers \[3, 0, 2\]"),
        ({"layers": [3, 1], "weights": np.zeros(4)}, "layer sizes"),
    ],
)
def test_a_model_that_reads_something_else_is_a_clear_error(tmp_path: Path, fields: Plain, said: str) -> None:
    path = tmp_path / "memory.sqlite"
    with MemoryFile(path) as file:
        file.keep_long_term([brought(1, "A"), brought(2, "A", **fields)])
    with pytest.raises(MdbError, match=rf"memory\.sqlite cannot be used.*{said}.*mdb rescue"):
        MemoryStore(MemoryBus(Fabric(), BRAIN), config(), MemoryFile(path))


def test_models_of_names_that_the_experiment_lacks_are_left_alone(tmp_path: Path) -> None:
    lesson = lesson_with(tmp_path / "memory.sqlite", brought(1, "A", model="stranger", reads={}))
    lesson.live(0, 7)
    assert [(model.model, model.id) for model in lesson.rig.store._file.long_term()] == [(NAME, 1), ("stranger", 1)]


# ---- with a real evolver ----


def test_with_a_real_evolver_what_was_learnt_once_is_there_when_its_teacher_returns(tmp_path: Path) -> None:
    settings = config(evolution={"population": 100, "generations": 10})
    rig = Rig(tmp_path / "memory.sqlite", settings)
    evolver = Evolver(MemoryBus(rig.fabric, BRAIN), settings, NAME)
    published = rig.outside.subscriber(keys.CURRENT_MODEL)
    usual, seen = [], []
    for i in range(180):
        rig.give(pair(i, "ABA"[i // 60]))
        while evolver.step():
            pass
        rig.store.step()
        usual.append(rig.store.values()[f"usual_error.{NAME}"])
        seen += [(event.iteration, event.kind) for event in taken(rig.events)]
    assert taken(published)[-1].version == evolver.values()["version"]
    assert [iteration for iteration, kind in seen if kind == "changed"] == [61, 121]
    assert [iteration for iteration, kind in seen if kind == "recalled"] == [121]
    assert max(usual[121:]) < 0.05, "no mistake since it was recalled"
    assert max(usual[62:80]) > 0.2, "as there were when it was new"
