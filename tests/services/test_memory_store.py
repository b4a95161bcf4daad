"""The memory store on a real file: durable before acknowledged, once each, and the same after a restart."""

import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mdb_protocol import codec, keys, messages
from mdb_protocol.errors import MdbError
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.experiment.brain import BrainConfig, brain_config
from mdb_services.mechanism.feedback.praise import LATELY
from mdb_services.memory.file import MemoryFile
from mdb_services.memory.store import KEPT_WITHIN_S, RETRY_S, MemoryStore
from mdb_services.shell.elsewhere import BELIEVED_AFTER_S
from tests.services.small import BRAIN, CONTENT, LOCKSTEP, config, config_of_vectors, done, in_ranges, model, pair
from tests.services.store_rig import ITERATIONS, Rig, taken

RELEVANCE = {"recency": 0.3, "distance": 1.0, "current_error": 1.0, "entry_error": 0.5}


def inserted(change: messages.MemoryChange) -> tuple[str, int, int]:
    """Model, pair and version of an insert; it writes one slot and frees none."""
    (pair,), (_,) = change.pairs.tolist(), change.slots.tolist()
    assert (change.freed.size, change.seeds) == (0, [])
    return change.model, pair, change.version


MakeRig = Callable[..., Rig]


@pytest.fixture
def make_rig(tmp_path: Path) -> Iterator[MakeRig]:
    made: list[Rig] = []

    def make(settings: BrainConfig | None = None) -> Rig:
        made.append(Rig(tmp_path / "memory.sqlite", settings or config()))
        return made[-1]

    yield make
    for rig in made:
        rig.store.close()


def on_disk(path: Path) -> list[int]:
    """What another process finds in the file."""
    with sqlite3.connect(path) as db:
        return [row[0] for row in db.execute("SELECT iteration FROM pair ORDER BY iteration")]


def test_a_pair_is_on_disk_before_it_is_acknowledged(make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = make_rig()
    found: list[list[int]] = []
    put = rig.store._stored.put
    monkeypatch.setattr(rig.store._stored, "put", lambda message: (found.append(on_disk(rig.path)), put(message)))
    rig.give(pair(0), pair(1))
    assert found == [[0], [0, 1]]
    assert [answer.iteration for answer in taken(rig.stored)] == [0, 1]


def test_each_pair_changes_the_memory_of_every_model_it_has_the_variables_of(make_rig: MakeRig) -> None:
    rig = make_rig()
    rig.give(pair(0), pair(1, feedback=None), pair(2, note=None, feedback=None), pair(3, after={}))
    changes = taken(rig.changes)
    assert [inserted(c) for c in changes] == [
        ("communication", 0, 1), ("object", 0, 1), ("object", 1, 2), ("object", 2, 3), ("communication", 3, 2),
    ]  # fmt: skip
    assert [answer.versions for answer in taken(rig.stored)] == [
        {"communication": 1, "object": 1}, {"communication": 1, "object": 2}, {"communication": 1, "object": 3},
        {"communication": 2, "object": 3},
    ]  # fmt: skip
    assert [(c.inputs.shape, c.targets.shape) for c in changes[:2]] == [((1, 4), (1, 1)), ((1, 2), (1, 1))]
    snapshots = rig.snapshots()
    assert snapshots["communication"]["pairs"] == [0, 3]
    assert snapshots["object"]["pairs"] == [0, 1, 2]
    assert np.shape(snapshots["communication"]["inputs"]) == (2, 4)


def test_a_full_memory_says_who_left_and_where_the_new_one_is(make_rig: MakeRig) -> None:
    rig = make_rig()
    rig.give(*(pair(i) for i in range(6)))
    changes = [c for c in taken(rig.changes) if c.model == "object"]
    assert [(c.slots.tolist(), c.evicted.tolist()) for c in changes] == [
        ([0], []), ([1], []), ([2], []), ([3], []), ([0], [0]), ([1], [1]),
    ]  # fmt: skip
    assert rig.snapshots()["object"]["pairs"] == [4, 5, 2, 3]
    assert rig.snapshots()["object"]["slots"] == [0, 1, 2, 3]


def test_a_pair_sent_again_gets_the_same_answer_and_is_not_stored_twice(make_rig: MakeRig) -> None:
    rig = make_rig()
    rig.give(pair(0), pair(1))
    first, _ = taken(rig.stored)
    before = rig.snapshots()
    taken(rig.changes)
    rig.give(pair(0), pair(0, choice=2))
    assert taken(rig.stored) == [first, first]
    assert taken(rig.changes) == []
    assert rig.snapshots() == before
    assert rig.store.values()["duplicates"] == 2
    rig.restart()
    rig.give(pair(0))
    assert taken(rig.stored) == [first]
    assert on_disk(rig.path) == [0, 1]


def test_a_model_is_on_disk_with_the_next_pair_or_soon_without_one_or_at_the_end(make_rig: MakeRig) -> None:
    rig = make_rig()

    def versions() -> list[int]:
        with sqlite3.connect(rig.path) as db:
            rows = db.execute("SELECT payload FROM model").fetchall()
        encoding = codec.encoding_of(messages.CurrentModel)
        return [codec.decode(messages.CurrentModel, payload, encoding).version for (payload,) in rows]

    rig.give(pair(0))
    rig.show(model("object", 1))
    assert versions() == []
    rig.give(pair(1))
    assert versions() == [1]
    rig.show(model("object", 2))
    rig.now += KEPT_WITHIN_S / 2
    rig.show(model("object", 3))
    assert versions() == [1]
    rig.now += KEPT_WITHIN_S
    rig.store.step()
    assert versions() == [3]
    rig.show(model("object", 4))
    rig.store.close()
    assert versions() == [4]


@pytest.mark.parametrize("memory", [{}, RELEVANCE], ids=["first-in-first-out", "relevance"])
def test_a_restart_finds_the_same_memories_versions_and_models(make_rig: MakeRig, memory: dict[str, float]) -> None:
    rig = make_rig(config(memory=memory))
    for i in range(25):
        if i % 4 == 1:
            rig.show(model("object", i, last=0.1 * (i % 7)))
            rig.show(model("communication", i, last=-0.1 * (i % 5)))
        rig.give(pair(i, before={"distance": (0.37 * i) % 2}, after={"distance": (0.53 * i) % 2}))
    before, models = rig.snapshots(), rig.outside.query(keys.KEPT_MODEL, 1.0)
    states = {name: memory.stm.state() for name, memory in rig.store._memories.items()}
    rig.restart()
    assert rig.snapshots() == before
    assert [m.version for m in rig.outside.query(keys.KEPT_MODEL, 1.0)] == [m.version for m in models] == [21, 21]
    for name, memory_after in rig.store._memories.items():
        for field, array in memory_after.stm.state().items():
            np.testing.assert_array_equal(array, states[name][field], err_msg=f"{name} {field}")


@pytest.mark.parametrize("memory", [{}, RELEVANCE], ids=["first-in-first-out", "relevance"])
def test_a_run_with_restarts_goes_on_like_one_without(tmp_path: Path, memory: dict[str, float]) -> None:
    logs = []
    for name, restarts in (("straight", set()), ("broken", {6, 13})):
        rig = Rig(tmp_path / f"{name}.sqlite", config(memory=memory))
        for i in range(20):
            if i in restarts:
                rig.restart()
            rig.show(model("object", i + 1, last=0.1 * (i % 7)))
            rig.give(pair(i, before={"distance": (0.37 * i) % 2}, after={"distance": (0.53 * i) % 2}))
        changes = [codec.to_plain(change) for change in taken(rig.changes)]
        logs.append([change for i, change in enumerate(changes) if change not in changes[:i]])
        assert len(changes) - len(logs[-1]) == 2 * len(restarts), "the last change of each is said again"
        rig.store.close()
    assert len(logs[0]) == 40
    assert logs[0] == logs[1]


def test_a_failing_write_leaves_memory_and_disk_as_they_were(make_rig: MakeRig) -> None:
    rig = make_rig(config(memory=RELEVANCE))
    rig.give(*(pair(i) for i in range(6)))
    before = rig.snapshots()
    taken(rig.changes), taken(rig.stored)
    rig.store._file._db.execute("PRAGMA query_only = 1")
    rig.pairs.put(pair(6))
    rig.store.step()
    assert rig.snapshots() == before
    assert (taken(rig.changes), taken(rig.stored)) == ([], [])
    rig.store._file._db.execute("PRAGMA query_only = 0")
    rig.now += RETRY_S
    rig.give(pair(6))
    assert [inserted(c) for c in taken(rig.changes)] == [("communication", 6, 7), ("object", 6, 7)]
    answer, again = taken(rig.stored)
    assert answer == again
    assert answer.versions == {"communication": 7, "object": 7}
    after = rig.snapshots()
    assert 6 in after["object"]["pairs"]
    rig.restart()
    assert rig.snapshots() == after


def test_a_full_disk_acknowledges_nothing_and_loses_nothing(make_rig: MakeRig) -> None:
    rig = make_rig()
    rig.give(pair(0))
    taken(rig.stored)
    pages = rig.store._file._db.execute("PRAGMA page_count").fetchone()[0]
    rig.store._file._db.execute(f"PRAGMA max_page_count = {pages}")
    rig.now = 10.0
    given = 0
    while not rig.store.values()["disk_refuses"]:
        given += 1
        rig.give(pair(given))
        assert given < 500
    acknowledged = [answer.iteration for answer in taken(rig.stored)]
    assert acknowledged == list(range(1, given)), "all but the one that did not fit"
    rig.give(pair(given + 1))
    rig.show(model("object", 3))
    assert taken(rig.stored) == []
    rig.store._file._db.execute(f"PRAGMA max_page_count = {pages + 1000}")
    rig.now += RETRY_S
    rig.store.step()
    assert [answer.iteration for answer in taken(rig.stored)] == [given, given + 1]
    assert on_disk(rig.path) == list(range(given + 2))
    assert rig.store.values()["disk_refuses"] == 0


def test_after_a_full_disk_a_pair_meets_the_newest_models(make_rig: MakeRig) -> None:
    rig = make_rig(config(experiment=LOCKSTEP))
    rig.now = 1000.0
    rig.show(model("object", 1))
    pages = rig.store._file._db.execute("PRAGMA page_count").fetchone()[0]
    rig.store._file._db.execute(f"PRAGMA max_page_count = {pages}")
    given = -1
    while not rig.store.values()["disk_refuses"]:
        given += 1
        rig.give(pair(given, versions={}))
    rig.show(model("object", 2))
    rig.now += RETRY_S
    rig.store.step()
    assert rig.store.values()["unwritten"] >= 2, "it was tried again"
    (kept,) = rig.outside.query(keys.KEPT_MODEL, 1.0)
    assert kept.version == 2, "what came meanwhile is not forgotten"
    rig.store._file._db.execute(f"PRAGMA max_page_count = {pages + 1000}")
    rig.now += RETRY_S
    rig.store.step()
    taken(rig.stored)
    rig.give(pair(given + 1, versions={"object": 3}))
    assert taken(rig.stored) == []
    assert rig.store.values()["gave_up.models"] == 0
    rig.show(model("object", 3))
    assert [answer.iteration for answer in taken(rig.stored)] == [given + 1]


def test_after_a_full_disk_a_pair_still_waits_for_its_models(make_rig: MakeRig) -> None:
    rig = make_rig(config(experiment=LOCKSTEP))
    rig.now = 1000.0
    pages = rig.store._file._db.execute("PRAGMA page_count").fetchone()[0]
    rig.store._file._db.execute(f"PRAGMA max_page_count = {pages}")
    given = -1
    while not rig.store.values()["disk_refuses"]:
        given += 1
        rig.show(model("object", given))
        rig.give(pair(given, versions={"object": given}))
    rig.store._kept.clear()  # as after a death, of an evolver that has not come back yet
    rig.store._file._db.execute(f"PRAGMA max_page_count = {pages + 1000}")
    rig.now += RETRY_S
    rig.store.step()
    assert rig.store.values()["gave_up.models"] == 0, "its patience begins when it begins to wait"


def _filled(path: Path, settings: BrainConfig | None = None) -> None:
    rig = Rig(path, settings or config())
    rig.give(*(pair(i) for i in range(40)))
    rig.store.close()


def _damage_pages(path: Path) -> None:
    _filled(path)
    content = bytearray(path.read_bytes())
    content[4096:] = b"\xff" * (len(content) - 4096)
    path.write_bytes(content)


def _spoil_payloads(path: Path) -> None:
    _filled(path)
    with sqlite3.connect(path) as db:
        db.execute("UPDATE pair SET payload = x'c1'")


def _other_tables(path: Path) -> None:
    with sqlite3.connect(path) as db:
        db.execute("CREATE TABLE pair (a, b)")


def _other_experiment(path: Path) -> None:
    bigger = [one | {"capacity": 9} for one in CONTENT["model"]]
    _filled(path, brain_config(CONTENT | {"model": bigger}, "bigger.toml"))


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(b"not a database at all, but long enough to look at" * 100),
        lambda path: path.mkdir(),
        _damage_pages,
        _spoil_payloads,
        _other_tables,
        _other_experiment,
    ],
    ids=["text", "folder", "pages", "payloads", "tables", "capacity"],
)
def test_a_file_that_cannot_be_used_is_a_clear_error(tmp_path: Path, damage: Callable[[Path], object]) -> None:
    path = tmp_path / "memory.sqlite"
    damage(path)
    with pytest.raises(MdbError, match=r"memory\.sqlite.*[Mm]ove it away"):
        MemoryStore(MemoryBus(Fabric(), BRAIN), config(), MemoryFile(path))


def test_models_that_do_not_fit_are_refused_and_the_last_good_one_kept(make_rig: MakeRig) -> None:
    rig = make_rig()
    rig.show(model("object", 1))
    rig.show(model("object", 2, layers=[5, 0, 1]))
    rig.show(model("object", 3, layers=[2, 1]))
    rig.show(model("stranger", 4, layers=[2, 0, 1]))
    (kept,) = rig.outside.query(keys.KEPT_MODEL, 1.0)
    assert (kept.model, kept.version) == ("object", 1)
    assert rig.store.bus.refusals.counts[keys.CURRENT_MODEL.path] == 2
    rig.give(pair(0))
    assert len(taken(rig.stored)) == 1


@pytest.mark.parametrize("fields", [{"note": 99}, {"before": {"sound": 1.0}}])
def test_pairs_with_what_no_model_knows_are_stored_and_change_no_memory(make_rig: MakeRig, fields: dict) -> None:
    rig = make_rig()
    rig.give(pair(0, **({"before": {}} | fields)), pair(1))
    assert [answer.iteration for answer in taken(rig.stored)] == [0, 1]
    unknown = {c.model for c in taken(rig.changes) if c.pairs.tolist() == [0]}
    assert unknown == ({"communication"} if "before" in fields else set())


def test_pairs_that_this_experiment_cannot_have_are_refused(make_rig: MakeRig) -> None:
    rig = make_rig()
    rig.give(pair(0), pair(ITERATIONS), pair(2**53, before={}), pair(1, choice=3, action=done(0)), pair(1))
    assert [answer.iteration for answer in taken(rig.stored)] == [0, 1]
    assert rig.store.bus.refusals.counts[keys.PAIR.path] == 3
    (progress,) = rig.outside.query(keys.PROGRESS, 1.0)
    assert progress.iteration == 2


@pytest.mark.parametrize("fields", [
    {"choice": None, "action": done(1)}, {"choice": 2, "action": done(1)}, {"choice": 1, "action": {}},
    {"choice": 1, "action": {"turn": -19.9}}, {"choice": 1, "action": done(1) | {"speed": 0.0}},
])  # fmt: skip
def test_pairs_whose_action_is_no_choice_of_this_experiment_are_refused(make_rig: MakeRig, fields: dict) -> None:
    rig = make_rig()
    rig.give(pair(0, **fields), pair(1))
    assert [answer.iteration for answer in taken(rig.stored)] == [1]
    assert rig.store.bus.refusals.counts[keys.PAIR.path] == 1


def test_without_choices_any_point_of_the_ranges_is_stored_and_read_and_no_other(make_rig: MakeRig) -> None:
    rig = make_rig(brain_config(in_ranges(), "ranges.toml"))
    turns = [0.5, 90.0, -90.0, 12.25, 90.5]
    rig.give(*(pair(i, action={"turn": turned}) for i, turned in enumerate(turns)))
    rig.give(pair(5, choice=0), pair(5, action={}), pair(5, action={"turn": 0.0, "speed": 0.0}))
    assert [answer.iteration for answer in taken(rig.stored)] == [0, 1, 2, 3]
    assert rig.store.bus.refusals.counts[keys.PAIR.path] == 4
    inputs = np.array(rig.snapshots()["object"]["inputs"])
    assert inputs[:, 1] == pytest.approx([0.5 / 90, 1, -1, 12.25 / 90])
    before = rig.snapshots()
    rig.restart()
    assert rig.snapshots() == before
    (progress,) = rig.outside.query(keys.PROGRESS, 1.0)
    assert [array.tolist() for array in (progress.notes, progress.choices, progress.iterations)] == [[], [], []]
    assert [one.action["turn"] for one in progress.judged] == turns[:4]


def test_an_optimizer_that_begins_is_told_when_each_choice_was_taken_last_under_each_note(make_rig: MakeRig) -> None:
    rig = make_rig()
    taken_ = [(0, 1), (None, 1), (0, 2), (None, 1), (0, 1)]
    rig.give(*(pair(i, note=note, choice=choice) for i, (note, choice) in enumerate(taken_)))
    (progress,) = rig.outside.query(keys.PROGRESS, 1.0)
    told = zip(progress.notes.tolist(), progress.choices.tolist(), progress.iterations.tolist(), strict=True)
    assert sorted(told) == [(-1, 1, 3), (0, 1, 4), (0, 2, 2)]


def test_a_vector_enters_the_memory_number_by_number(make_rig: MakeRig) -> None:
    rig = make_rig(config_of_vectors())
    rig.give(
        pair(0, before={"sonar": [0.0, 2.0, 4.0]}, after={"sonar": [1.0, 2.0, 3.0]}),
        pair(1, before={"sonar": [0.0, 2.0]}, after={"sonar": [1.0, 2.0, 3.0]}),
        pair(2, before={"sonar": 0.5}, after={"sonar": [1.0, 2.0, 3.0]}),
    )
    assert [answer.iteration for answer in taken(rig.stored)] == [0, 1, 2]
    memory = rig.snapshots()["object"]
    assert memory["pairs"] == [0], "a vector of another length is as one that is not there"
    assert memory["inputs"] == [[-1, 0, 1, 0]]
    assert memory["targets"] == [[-0.5, 0, 0.5]]
    rig.show(model("object", 1, layers=[4, 0, 3]))
    rig.show(model("object", 2, layers=[4, 0, 1]))
    (kept,) = rig.outside.query(keys.KEPT_MODEL, 1.0)
    assert kept.version == 1
    rig.restart()
    assert rig.snapshots()["object"] == memory


def test_a_pair_from_far_ahead_is_stored_only_when_it_comes_again_and_again(make_rig: MakeRig) -> None:
    rig = make_rig()
    rig.give(pair(0))
    for i in range(30):
        rig.give(pair(500), pair(i + 1))
        rig.now += 0.1
    assert [answer.iteration for answer in taken(rig.stored)] == list(range(31))
    assert rig.store.bus.refusals.counts[keys.PAIR.path] == 30
    rig.give(pair(131), pair(40), pair(31))
    assert [answer.iteration for answer in taken(rig.stored)] == [131, 40, 31], "these may have overtaken one another"
    rig.give(pair(500))
    rig.now += BELIEVED_AFTER_S
    rig.give(pair(500))
    assert [answer.iteration for answer in taken(rig.stored)] == [500], "what is between is lost"


def test_in_lockstep_a_pair_waits_for_the_models_it_was_acted_upon(make_rig: MakeRig) -> None:
    rig = make_rig(config(experiment=LOCKSTEP))
    rig.give(pair(0, versions={"object": 2, "stranger": 7}), pair(1))
    assert taken(rig.stored) == []
    rig.show(model("object", 1))
    assert taken(rig.stored) == []
    rig.show(model("object", 2))
    assert [answer.iteration for answer in taken(rig.stored)] == [0, 1]


def test_in_lockstep_a_pair_does_not_wait_for_ever(make_rig: MakeRig) -> None:
    rig = make_rig(config(experiment=LOCKSTEP, optimizer={"lockstep_patience_s": 10.0}))
    rig.give(pair(0, versions={"object": 2}))
    rig.now = 9.9
    rig.store.step()
    assert taken(rig.stored) == []
    rig.now = 10.0
    rig.store.step()
    assert [answer.iteration for answer in taken(rig.stored)] == [0]
    assert rig.store.values()["gave_up.models"] == 1
    rig.give(pair(1, versions={"object": 2}))
    assert taken(rig.stored) == [], "each pair has its own patience"


def test_the_concurrent_pace_never_waits_for_models(make_rig: MakeRig) -> None:
    rig = make_rig()
    rig.give(pair(0, versions={"object": 99}))
    assert len(taken(rig.stored)) == 1


def test_late_feedback_enters_only_the_memories_that_lacked_it_and_stays_after_a_restart(make_rig: MakeRig) -> None:
    rig = make_rig()
    rig.give(pair(0, feedback=None), pair(1))
    taken(rig.changes), taken(rig.stored)
    rig.give(pair(0, feedback=0.5, judges=["anna"]), pair(0, feedback=-1.0), pair(0, feedback=None))
    assert [inserted(c) for c in taken(rig.changes)] == [("communication", 0, 2)]
    answers = taken(rig.stored)
    assert [(a.iteration, a.judged, a.versions) for a in answers] == [
        (0, True, {"communication": 2, "object": 2})
    ] * 3, "the second feedback, and the pair as it was, are answered and change nothing"
    before = [memory.snapshot() for memory in rig.store._memories.values()]
    rig.store.close()
    again = make_rig()
    assert again.store.values()["pairs"] == 2
    for old, new in zip(before, (m.snapshot() for m in again.store._memories.values()), strict=True):
        assert codec.encode(old) == codec.encode(new)
    kept = again.store._file.pair(0)
    assert kept is not None
    assert (kept.feedback, kept.judges) == (0.5, ["anna"])


def test_in_lockstep_late_feedback_waits_for_what_is_learnt_from_all_that_is_stored(make_rig: MakeRig) -> None:
    rig = make_rig(config(experiment=LOCKSTEP))
    rig.give(pair(0, feedback=None), pair(1, feedback=None))
    taken(rig.stored)
    rig.show(model("object", 1))
    rig.give(pair(0, feedback=0.5), pair(1, feedback=0.5))
    assert taken(rig.stored) == [], "now and then the error on it would be that of an older model"
    rig.show(model("object", 2))
    assert [(answer.iteration, answer.judged) for answer in taken(rig.stored)] == [(0, True)]
    rig.show(model("communication", 1))
    assert [(answer.iteration, answer.judged) for answer in taken(rig.stored)] == [(1, True)]


def test_an_optimizer_that_begins_is_told_the_newest_pairs_with_feedback_and_without(make_rig: MakeRig) -> None:
    rig = make_rig(config(optimizer={"feedback_window": 4}))
    count = LATELY + 11
    said = {i: 0.1 for i in range(count) if i % 3}
    rig.give(*(pair(i, feedback=said.get(i)) for i in range(count)))
    rig.give(pair(count - 1, feedback=0.5))  # late
    (progress,) = rig.outside.query(keys.PROGRESS, 1.0)
    said[count - 1] = 0.5
    newest = range(count - 4 - LATELY, count)
    assert [(p.iteration, p.feedback) for p in progress.judged] == [(i, said[i]) for i in newest if i in said]
    assert [p.iteration for p in progress.unjudged] == [i for i in newest[-4:] if i not in said]


def test_from_an_iteration_on_pairs_are_stored_and_nothing_is_learnt_of_them(make_rig: MakeRig) -> None:
    settings = config()
    until = msgspec.structs.replace(settings.store, learns_until=2)
    rig = make_rig(msgspec.structs.replace(settings, store=until))
    rig.give(pair(0), pair(1), pair(2), pair(3))
    assert on_disk(rig.path) == [0, 1, 2, 3]
    answers = taken(rig.stored)
    assert [answer.iteration for answer in answers] == [0, 1, 2, 3]
    assert [answer.versions["object"] for answer in answers] == [1, 2, 2, 2]
    assert rig.snapshots()["object"]["pairs"] == [0, 1]
    rig.restart()
    rig.give(pair(4))
    assert rig.snapshots()["object"]["pairs"] == [0, 1]


def test_pairs_are_not_acknowledged_while_the_file_is_not_in_its_place(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "memory.sqlite", config())
    rig.give(pair(0))
    assert len(taken(rig.stored)) == 1
    away = rig.path.with_name("away")
    rig.path.rename(away)
    rig.give(pair(1))
    assert taken(rig.stored) == []
    assert rig.store.values()["disk_refuses"] == 1.0
    away.rename(rig.path)
    rig.now += RETRY_S
    rig.give()
    assert [stored.iteration for stored in taken(rig.stored)] == [1]
