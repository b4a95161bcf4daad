"""Every policy keeps the contract; the Pioneer's judges what was done, and not what was meant."""

import math
import sys
from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdb_protocol import messages
from mdb_sim.bodies.pioneer.world import Placement, Pose, scene_of
from mdb_sim.body import NOTHING, Numbers
from mdb_sim.teaching.languages import TeacherError, make_language
from mdb_sim.teaching.policies.bullet import MANOEUVRES
from mdb_sim.teaching.policies.pioneer import PAPERS_TURNS_DEG, Reach
from mdb_sim.teaching.policies.plain import Named
from mdb_sim.teaching.policy import MEMBERS, OBEYED, likest, make_policy, obeyed
from mdb_sim.teaching.schedule import graded
from tests.conformance.policy_conformance import PolicyConformance
from tests.protocol.samples import fixed

NONE, SMALL_RIGHT, MEDIUM_RIGHT, LARGE_RIGHT, SMALL_LEFT, MEDIUM_LEFT, LARGE_LEFT = range(7)
BY_TURN = [LARGE_RIGHT, MEDIUM_RIGHT, SMALL_RIGHT, NONE, SMALL_LEFT, MEDIUM_LEFT, LARGE_LEFT]
STEPS_MISSED = [1.0, 1 / 3, -1 / 3, -1.0, -1.0, -1.0, -1.0]
METRES, HEADINGS = st.floats(-5.0, 5.0), st.floats(-7.0, 7.0)


class TestReach(PolicyConformance):
    options: dict[str, object] = {}  # noqa: RUF012

    def make(self):
        return make_policy("reach", self.options)

    def scenes(self):
        numbers = dict.fromkeys(("x_m", "y_m", "object_x_m", "object_y_m"), METRES)
        return st.fixed_dictionaries(numbers | {"heading_rad": HEADINGS, "light": METRES})

    def actions(self):
        return st.fixed_dictionaries({"turn": st.floats(-179.0, 179.0)}, optional={"gripper": METRES})

    def after(self, before, action):
        return turned(before, action["turn"])

    def obeying(self, policy, command):
        return {"turn": policy.turns_deg[command]}


class TestReachWithOtherTurns(TestReach):
    options = {"turns_deg": [60.0, -5.0, 5.0, -170.0, 1.0]}  # noqa: RUF012


class TestReachWithTwoTurns(TestReach):
    options = {"turns_deg": [-30.0, 30.0]}  # noqa: RUF012


class TestAvoid(TestReach):
    def make(self):
        return make_policy("mdb_sim.teaching.policies.pioneer:Avoid", self.options)


class TestFollowWall(TestReach):
    def make(self):
        return make_policy("mdb_sim.teaching.policies.pioneer:FollowWall", self.options)


class TestNamed(PolicyConformance):
    def make(self):
        return make_policy("mdb_sim.teaching.policies.plain:Named", {"commands": ["come", "go", "stay"]})

    def scenes(self):
        return st.fixed_dictionaries({"x_m": METRES})

    def actions(self):
        return st.fixed_dictionaries({"motor": METRES})

    def after(self, before, action):
        return before | {"x_m": before["x_m"] + action["motor"]}

    def obeying(self, policy, command):
        del policy
        return {"motor": float(command)}

    def test_it_wants_nothing_and_nobody_is_known_to_obey(self):
        named = Named(["come", "go"])
        assert named.want({}) is None
        assert [named.judge({}, {}, NOTHING, wanted) for wanted in range(2)] == [0.0, 0.0]


@cache
def machine(env: str) -> Any:
    """A machine of Gymnasium's, without its wrappers, that can be put anywhere."""
    made = pytest.importorskip("gymnasium").make(env).unwrapped
    made.reset(seed=1)
    return made


class TestBalance(PolicyConformance):
    names = ("x", "x_speed", "angle", "angle_speed")

    def make(self):
        return make_policy("balance", {})

    def scenes(self):
        ranges = (2.0, 3.0, 0.2, 3.0)
        numbers = {name: st.floats(-most, most) for name, most in zip(self.names, ranges, strict=True)}
        return st.fixed_dictionaries(numbers | {"reward": st.just(1.0)})

    def actions(self):
        return st.fixed_dictionaries({"motor": st.sampled_from([0.0, 1.0])})

    def after(self, before, action):
        cart = machine("CartPole-v1")
        cart.state, cart.steps_beyond_terminated = tuple(before[name] for name in self.names), None
        return before | dict(zip(self.names, map(float, cart.step(int(action["motor"]))[0]), strict=True))

    def obeying(self, policy, command):
        del policy
        return {"motor": float(command)}


class TestSwing(PolicyConformance):
    def make(self):
        return make_policy("swing", {})

    def scenes(self):
        numbers = {"position": st.floats(-1.2, 0.5), "speed": st.floats(-0.07, 0.07)}
        return st.fixed_dictionaries(numbers | {"reward": st.just(-1.0)})

    def actions(self):
        return st.fixed_dictionaries({"motor": st.sampled_from([0.0, 1.0, 2.0])})

    def after(self, before, action):
        car = machine("MountainCar-v0")
        car.state = before["position"], before["speed"]
        position, speed = car.step(int(action["motor"]))[0].tolist()
        return before | {"position": position, "speed": speed}

    def obeying(self, policy, command):
        del policy
        return {"motor": float(command)}


class TestUpright(PolicyConformance):
    def make(self):
        return make_policy("upright", {})

    def scenes(self):
        def scene(angle_rad: float, speed: float) -> Numbers:
            return {"cos": math.cos(angle_rad), "sin": math.sin(angle_rad), "speed": speed, "reward": 0.0}

        return st.builds(scene, st.floats(-math.pi, math.pi), st.floats(-8.0, 8.0))

    def actions(self):
        return st.fixed_dictionaries({"torque": st.floats(-2.0, 2.0)})

    def after(self, before, action):
        pendulum = machine("Pendulum-v1")
        pendulum.state = np.array([math.atan2(before["sin"], before["cos"]), before["speed"]])
        cos, sin, speed = pendulum.step(np.array([action["torque"]]))[0].tolist()
        return before | {"cos": cos, "sin": sin, "speed": speed}

    def obeying(self, policy, command):
        return {"torque": float(policy.commands[command])}


class TestNearer(PolicyConformance):
    def make(self):
        return make_policy("nearer", {"ahead": 2.0})

    def scenes(self):
        numbers = dict.fromkeys(("dx", "dy"), st.floats(-0.4, 0.4))
        return st.fixed_dictionaries(numbers | {"reward": st.just(-1.0)})

    def actions(self):
        return st.fixed_dictionaries(dict.fromkeys(("torque_1", "torque_2"), st.floats(-0.3, 0.3)))

    def after(self, before, action):
        """Return nothing: what it leads to depends on how fast the tip is."""
        del before, action

    def obeying(self, policy, command):
        del policy, command


@pytest.mark.parametrize(
    ("before_m", "after_m", "judged"),
    [(0.2, 0.19, 1.0), (0.2, 0.2, 0.4), (0.2, 0.23, -1.0), (0.005, 0.005, 1.0), (0.06, 0.0, -0.8)],
)
def test_who_will_soon_be_near_enough_is_praised_and_who_flies_past_is_not(before_m, after_m, judged):
    """Two actions on at the same speed: 0.17, 0.2, 0.29, 0.005 and, past the place, 0.12 m are left."""
    policy = make_policy("nearer", {"ahead": 2.0})
    found = policy.judge({"dx": before_m, "dy": 0.0}, {"dx": after_m, "dy": 0.0}, NOTHING, 0)
    assert found == pytest.approx(judged)


class TestDrive(PolicyConformance):
    def make(self):
        return make_policy("drive", {})

    def scenes(self):
        numbers = dict.fromkeys(("x_m", "y_m", "ball_x_m", "ball_y_m"), METRES)
        return st.fixed_dictionaries(numbers | {"heading_rad": HEADINGS, "light": METRES})

    def actions(self):
        known = st.sampled_from([{"steer": m.steer_rad, "drive": m.gear} for m in MANOEUVRES.values()])
        return known | st.fixed_dictionaries({"steer": st.floats(-0.6, 0.6), "drive": st.floats(-1.0, 1.0)})

    def after(self, before, action):
        done = [m for m in MANOEUVRES.values() if (m.steer_rad, m.gear) == (action["steer"], action["drive"])]
        return driven(before, done[0].turn_deg, done[0].gear) if done else None

    def obeying(self, policy, command):
        manoeuvre = MANOEUVRES[policy.commands[command]]
        return {"steer": manoeuvre.steer_rad, "drive": manoeuvre.gear}


def driven(before: Numbers, turn_deg: float, gear: float) -> Numbers:
    """The scene after a curve of 0.36 m, ahead or back."""
    middle_rad = before["heading_rad"] + math.radians(turn_deg) / 2
    x_m, y_m = before["x_m"] + 0.36 * gear * math.cos(middle_rad), before["y_m"] + 0.36 * gear * math.sin(middle_rad)
    heading_rad = math.remainder(before["heading_rad"] + math.radians(turn_deg), math.tau)
    return before | {"x_m": x_m, "y_m": y_m, "heading_rad": heading_rad}


class TestGuide(PolicyConformance):
    def make(self):
        return make_policy("guide", {})

    def scenes(self):
        numbers = dict.fromkeys(self.make().needs, st.floats(-1.0, 1.5))
        return st.fixed_dictionaries(numbers | {"light": METRES})

    def actions(self):
        turns = dict.fromkeys(("turn_base", "turn_shoulder", "turn_elbow"), st.floats(-0.4, 0.4))
        return st.fixed_dictionaries(turns)

    def after(self, before, action):
        del before, action  # how far the hand goes depends on how the arm is bent

    def obeying(self, policy, command):
        del policy, command


# ---- what the guide of an arm wants ----


def hand_and_point(hand: tuple[float, float, float], point: tuple[float, float, float]) -> Numbers:
    """A scene of an arm, of places that its eye sees: azimuth and elevation, rad, and range, m."""
    names = make_policy("guide", {}).needs
    placed = []
    for azimuth, elevation, range_m in (hand, point):
        level_m = range_m * math.cos(elevation)
        placed += [
            level_m * math.cos(azimuth), level_m * math.sin(azimuth), 0.36 + range_m * math.sin(elevation)
        ]  # fmt: skip
    return dict(zip(names, placed, strict=True))


HAND = (0.0, 0.1, 0.7)


@pytest.mark.parametrize(
    ("point", "command"),
    [
        ((0.5, 0.1, 0.7), "left"), ((-0.5, 0.1, 0.7), "right"), ((0.1, 0.5, 0.7), "up"), ((0.1, -0.5, 0.7), "down"),
        ((0.01, 0.1, 0.8), "out"), ((0.0, 0.08, 0.5), "in"),
    ],
)  # fmt: skip
def test_the_guide_wants_the_hand_to_go_where_it_is_farthest_off(point, command):
    guide = make_policy("guide", {})
    assert guide.commands[guide.want(hand_and_point(HAND, point))] == command


def test_the_guide_judges_by_the_distance_that_was_won():
    guide, point = make_policy("guide", {}), (0.24, 0.1, 0.7)
    before, left, right = hand_and_point(HAND, point), 0, 1

    def judged(azimuth: float, wanted: int) -> float:
        return guide.judge(before, hand_and_point((azimuth, *HAND[1:]), point), NOTHING, wanted)

    assert judged(0.24, left) == pytest.approx(1.0)
    assert judged(0.0, left) == pytest.approx(0.0)
    assert judged(0.12, left) == pytest.approx(0.5, abs=0.01) == judged(0.36, left), "too far is as bad as too short"
    assert judged(-0.3, left) == -1.0
    assert judged(-0.25, right) == pytest.approx(1.0), "a command that leads away is meant, too"
    assert judged(0.25, right) < -0.9


def test_the_guide_measures_by_what_one_action_can_win():
    guide, far = make_policy("guide", {}), (1.4, 0.1, 0.7)
    after = hand_and_point((0.25, *HAND[1:]), far)
    assert guide.judge(hand_and_point(HAND, far), after, NOTHING, 0) == pytest.approx(1.0)


# ---- what the driver of a car wants ----


@pytest.mark.parametrize(
    ("ahead_m", "aside_m", "command"),
    [
        (1.5, 0.0, "ahead"), (1.5, 0.5, "left 17"), (1.5, -0.5, "right 17"), (1.0, 1.0, "left 45"),
        (0.0, 0.5, "back, left 41"), (0.0, -0.5, "back, right 41"), (-1.5, -0.1, "back, right 41"),
        (0.1, 1.5, "left 45"), (-1.5, 0.1, "back, left 41"),
    ],
)  # fmt: skip
def test_the_driver_backs_off_from_a_ball_that_no_curve_leads_to(ahead_m, aside_m, command):
    drive = make_policy("drive", {})
    scene = {"x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0, "ball_x_m": ahead_m, "ball_y_m": aside_m}
    assert drive.commands[drive.want(scene)] == command


# ---- what the Pioneer's teacher wants ----


def turned(before: Numbers, turn_deg: float, advance_m: float = 0.2) -> Numbers:
    """The scene after a turn and an advance."""
    heading_rad = math.remainder(before["heading_rad"] + math.radians(turn_deg), math.tau)
    x_m, y_m = (before[n] + advance_m * f(heading_rad) for n, f in (("x_m", math.cos), ("y_m", math.sin)))
    return before | {"heading_rad": heading_rad, "x_m": x_m, "y_m": y_m}


def seen_at(phi_deg: float, heading_rad: float = 0.7) -> Numbers:
    """A scene in which the object is so far to the left of the front."""
    angle = heading_rad + math.radians(phi_deg)
    return scene_of(Placement(Pose(0.3, -0.2, heading_rad), 0.3 + math.cos(angle), -0.2 + math.sin(angle)))


def judged(turn_deg: float, wanted: int, policy: Reach | None = None) -> float:
    """What is said of a turn."""
    before = seen_at(10.0)
    return (policy or Reach()).judge(before, turned(before, turn_deg), NOTHING, wanted)


@pytest.mark.parametrize(
    ("phi_deg", "command"),
    [
        (0, NONE), (9, NONE), (11, SMALL_LEFT), (-11, SMALL_RIGHT), (40, MEDIUM_LEFT), (-66, MEDIUM_RIGHT),
        (70, LARGE_LEFT), (-90, LARGE_RIGHT), (170, LARGE_LEFT), (-170, LARGE_RIGHT),
    ],
)  # fmt: skip
def test_the_wanted_turn_best_faces_the_object(phi_deg, command):
    assert Reach().want(seen_at(phi_deg)) == command


@fixed
@given(st.floats(-180, 180), st.floats(-3.2, 3.2))
def test_no_other_turn_leaves_the_object_nearer_the_front(phi_deg, heading_rad):
    chosen = Reach().want(seen_at(phi_deg, heading_rad))
    left_deg = [abs(math.remainder(phi_deg - turn, 360)) for turn in PAPERS_TURNS_DEG]
    assert left_deg[chosen] == pytest.approx(min(left_deg), abs=1e-6)


def test_commands_are_named_by_their_turns_and_ordered_from_right_to_left():
    reach = Reach()
    assert reach.commands == ("ahead", "right 20", "right 45", "right 90", "left 20", "left 45", "left 90")
    assert reach.order == (3, 2, 1, 0, 4, 5, 6)


# ---- how it judges ----


def test_feedback_falls_with_each_step_of_turn_missed():
    turns_deg = [PAPERS_TURNS_DEG[command] for command in BY_TURN]
    said = [judged(turn_deg, LARGE_RIGHT) for turn_deg in turns_deg]
    assert said == pytest.approx(STEPS_MISSED)
    binary = [graded(judged(turn_deg, NONE), binary=True) for turn_deg in turns_deg]
    assert binary == [-1, -1, -1, 1, -1, -1, -1]
    assert [graded(value, binary=False) for value in said] == said


@fixed
@given(st.integers(0, 6), st.integers(0, 6))
def test_feedback_is_symmetric_and_full_only_for_obedience(command, done):
    value = judged(PAPERS_TURNS_DEG[done], command)
    assert value == judged(PAPERS_TURNS_DEG[command], done)
    assert (value == 1.0) == (command == done)
    assert -1.0 <= value <= 1.0


def test_the_motion_is_judged_and_not_the_action():
    """With motors that are swapped the teacher still teaches what he means."""
    before = seen_at(90.0)
    for swapped in (False, True):
        for told in range(7):
            turn_deg = (-1.0 if swapped else 1.0) * PAPERS_TURNS_DEG[told]
            after = turned(before, turn_deg)
            done = PAPERS_TURNS_DEG.index(turn_deg)
            assert likest(Reach(), before, after, NOTHING) == done
            assert (Reach().judge(before, after, NOTHING, LARGE_LEFT) >= OBEYED) == (turn_deg == 90.0)


def test_a_scene_is_judged_by_its_places_whatever_its_action_says():
    language, before = make_language("paper", Reach().order), seen_at(90.0)

    def scene(turn_deg: float, said_deg: float) -> messages.Scene:
        reached = turned(before, turn_deg)
        return messages.Scene(
            iteration=1, episode=0, successes=0, event=NOTHING, action={"turn": said_deg}, before=before,
            reached=reached, now=reached,
        )  # fmt: skip

    assert obeyed(Reach(), language, LARGE_LEFT, scene(90.0, -90.0)) is True
    assert obeyed(Reach(), language, LARGE_LEFT, scene(-90.0, 90.0)) is False


@pytest.mark.parametrize(
    ("turn_deg", "value"),
    [
        (67.5, 1.0 - 1.0 / 3.0), (78.75, 1.0 - 0.5 / 3.0), (56.25, 1.0 - 1.5 / 3.0),
        (45.0, 1 / 3), (32.5, 0.0), (10.0, -2 / 3), (-15.0, -1.0),
    ],
)  # fmt: skip
def test_a_turn_between_two_commands_is_worth_something_between(turn_deg, value):
    assert judged(turn_deg, LARGE_LEFT) == pytest.approx(value)


@fixed
@given(st.floats(-90.0, 90.0), st.floats(0.0, 10.0))
def test_a_turn_farther_from_what_was_wanted_is_never_worth_more(turn_deg, more_deg):
    for wanted, wanted_deg in enumerate(PAPERS_TURNS_DEG):
        farther_deg = turn_deg + math.copysign(more_deg, turn_deg - wanted_deg)
        assert judged(farther_deg, wanted) <= judged(turn_deg, wanted) + 1e-9


@pytest.mark.parametrize("off_deg", [-0.9, -0.1, 0.1, 0.9])
def test_what_a_teacher_cannot_see_is_no_miss(off_deg):
    """Physics errs by tenths of a degree; between 20 and 0 degrees 0.05 of a step are a degree."""
    for command, turn_deg in enumerate(PAPERS_TURNS_DEG):
        assert judged(turn_deg + off_deg, command) == 1.0
        assert judged(turn_deg + 3.0 * math.copysign(1.0, turn_deg or 1.0) * -1.0, command) < 1.0


def test_a_robot_that_was_stopped_while_it_turned_is_judged_by_how_far_it_came():
    before = seen_at(90.0)
    half = turned(before, 45.0, advance_m=0.0)
    assert Reach().judge(before, half, "bump", LARGE_LEFT) == pytest.approx(1 / 3)
    assert Reach().judge(before, before, "bump", LARGE_LEFT) == -1.0


@fixed
@given(HEADINGS, st.sampled_from(range(7)))
def test_headings_may_go_round_the_circle(heading_rad, command):
    before = seen_at(0.0, heading_rad)
    after = before | {"heading_rad": heading_rad + math.radians(PAPERS_TURNS_DEG[command])}
    for turns in (-1, 0, 1):
        whole = after | {"heading_rad": after["heading_rad"] + turns * math.tau}
        assert Reach().judge(before, whole, NOTHING, command) == 1.0


# ---- which turns, which policies ----


@pytest.mark.parametrize("turns_deg", [(), (0.0,), (20.0, 20.0), (0.0, 400.0), (0.0, math.nan)])
def test_turns_that_cannot_be_told_apart_are_refused(turns_deg):
    with pytest.raises(TeacherError, match="turns_deg"):
        make_policy("reach", {"turns_deg": turns_deg})


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("want", {}, "no policy named 'want'; expected 'reach', .* or 'package.module:Factory'"),
        ("no.such:Policy", {}, "policy='no.such:Policy': importing no.such failed"),
        ("mdb_sim.teaching.policy:Reach", {}, "no callable 'Reach'"),
        ("reach", {"turns": [1]}, r"policy='reach' does not take the options \{'turns': \[1\]\}"),
        ("reach", {"turns_deg": ["left", "right"]}, "does not take the options"),
        ("builtins:object", {}, f"gave a object without {', '.join(MEMBERS)}"),
    ],
)
def test_a_policy_that_cannot_be_had_says_why(name, options, says):
    with pytest.raises(TeacherError, match=says):
        make_policy(name, options)


def test_a_policy_beside_the_experiment_file_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    text = "from mdb_sim.teaching.policies.plain import Named\n\ndef make():\n    return Named(['up', 'down'])\n"
    (tmp_path / "wants_of_mine.py").write_text(text)
    try:
        assert make_policy("wants_of_mine:make", {}, tmp_path).commands == ("up", "down")
    finally:
        sys.modules.pop("wants_of_mine", None)


# ---- whether a note was obeyed ----


def test_of_a_scene_that_does_not_show_it_nobody_can_say_whether_a_note_was_obeyed():
    reach, language = Reach(), make_language("ordered", Reach().order)
    before = seen_at(-20.0)
    reached = turned(before, -20.0)
    scene = messages.Scene(
        iteration=1, episode=0, successes=0, event=NOTHING, action=None, before=before, reached=reached, now=reached
    )
    note = language.note(SMALL_RIGHT)
    assert obeyed(reach, language, note, scene) is True
    assert obeyed(reach, language, language.note(NONE), scene) is False
    assert obeyed(reach, language, 7, scene) is None, "a note of no language of his"
    assert obeyed(reach, language, -1, scene) is None
    replace = msgspec.structs.replace
    assert obeyed(reach, language, note, replace(scene, before=None)) is None, "nothing was done"
    assert obeyed(reach, language, note, replace(scene, before={"x_m": 0.0})) is None, "of another body"
    assert obeyed(reach, language, note, replace(scene, reached={})) is None
    now = replace(scene, now=seen_at(77.0))
    assert obeyed(reach, language, note, now) is True, "where the robot was put then does not count"


def test_what_cannot_be_told_was_neither_obeyed_nor_not():
    class Blind(Named):
        def judge(self, before, after, event, wanted):  # noqa: ARG002
            return None

    policy, before = Blind(["up", "down"]), {"x_m": 0.0}
    scene = messages.Scene(
        iteration=1, episode=0, successes=0, event=NOTHING, action=None, before=before, reached=before, now=before
    )
    assert obeyed(policy, make_language("paper", policy.order), 0, scene) is None
    assert likest(policy, before, before, NOTHING) is None
