"""The operation cycle, driven by hand: each message when it should come, late, twice, or never."""

from typing import Any

import msgspec
import numpy as np
import pytest

from mdb_protocol import keys, messages
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.acting.optimizer import ENDING_S, Optimizer
from mdb_services.acting.outbox import UNSTORED
from mdb_services.acting.teachers import KEPT_AHEAD
from mdb_services.acting.waits import ASKED_S, MOST_ASKED_S
from mdb_services.experiment.brain import BrainConfig, brain_config
from mdb_services.mechanism.actions.spaces import Choices
from mdb_services.shell.elsewhere import BELIEVED_AFTER_S
from tests.services.small import (
    BRAIN,
    CONTENT,
    LOCKSTEP,
    config,
    config_of_vectors,
    content,
    done,
    in_ranges,
    model,
    perception,
)

OPTIMIZER = CONTENT["optimizer"]
PATIENCE_S, RESEND_S = 2.0, 0.5


def progress(iteration: int = 0, **fields: Any) -> messages.Progress:
    """What a memory store says that has the pairs before `iteration`."""
    none = np.array([], np.int64)
    plain = {"versions": {}, "unjudged": [], "judged": [], "notes": none, "choices": none, "iterations": none}
    return messages.Progress(iteration=iteration, **(plain | fields))


class Rig:
    """An optimizer, and robot, teacher, memory store and evolvers that a test plays by hand."""

    def __init__(self, settings: BrainConfig | None = None, *, teacher: bool = True) -> None:
        self.settings, self.fabric = settings or config(), Fabric()
        self.world = MemoryBus(self.fabric, BRAIN)
        self.presence = MemoryBus(self.fabric, BRAIN)
        if teacher:
            self.presence.token("teacher", "anna")
        self.progress = progress()
        self.world.queryable(keys.PROGRESS, lambda: self.progress)
        out = (keys.ACTION, keys.PAIR, keys.ITERATION, keys.FINISHED, keys.TIMING)
        self.inboxes = {row.path: self.world.subscriber(row) for row in out}
        self.now = 100.0
        self.optimizer = self.start()

    def start(self) -> Optimizer:
        self.optimizer = Optimizer(MemoryBus(self.fabric, BRAIN), self.settings, clock=lambda: self.now)
        return self.optimizer

    def settle(self) -> None:
        for _ in range(20):
            if not self.optimizer.step():
                return
        pytest.fail("the optimizer never came to rest")

    def wait(self, seconds: float) -> None:
        """Let time go by in the steps of a service's loop."""
        for _ in range(round(seconds * 10)):
            self.now += 0.1
            self.settle()

    def say(self, row: keys.Key, message: Any, **parameters: str) -> None:
        self.world.publisher(row, **parameters).put(message)
        self.settle()

    def sense(self, iteration: int, distance: float = 1.0, **fields: Any) -> None:
        self.say(keys.PERCEPTION, perception(iteration, distance, **fields))

    def command(self, iteration: int, note: int | None = 1, teacher: str = "anna") -> None:
        message = messages.Command(teacher=teacher, iteration=iteration, note=note)
        self.say(keys.COMMAND, message, teacher=teacher)

    def reward(self, iteration: int | None, value: float | None = 1.0, teacher: str = "anna") -> None:
        message = messages.Feedback(teacher=teacher, iteration=iteration, value=value)
        self.say(keys.FEEDBACK, message, teacher=teacher)

    def store(self, iteration: int, **versions: int) -> None:
        self.say(keys.PAIR_STORED, messages.PairStored(iteration=iteration, versions=versions))

    def learn(self, name: str, version: int, **fields: Any) -> None:
        self.say(keys.CURRENT_MODEL, model(name, version, **fields), model=name)

    def said(self, row: keys.Key) -> list[Any]:
        return list(iter(self.inboxes[row.path].take, None))

    def refused(self, row: keys.Key) -> int:
        return self.optimizer.bus.refusals.counts[row.path]

    def gave_up(self) -> dict[str, float]:
        values = self.optimizer.values()
        return {name.partition(".")[2]: count for name, count in values.items() if name.startswith("gave_up.")}


def test_a_full_cycle_gives_the_action_the_pair_and_the_report() -> None:
    rig = Rig()
    rig.learn("communication", 3)
    rig.sense(0, 1.5)
    assert rig.said(keys.ACTION) == [], "the command is awaited"
    rig.command(0, 2)
    (action,) = rig.said(keys.ACTION)
    assert (action.iteration, action.valid_for_s) == (0, 1.0)
    assert action.action == done(action.choice)
    rig.sense(1, 1.2)
    assert rig.said(keys.PAIR) == [], "the feedback is awaited"
    rig.reward(0, -0.5)
    (pair,) = rig.said(keys.PAIR)
    assert pair == messages.Pair(
        iteration=0, before={"distance": 1.5}, note=2, action=action.action, choice=action.choice,
        after={"distance": 1.2}, feedback=-0.5, versions={"communication": 3}, teacher="anna", judges=["anna"],
        best=1.0,
    )  # fmt: skip
    (report,) = rig.said(keys.ITERATION)
    assert (report.iteration, report.mode, report.note, report.feedback) == (0, "taught", 2, -0.5)
    assert (report.action, report.choice) == (action.action, action.choice)
    assert report.predicted == pytest.approx(0.5)
    assert report.prequential["communication"] == pytest.approx(1.0)
    assert [timing.iteration for timing in rig.said(keys.TIMING)] == [0]
    rig.command(1, None)
    assert rig.said(keys.ACTION)[0].iteration == 1


def test_a_capture_ends_the_pair_where_the_action_led_and_begins_the_next_elsewhere() -> None:
    rig = Rig(teacher=False)
    rig.sense(0, 1.5)
    rig.sense(1, event="capture", outcome={"distance": 0.3}, reading={"distance": 1.9})
    rig.sense(2, 1.8)
    pairs = rig.said(keys.PAIR)
    assert [(p.before["distance"], p.after["distance"]) for p in pairs] == [(1.5, 0.3), (1.9, 1.8)]


def test_without_a_teacher_nothing_is_awaited() -> None:
    rig = Rig(teacher=False)
    for i in range(4):
        rig.sense(i)
    assert [p.iteration for p in rig.said(keys.PAIR)] == [0, 1, 2]
    assert rig.gave_up() == {}


def test_a_teacher_who_says_nothing_is_awaited_as_long_as_the_patience_lasts() -> None:
    rig = Rig()
    rig.sense(0)
    rig.wait(PATIENCE_S - 0.2)
    assert rig.said(keys.ACTION) == []
    rig.wait(0.4)
    assert rig.said(keys.ACTION)[0].iteration == 0
    rig.sense(1)
    assert [p.note for p in rig.said(keys.PAIR)] == [None], "no command, so no feedback to wait for"
    assert rig.gave_up() == {"command": 1}


def test_a_teacher_who_leaves_is_not_awaited() -> None:
    rig = Rig()
    rig.sense(0)
    rig.presence.close()
    rig.settle()
    assert len(rig.said(keys.ACTION)) == 1
    assert rig.gave_up() == {}


def test_feedback_that_never_comes_is_given_up() -> None:
    rig = Rig()
    rig.sense(0)
    rig.command(0)
    rig.sense(1)
    rig.wait(PATIENCE_S - 0.2)
    assert rig.said(keys.PAIR) == []
    rig.wait(0.4)
    assert [(p.note, p.feedback) for p in rig.said(keys.PAIR)] == [(1, None)]
    assert rig.gave_up() == {"feedback": 1}
    rig.said(keys.ACTION)
    rig.wait(PATIENCE_S - 0.4)
    assert rig.said(keys.ACTION) == [], "the next command has a patience of its own"


def test_a_perception_shown_again_does_not_renew_the_patience_or_change_the_outcome() -> None:
    rig = Rig()
    rig.sense(0)
    rig.command(0)
    rig.sense(1, 0.7)
    for _ in range(5):
        rig.wait(0.5)
        rig.sense(1, 0.1)
    (pair,) = rig.said(keys.PAIR)
    assert pair.after == {"distance": 0.7}


def test_one_wait_in_vain_counts_once() -> None:
    rig = Rig(config(experiment=LOCKSTEP, optimizer=OPTIMIZER | {"lockstep_patience_s": 10.0}))
    rig.sense(0)
    rig.command(0)
    rig.sense(1)
    rig.reward(0)
    rig.wait(11.0)
    assert rig.gave_up() == {"command": 1, "models": 1}
    assert [a.iteration for a in rig.said(keys.ACTION)] == [1]


def test_an_action_without_effect_and_a_pair_without_answer_are_sent_again() -> None:
    rig = Rig(teacher=False)
    rig.sense(0)
    (action,) = rig.said(keys.ACTION)
    rig.wait(RESEND_S + 0.1)
    assert rig.said(keys.ACTION) == [action]
    rig.wait(2 * RESEND_S)
    assert rig.said(keys.ACTION) == [action]
    rig.sense(1)
    (pair,) = rig.said(keys.PAIR)
    rig.wait(RESEND_S + 0.1)
    assert rig.said(keys.PAIR) == [pair]
    rig.store(0)
    rig.wait(2.0)
    assert rig.said(keys.PAIR) == []


def test_pairs_without_memory_store_wait_and_are_sent_again_oldest_first_and_a_few_at_a_time() -> None:
    rig = Rig(config(experiment={"iterations": 100_000}, store={"when_full": "act"}), teacher=False)
    for i in range(3001):
        rig.sense(i)
    assert [p.iteration for p in rig.said(keys.PAIR)] == list(range(3000))
    rig.wait(RESEND_S + 0.1)
    again = [p.iteration for p in rig.said(keys.PAIR)]
    assert again == list(range(len(again)))
    assert 50 <= len(again) <= 1000
    for i in again:
        rig.store(i)
    rig.wait(RESEND_S + 0.1)
    assert rig.said(keys.PAIR)[0].iteration == len(again)
    assert rig.optimizer.values()["unacknowledged"] == 3000 - len(again)


def test_commands_and_feedback_count_for_their_iteration_however_they_come() -> None:
    rig = Rig()
    rig.command(1, 0)
    rig.command(0, 2)
    rig.command(0, 1)
    rig.reward(1, 0.25)
    rig.reward(0, -1.0)
    rig.reward(0, 1.0)
    rig.sense(0)
    rig.sense(1)
    rig.command(0, 0)
    rig.reward(0, 0.0)
    rig.sense(2)
    assert [(p.iteration, p.note, p.feedback) for p in rig.said(keys.PAIR)] == [(0, 2, -1.0), (1, 0, 0.25)]


def test_perceptions_that_are_not_awaited_change_nothing() -> None:
    rig = Rig(teacher=False)
    rig.sense(0)
    rig.sense(1, 1.1)
    rig.sense(0, 9.0)
    rig.sense(1, 9.0)
    rig.sense(2, 1.2)
    pairs = rig.said(keys.PAIR)
    assert [(p.iteration, p.before["distance"], p.after["distance"]) for p in pairs] == [(0, 1.0, 1.1), (1, 1.1, 1.2)]
    assert [a.iteration for a in rig.said(keys.ACTION)] == [2]


def test_a_flood_of_commands_and_rewards_to_come_needs_bounded_memory() -> None:
    rig = Rig()
    for i in range(3000, 0, -1):
        rig.command(i)
        rig.reward(i)
    assert len(rig.optimizer._teachers._commands) <= 1000
    assert len(rig.optimizer._teachers._feedback) <= 1000
    rig.sense(1)
    rig.sense(2)
    assert [(p.iteration, p.note, p.feedback) for p in rig.said(keys.PAIR)] == [(1, 1, 1.0)], "the next ones are kept"


@pytest.mark.parametrize("note", [3, 127])
def test_a_note_that_the_channel_lacks_is_refused_and_said(note: int) -> None:
    rig = Rig()
    rig.learn("communication", 1)
    rig.learn("object", 1)
    rig.sense(0)
    rig.command(0, note)
    assert rig.said(keys.ACTION) == []
    assert rig.refused(keys.COMMAND) == 1
    rig.command(0, 2)
    rig.sense(1)
    rig.reward(0)
    assert [p.note for p in rig.said(keys.PAIR)] == [2]


def test_models_that_do_not_fit_are_refused_and_the_good_one_stays() -> None:
    rig = Rig(teacher=False)
    rig.learn("object", 1)
    rig.learn("object", 2, layers=[5, 0, 1])
    rig.learn("object", 3, layers=[2, 0, 2])
    rig.learn("object", 4, layers=[2, 1])
    rig.learn("stranger", 5, layers=[2, 0, 1])
    assert rig.refused(keys.CURRENT_MODEL) == 4
    rig.sense(0)
    rig.sense(1)
    assert [p.versions for p in rig.said(keys.PAIR)] == [{"object": 1}]


def test_a_model_of_vectors_acts_on_all_their_numbers_and_one_that_does_not_fit_is_refused() -> None:
    rig = Rig(config_of_vectors(), teacher=False)
    rig.learn("object", 1, layers=[4, 0, 3])
    rig.learn("object", 2, layers=[4, 0, 1])
    rig.learn("object", 3, layers=[2, 0, 1])
    assert rig.refused(keys.CURRENT_MODEL) == 2
    for i, sonar in enumerate(([0.0, 2.0, 4.0], [1.0, 2.0], [1.0, 2.0, 3.0], [1.0, 1.0, 1.0])):
        rig.sense(i, reading={"sonar": sonar}, outcome={"sonar": sonar})
    pairs, reports = rig.said(keys.PAIR), rig.said(keys.ITERATION)
    assert [report.mode for report in reports] == ["alone", "random", "alone"]
    assert [pair.versions for pair in pairs] == [{"object": 1}] * 3
    assert [pair.after["sonar"] for pair in pairs] == [[1.0, 2.0], [1.0, 2.0, 3.0], [1.0, 1.0, 1.0]]
    assert [report.prequential.keys() for report in reports] == [set(), set(), {"object"}]
    assert reports[2].prequential["object"] == pytest.approx((0.5**2 + 0.5**2 + 1) / 3), "0.5 is foreseen of the last"


def test_a_model_is_believed_as_far_as_the_support_that_came_with_it() -> None:
    """All actions are promised 0.5, which is not enough; what nothing supports may be better, and is tried."""
    seeking = CONTENT["mode"][0] | {"reach": 0.2, "aspiration": 0.8, "curiosity": 0.9}
    settings = brain_config(content() | {"mode": [seeking]}, "small.toml")
    places = np.array([[0, 1, 0, place] for place in (0, -1, 1)], np.float32)  # note 1, the ranks of the choices
    for support, explores in ((places[:1], True), (places, False), (None, False)):
        rig = Rig(settings)
        current = msgspec.structs.replace(model("communication"), support=support)
        rig.say(keys.CURRENT_MODEL, current, model="communication")
        rig.sense(0)
        rig.command(0, 1)
        (action,) = rig.said(keys.ACTION)
        assert (action.intention.explored, action.choice != 0) == (explores, explores)


def test_a_robot_that_senses_nothing_or_something_else_is_acted_upon_at_random() -> None:
    rig = Rig(teacher=False)
    rig.learn("object", 1)
    rig.sense(0, reading={}, outcome={})
    rig.sense(1, reading={"sound": 3.0, "note": 1.0}, outcome={})
    rig.sense(2)
    assert [r.mode for r in rig.said(keys.ITERATION)] == ["random", "random"]


def test_lockstep_waits_for_the_acknowledgement_and_the_models_of_the_last_pair() -> None:
    rig = Rig(config(experiment=LOCKSTEP), teacher=False)
    rig.sense(0)
    rig.sense(1)
    rig.said(keys.ACTION)
    rig.store(0, object=1, communication=0)
    assert rig.said(keys.ACTION) == []
    rig.learn("object", 1)
    assert [a.iteration for a in rig.said(keys.ACTION)] == [1]


def test_lockstep_does_not_give_up_a_slow_teacher_before_its_own_patience() -> None:
    rig = Rig(config(experiment=LOCKSTEP, optimizer=OPTIMIZER | {"lockstep_patience_s": 20.0}))
    rig.sense(0)
    rig.wait(10.0)
    assert rig.said(keys.ACTION) == [], "a loaded machine must not make another run of the same seed"
    rig.command(0)
    rig.sense(1)
    rig.wait(10.0)
    assert rig.said(keys.PAIR) == []
    rig.reward(0)
    assert rig.gave_up() == {}
    assert [(p.note, p.feedback) for p in rig.said(keys.PAIR)] == [(1, 1.0)]


@pytest.mark.parametrize(("pace", "waits"), [(LOCKSTEP, True), (CONTENT["experiment"], False)])
def test_lockstep_waits_for_an_expected_teacher_who_is_started_again(pace: Any, waits: bool) -> None:
    """After his death, and after the router's, his token is not there for a while."""
    rig = Rig(config(experiment=pace), teacher=False)
    bus = MemoryBus(rig.fabric, BRAIN)
    rig.optimizer = Optimizer(bus, rig.settings, clock=lambda: rig.now, expected=frozenset({"teacher/script"}))
    rig.sense(0)
    assert (rig.said(keys.ACTION) == []) is waits
    rig.command(0)
    rig.sense(1)
    assert (rig.said(keys.PAIR) == []) is waits, "his feedback"
    if waits:
        rig.reward(0)
        assert [pair.note for pair in rig.said(keys.PAIR)] == [1]


def test_the_same_messages_give_the_same_run() -> None:
    def run() -> list[Any]:
        rig = Rig(config(experiment=LOCKSTEP), teacher=False)
        for i in range(5):
            rig.learn("object", i)
            rig.sense(i, 1.0 - 0.1 * i)
            rig.store(i - 1, object=i) if i else None
            rig.learn("object", i, last=0.1 * i)
        return rig.said(keys.PAIR) + rig.said(keys.ITERATION)

    assert run() == run()


def test_a_restarted_optimizer_goes_on_where_the_robot_is() -> None:
    rig = Rig()
    rig.command(3, 2)
    robot = rig.world.publisher(keys.PERCEPTION)
    robot.put(perception(3))
    rig.optimizer.bus.close()
    rig.start()
    rig.settle()
    assert [a.iteration for a in rig.said(keys.ACTION)] == [3]
    rig.sense(4)
    rig.reward(3)
    assert [(p.iteration, p.note) for p in rig.said(keys.PAIR)] == [(3, 2)]


def test_a_robot_that_moved_on_before_the_action_was_chosen_is_followed() -> None:
    rig = Rig()
    rig.sense(2, 1.0)
    rig.sense(3, 0.5)
    rig.command(2)
    assert rig.said(keys.ACTION) == []
    rig.command(3)
    rig.sense(4)
    rig.reward(3)
    assert [(p.iteration, p.before["distance"]) for p in rig.said(keys.PAIR)] == [(3, 0.5)]


def test_a_robot_that_insists_to_be_further_than_the_action_led_is_followed_and_no_pair_is_made_up() -> None:
    rig = Rig(teacher=False)
    rig.sense(0)
    for _ in range(round(BELIEVED_AFTER_S / 0.25) + 1):
        rig.sense(3, 0.5)
        rig.wait(0.3)
    rig.sense(4, 0.4)
    assert [(p.iteration, p.before["distance"]) for p in rig.said(keys.PAIR)] == [(3, 0.5)]
    assert [a.iteration for a in rig.said(keys.ACTION)][-1] == 4


def test_a_perception_from_far_ahead_does_not_move_the_count() -> None:
    rig = Rig(teacher=False)
    for far in (6, 2**53):
        rig.sense(far)
        rig.wait(BELIEVED_AFTER_S + 0.1)
        rig.sense(far)
    assert rig.said(keys.FINISHED) == [], "there is nothing beyond the last iteration"
    rig.sense(0)
    for _ in range(30):
        rig.sense(4, 0.1)
        rig.sense(2**53, 0.1)
        rig.sense(0, 0.1)
        rig.wait(0.1)
    assert rig.refused(keys.PERCEPTION) == 64
    rig.sense(1, 1.2)
    assert [(p.iteration, p.after["distance"]) for p in rig.said(keys.PAIR)] == [(0, 1.2)]


def test_commands_feedback_and_acknowledgements_of_what_never_was_are_refused() -> None:
    rig = Rig()
    rig.sense(0)
    for far in (KEPT_AHEAD + 1, 2**53):
        rig.command(far)
        rig.reward(far)
        rig.store(far, object=2**53)
    rig.store(0, object=2**53)
    assert (rig.refused(keys.COMMAND), rig.refused(keys.FEEDBACK), rig.refused(keys.PAIR_STORED)) == (2, 2, 3)
    assert rig.optimizer._models.required == {}
    rig.command(KEPT_AHEAD)
    rig.command(0)
    rig.sense(1)
    rig.reward(0)
    assert [p.iteration for p in rig.said(keys.PAIR)] == [0]
    assert (rig.refused(keys.COMMAND), rig.refused(keys.FEEDBACK)) == (2, 2)


def test_a_robot_that_began_anew_takes_the_brains_count() -> None:
    rig = Rig(teacher=False)
    rig.progress = progress(3)
    rig.start()
    rig.settle()
    rig.sense(0, 1.9)
    (action,) = rig.said(keys.ACTION)
    assert action.iteration == 3
    rig.sense(0, 1.9)
    rig.sense(4, 1.8, done=action)
    assert [(p.iteration, p.before["distance"]) for p in rig.said(keys.PAIR)] == [(3, 1.9)]


def test_the_end_waits_for_the_last_acknowledgement() -> None:
    rig = Rig(teacher=False)
    for i in range(6):
        rig.sense(i)
        rig.store(i - 2) if i > 1 else None
    assert [p.iteration for p in rig.said(keys.PAIR)] == [0, 1, 2, 3, 4]
    assert rig.said(keys.FINISHED) == []
    rig.store(4)
    assert [f.iterations for f in rig.said(keys.FINISHED)] == [5]
    rig.sense(7)
    rig.wait(1.0)
    assert rig.said(keys.FINISHED) == []
    assert max(a.iteration for a in rig.said(keys.ACTION)) == 4


def test_the_end_does_not_wait_for_ever() -> None:
    rig = Rig(teacher=False)
    for i in range(6):
        rig.sense(i)
    rig.wait(ENDING_S - 0.5)
    assert rig.said(keys.FINISHED) == []
    rig.wait(1.0)
    assert len(rig.said(keys.FINISHED)) == 1
    rig.said(keys.PAIR)
    rig.wait(RESEND_S + 0.1)
    assert [p.iteration for p in rig.said(keys.PAIR)] == [0, 1, 2, 3, 4], "a store that comes back gets them still"


def test_an_optimizer_that_starts_at_the_end_says_so() -> None:
    rig = Rig(teacher=False)
    rig.sense(5)
    assert len(rig.said(keys.FINISHED)) == 1
    assert rig.said(keys.ACTION) == []


def judged(pair: messages.Pair) -> tuple[int, float | None, list[str]]:
    return pair.iteration, pair.feedback, pair.judges


def test_late_feedback_is_credited_to_the_iteration_it_names() -> None:
    rig = Rig()
    for i in range(3):
        rig.sense(i)
        rig.command(i)
        rig.sense(i + 1)
        rig.wait(PATIENCE_S + 0.1)
    assert [judged(p) for p in rig.said(keys.PAIR) if p.feedback is not None] == []
    rig.reward(1, -0.5)
    rig.command(3)
    (pair,) = rig.said(keys.PAIR)
    assert judged(pair) == (1, -0.5, ["anna"])
    rig.reward(1, 1.0)
    rig.reward(0, 1.0, teacher="ben")
    rig.sense(4)
    rig.reward(3)
    rig.command(4)
    assert [p.iteration for p in rig.said(keys.PAIR)] == [3], "once, and only by the teacher who was obeyed"


def test_a_pair_is_sent_until_it_is_stored_with_its_late_feedback() -> None:
    rig = Rig()
    rig.sense(0)
    rig.command(0)
    rig.sense(1)
    rig.wait(PATIENCE_S + 0.1)
    rig.reward(0, 1.0)
    rig.command(1, None)
    rig.said(keys.PAIR)
    rig.store(0)
    rig.wait(RESEND_S + 0.1)
    assert judged(rig.said(keys.PAIR)[0]) == (0, 1.0, ["anna"])
    rig.say(keys.PAIR_STORED, messages.PairStored(iteration=0, versions={}, judged=True))
    rig.wait(3 * RESEND_S)
    assert rig.said(keys.PAIR) == []


def test_feedback_for_what_is_long_over_is_counted_and_dropped() -> None:
    rig = Rig(config(experiment={"iterations": 100}, optimizer=OPTIMIZER | {"feedback_window": 3}), teacher=False)
    for i in range(6):
        rig.sense(i)
    rig.said(keys.PAIR)
    rig.reward(1)
    assert (rig.said(keys.PAIR), rig.refused(keys.FEEDBACK)) == ([], 1)
    rig.reward(3)
    rig.sense(6)
    assert [judged(p) for p in rig.said(keys.PAIR)] == [(5, None, []), (3, 1.0, ["anna"])]


AT_RANDOM: dict[str, Any] = {
    "experiment": {"iterations": 1000},
    "optimizer": OPTIMIZER | {"random_iterations": 1000},
    "store": {"when_full": "act"},
}


def lessons(rig: Rig, first: int, count: int, lag: int) -> dict[int, float]:
    """Teach with feedback that names no iteration; return what each action deserves."""
    rng, deserved, choices = np.random.default_rng(first), {}, {}
    for i in range(first, first + count):
        rig.sense(i)
        if i - 1 - lag in deserved:
            rig.reward(None, deserved[i - 1 - lag])
        rig.command(i, note := int(rng.integers(3)))
        choices |= {action.iteration: action.choice for action in rig.said(keys.ACTION)}
        deserved[i] = (1.0, 0.0, -1.0)[(note + choices[i]) % 3]
    return deserved


def credited(rig: Rig) -> dict[int, float]:
    pairs = rig.said(keys.PAIR)
    assert len({pair.iteration for pair in pairs if pair.feedback is None}) > 0, "nobody waits for it"
    return {pair.iteration: pair.feedback for pair in pairs if pair.feedback is not None}


def test_feedback_that_names_no_iteration_is_credited_to_what_it_is_for_and_not_waited_for() -> None:
    rig = Rig(config(**AT_RANDOM))
    rig.reward(None, None)
    deserved = lessons(rig, 0, 120, lag=2)
    assert credited(rig) == {i: deserved[i] for i in range(117)}
    assert rig.gave_up() == {}
    values = rig.optimizer.values()
    assert (values["late_least.anna"], values["late_most.anna"]) == (2.0, 2.0)


def test_an_optimizer_that_was_started_again_finds_out_anew_how_late_feedback_is() -> None:
    rig = Rig(config(**AT_RANDOM))
    rig.reward(None, None)
    lessons(rig, 0, 60, lag=1)
    rig.said(keys.PAIR)
    died(rig, iteration=60)
    assert credited_nothing(rig), "what was said before is for nothing that is known of"
    assert "late_most.anna" not in rig.optimizer.values()
    deserved = lessons(rig, 60, 80, lag=1)
    assert credited(rig) == {i: deserved[i] for i in range(60, 138)}


def credited_nothing(rig: Rig) -> bool:
    return all(pair.feedback is None for pair in rig.said(keys.PAIR))


def test_feedback_without_names_that_comes_in_a_heap_is_for_nothing() -> None:
    rig = Rig(config(**AT_RANDOM))
    for i in range(200):
        rig.sense(i)
        for _ in range(30):
            rig.reward(None, 1.0)
        rig.command(i)
    assert credited_nothing(rig)
    assert rig.gave_up() == {}


def test_the_report_says_who_was_heard_and_who_holds_the_word() -> None:
    rig = Rig()
    rig.presence.token("teacher", "ben")
    rig.sense(0)
    rig.command(0, 2, teacher="ben")
    rig.command(0, 1)
    rig.sense(1)
    rig.reward(0, 0.5, teacher="ben")
    (report,) = rig.said(keys.ITERATION)
    assert (report.teacher, report.note, report.judges, report.holder) == ("ben", 2, ["ben"], "ben")


def test_a_note_that_the_ear_heard_is_a_command() -> None:
    rig = Rig()
    rig.sense(0)
    rig.say(keys.HEARD, messages.Command(teacher="anna", iteration=0, note=2), teacher="anna")
    rig.sense(1)
    rig.reward(0)
    assert [(p.note, p.teacher) for p in rig.said(keys.PAIR)] == [(2, "anna")]


def test_without_a_place_for_its_pairs_the_robot_waits() -> None:
    rig = Rig(config(experiment={"iterations": 100_000}), teacher=False)
    for i in range(UNSTORED + 2):
        rig.sense(i)
    rig.wait(5.0)
    waiting = rig.optimizer.values()["unacknowledged"]
    acted = {action.iteration for action in rig.said(keys.ACTION)}
    assert (max(acted), waiting) == (UNSTORED, UNSTORED + 1)
    for i in range(UNSTORED):
        rig.store(i)
    assert [action.iteration for action in rig.said(keys.ACTION)] == [UNSTORED + 1]


def test_nothing_is_done_before_the_memory_store_says_how_far_it_is() -> None:
    rig = Rig(teacher=False)
    rig.world.queryable(keys.PROGRESS, lambda: None)
    rig.sense(0)
    rig.optimizer.bus.close()
    rig.start()
    rig.settle()
    assert rig.said(keys.ACTION) == []
    rig.world.queryable(keys.PROGRESS, lambda: rig.progress)
    rig.settle()
    assert [action.iteration for action in rig.said(keys.ACTION)] == [0]


def died(rig: Rig, **fields: Any) -> None:
    """The optimizer dies and another begins; the memory store says how far it is."""
    rig.progress = progress(**fields)
    rig.optimizer.bus.close()
    rig.start()
    rig.settle()


def test_an_optimizer_that_died_with_its_action_done_forms_the_pair_that_was_meant() -> None:
    rig = Rig()
    rig.learn("communication", 3)
    rig.sense(0, 1.5)
    rig.command(0, 2)
    (action,) = rig.said(keys.ACTION)
    rig.optimizer.bus.close()
    rig.learn("communication", 4, last=-0.5)
    rig.sense(1, 1.2, done=action)
    died(rig, iteration=0)
    rig.reward(0, -0.5)
    (pair,) = rig.said(keys.PAIR)
    assert pair == messages.Pair(
        iteration=0, before={"distance": 1.5}, note=2, action=action.action, choice=action.choice,
        after={"distance": 1.2}, feedback=-0.5, versions={"communication": 3}, teacher="anna", judges=["anna"],
        best=1.0,
    )  # fmt: skip
    (report,) = rig.said(keys.ITERATION)
    assert (report.mode, report.predicted, report.holder) == ("taught", action.intention.predicted, "anna")


def test_a_pair_that_is_stored_is_not_formed_again() -> None:
    rig = Rig()
    rig.sense(0)
    rig.command(0)
    (action,) = rig.said(keys.ACTION)
    rig.sense(1, done=action)
    rig.reward(0)
    rig.said(keys.PAIR)
    died(rig, iteration=1)
    rig.command(1, None)
    assert rig.said(keys.PAIR) == []
    assert [a.iteration for a in rig.said(keys.ACTION)] == [1]


def test_what_the_robot_did_counts_not_what_a_later_optimizer_wanted() -> None:
    rig = Rig(teacher=False)
    rig.sense(0)
    (action,) = rig.said(keys.ACTION)
    other = (action.choice + 1) % 3
    rig.sense(1, done=msgspec.structs.replace(action, action=done(other), choice=other))
    assert [(pair.action, pair.choice) for pair in rig.said(keys.PAIR)] == [(done(other), other)]


def test_late_feedback_finds_its_pair_after_a_restart() -> None:
    rig = Rig(config(experiment={"iterations": 100}))
    unjudged = messages.Pair(
        iteration=4, before={}, note=1, action=done(0), choice=0, after={}, feedback=None, versions={}, teacher="anna"
    )
    died(rig, iteration=5, unjudged=[unjudged])
    rig.reward(4, 0.5)
    rig.sense(5)
    rig.command(5)
    assert [judged(pair) for pair in rig.said(keys.PAIR)] == [(4, 0.5, ["anna"])]


def test_praise_is_measured_by_the_best_of_late_also_after_a_restart() -> None:
    rig = Rig(config(optimizer=OPTIMIZER | {"praise_window": 3}))
    for i, value in enumerate((0.5, -0.2, 0.4, 0.2, 0.1)):
        rig.sense(i)
        rig.command(i)
        rig.sense(i + 1)
        rig.reward(i, value)
    pairs = rig.said(keys.PAIR)
    assert [(pair.feedback, pair.best) for pair in pairs] == [
        (0.5, 1.0), (-0.2, 1.0), (0.4, 0.5), (0.2, 0.4), (0.1, 0.4),
    ]  # fmt: skip
    rig.progress = progress(4, judged=pairs[:4])
    rig.start()
    rig.sense(4)
    rig.command(4)
    rig.sense(5)
    rig.reward(4, 0.1)
    assert [(pair.iteration, pair.best) for pair in rig.said(keys.PAIR)] == [(4, 0.4)]


def test_what_was_tried_is_known_after_a_restart() -> None:
    rig = Rig(teacher=False)
    tried = {"notes": [-1, 2, 2], "choices": [0, 1, 9], "iterations": [3, 4, 2]}
    died(rig, iteration=5, **{name: np.array(values, np.int64) for name, values in tried.items()})
    assert tried_last(rig, None) == [3, -1, -1]
    assert tried_last(rig, 2) == [-1, 4, -1]


def test_what_was_tried_on_the_way_is_known_too() -> None:
    rig = Rig(teacher=False)
    rig.sense(0)
    (action,) = rig.said(keys.ACTION)
    assert tried_last(rig, None)[action.choice] == 0
    other = (action.choice + 1) % 3
    rig.optimizer.bus.close()
    rig.sense(1, done=msgspec.structs.replace(action, action=done(other), choice=other))
    died(rig, iteration=0)
    assert tried_last(rig, None)[other] == 0, "what the robot gives back of it"


def tried_last(rig: Rig, note: int | None) -> list[int]:
    """When each choice was taken last under a note; -1: never."""
    space = rig.optimizer._space
    assert isinstance(space, Choices)
    last: list[int] = space._last[note].tolist()
    return last


# ---- actions of a range ----


def test_without_choices_an_action_is_a_point_of_the_range() -> None:
    rig = Rig(brain_config(in_ranges(), "small.toml"), teacher=False)
    actions = []
    for i in range(4):
        rig.sense(i)
        actions += rig.said(keys.ACTION)
    pairs, reports = rig.said(keys.PAIR), rig.said(keys.ITERATION)
    assert [action.choice for action in actions] == [None] * 4
    assert all(action.action.keys() == {"turn"} and -90 <= action.action["turn"] <= 90 for action in actions)
    assert len({action.action["turn"] for action in actions}) == 4
    for said in (pairs, reports):
        assert [(one.action, one.choice) for one in said] == [(action.action, None) for action in actions[:3]]


def test_of_a_range_what_promises_most_is_done() -> None:
    """The object comes nearer the more is turned to the one side; the mode likes it far away."""
    rig = Rig(brain_config(in_ranges(), "small.toml"), teacher=False)
    weights = np.array([0.001, 0, 0, 0, -0.001, 0, 500, 500, 0], np.float32)  # two hidden units: distance, turn
    rig.say(
        keys.CURRENT_MODEL,
        msgspec.structs.replace(model("object"), layers=[2, 2, 1], weights=weights),
        model="object",
    )
    rig.sense(0)
    (action,) = rig.said(keys.ACTION)
    assert action.intention.mode == "alone"
    assert action.action["turn"] == pytest.approx(-90, abs=5)


def turned(iteration: int, turn: float, feedback: float | None) -> messages.Pair:
    """A pair of the past: note 1 and a turn."""
    return messages.Pair(
        iteration=iteration, before={}, note=1, action={"turn": turn}, after={}, feedback=feedback, versions={}
    )


def test_points_of_a_range_that_were_tried_are_known_after_a_restart() -> None:
    seeking = CONTENT["mode"][0] | {"aspiration": 0.8, "exploration": 1.0}
    rig = Rig(brain_config(in_ranges(mode=[seeking]), "small.toml"))
    judged, unjudged = [turned(0, 90.0, 0.1), turned(2, 40.0, 0.1)], [turned(1, 0.0, None), turned(3, -90.0, None)]
    died(rig, iteration=4, judged=judged, unjudged=unjudged)
    rig.learn("communication", 1, last=0.0)
    rig.sense(4)
    rig.command(4, 1)
    (action,) = rig.said(keys.ACTION)
    assert action.intention.explored
    assert action.action["turn"] == pytest.approx(-45, abs=8), "the farthest from all"


def test_an_optimizer_that_died_forms_the_pair_of_a_point_too() -> None:
    rig = Rig(brain_config(in_ranges(), "small.toml"), teacher=False)
    rig.sense(0)
    (action,) = rig.said(keys.ACTION)
    rig.optimizer.bus.close()
    rig.sense(1, done=action)
    died(rig, iteration=0)
    assert [(pair.action, pair.choice) for pair in rig.said(keys.PAIR)] == [(action.action, None)]
    other = msgspec.structs.replace(rig.said(keys.ACTION)[-1], action={"turn": 1.5})
    rig.sense(2, done=other)
    assert [pair.action for pair in rig.said(keys.PAIR)] == [{"turn": 1.5}], "what the robot did counts"


def test_pairs_on_their_way_while_the_optimizer_died_do_not_cost_the_last_one() -> None:
    rig = Rig(config(experiment={"iterations": 100}), teacher=False)
    for i in range(5):
        rig.sense(i)
    (action,) = rig.said(keys.ACTION)
    rig.optimizer.bus.close()
    rig.said(keys.PAIR)
    rig.sense(5, 0.5, done=action)
    died(rig, iteration=2)
    assert [(pair.iteration, pair.after) for pair in rig.said(keys.PAIR)] == [(4, {"distance": 0.5})]


def ask(rig: Rig, row: keys.Key, iteration: int) -> None:
    """Anna asks to be waited for with her note, or her feedback."""
    if row is keys.COMMAND:
        rig.say(row, messages.Command(teacher="anna", iteration=iteration, note=None, later=True), teacher="anna")
    else:
        rig.say(row, messages.Feedback(teacher="anna", iteration=iteration, value=None, later=True), teacher="anna")


def test_a_teacher_who_asks_for_it_is_waited_for_as_long_as_he_goes_on_asking() -> None:
    rig = Rig()
    rig.sense(0)
    for _ in range(20):
        rig.wait(1.0)
        ask(rig, keys.COMMAND, 0)
    assert rig.said(keys.ACTION) == []
    rig.command(0)
    assert rig.said(keys.ACTION)[0].intention.note == 1, "the note that comes in the end counts"
    rig.sense(1)
    for _ in range(20):
        rig.wait(1.0)
        ask(rig, keys.FEEDBACK, 0)
    assert rig.said(keys.PAIR) == []
    rig.reward(0, 0.5)
    assert [p.feedback for p in rig.said(keys.PAIR)] == [0.5]
    assert rig.gave_up() == {}


@pytest.mark.parametrize("row", [keys.COMMAND, keys.FEEDBACK], ids=lambda row: row.path)
def test_who_asks_no_more_has_the_usual_time_once_more_and_who_is_gone_has_none(row: keys.Key) -> None:
    for leaves in (False, True):
        rig = Rig()
        rig.sense(0)
        awaited = keys.ACTION
        if row is keys.FEEDBACK:
            rig.command(0)
            rig.sense(1)
            awaited = keys.PAIR
            rig.said(keys.ACTION)
        rig.wait(PATIENCE_S - 0.2)
        ask(rig, row, 0)
        rig.wait(PATIENCE_S - 0.2)
        assert rig.said(awaited) == []
        if leaves:
            rig.presence.close()
            rig.settle()
        else:
            rig.wait(0.4)
        assert len(rig.said(awaited)) == 1
        assert sum(rig.gave_up().values()) == (not leaves)


@pytest.mark.parametrize("row", [keys.COMMAND, keys.FEEDBACK], ids=lambda row: row.path)
def test_however_often_a_teacher_asks_there_is_an_end(row: keys.Key) -> None:
    rig = Rig()
    rig.sense(0)
    awaited = keys.ACTION
    if row is keys.FEEDBACK:
        rig.command(0)
        rig.sense(1)
        awaited = keys.PAIR
    for _ in range(int(MOST_ASKED_S) - 1):
        rig.now += 1.0
        ask(rig, row, 0)
    assert rig.said(awaited) == []
    for _ in range(2):
        rig.now += 1.0
        ask(rig, row, 0)
    assert {sent.iteration for sent in rig.said(awaited)} == {0}
    assert sum(rig.gave_up().values()) == 1


def test_feedback_and_the_next_command_are_waited_for_no_longer_together() -> None:
    rig = Rig()
    rig.sense(0)
    rig.command(0)
    rig.sense(1)
    rig.said(keys.ACTION)
    for _ in range(400):
        rig.now += 1.0
        ask(rig, keys.FEEDBACK, 0)
    rig.reward(0, 0.5)
    for _ in range(int(MOST_ASKED_S) - 401):
        rig.now += 1.0
        ask(rig, keys.COMMAND, 1)
    assert rig.said(keys.ACTION) == []
    for _ in range(2):
        rig.now += 1.0
        ask(rig, keys.COMMAND, 1)
    assert {sent.iteration for sent in rig.said(keys.ACTION)} == {1}


def test_an_impatient_brain_waits_for_who_asks_once_a_second_too() -> None:
    rig = Rig(config(optimizer=OPTIMIZER | {"command_patience_s": 0.3}))
    rig.sense(0)
    for _ in range(5):
        ask(rig, keys.COMMAND, 0)
        rig.wait(1.0)
    assert rig.said(keys.ACTION) == []
    rig.wait(ASKED_S)
    assert len(rig.said(keys.ACTION)) == 1
