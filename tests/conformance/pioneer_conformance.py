"""What both Pioneers must do beyond the contract: derive a test class from `PioneerConformance` and supply `make`.

Owns the rules of their world as tests: how an action moves, what ends it, what is a capture, what is perceived.
"""

import itertools
import math

import msgspec
import numpy as np
import pytest

from mdb_protocol import messages
from mdb_sim.bodies.pioneer.arena import ArenaRobot, bearing_rad, is_captured
from mdb_sim.bodies.pioneer.world import TRACK_M, PioneerConfig, Placement, Pose, placement_of
from mdb_sim.body import NOTHING, BodyError, Numbers
from mdb_sim.robot.course import Course
from mdb_sim.studies.twins import PAPERS_RULES, facing
from mdb_sim.teaching.policies.pioneer import PAPERS_TURNS_DEG

IN_FRONT = Placement(Pose(0.0, 0.0, 0.5), 0.7 * math.cos(0.5), 0.7 * math.sin(0.5))
FAR_AWAY = Placement(Pose(0.0, 0.0, 0.0), 4.0, 4.0)
BESIDE = Placement(Pose(0.0, 0.0, 0.0), 0.42 * math.cos(0.8), 0.42 * math.sin(0.8))
BEHIND = Placement(Pose(0.0, 0.0, 0.0), -1.0, 0.0)
STRAIGHT_ON = {"turn": 0.0}


class PioneerConformance:
    """The suite; a subclass supplies `make` and may lower `iterations` when its body is slow."""

    iterations = 150

    def make(self, **options: float) -> ArenaRobot:
        raise NotImplementedError

    @pytest.fixture(scope="class")
    @classmethod
    def robots(cls):
        made = cls().make(), cls().make()
        yield made
        for robot in made:
            robot.close()

    @pytest.fixture
    def robot(self, robots):
        return robots[0]

    @pytest.fixture
    def other(self, robots):
        return robots[1]

    def actions(self, seed: int, count: int) -> list[Numbers]:
        drawn = np.random.default_rng(seed).integers(len(PAPERS_TURNS_DEG), size=count)
        return [{"turn": PAPERS_TURNS_DEG[place]} for place in drawn.tolist()]

    def run(self, robot, seed, iterations):
        course = Course(robot, PAPERS_RULES, seed)
        return [course.last, *(course.act(values) for values in self.actions(seed, iterations))]

    def test_a_course_begins_at_iteration_zero_with_one_placement(self, robot):
        step = Course(robot, PAPERS_RULES, 3).last
        assert (step.iteration, step.event, step.successes, step.episode) == (0, NOTHING, 0, 0)
        assert step.now == step.reached
        assert step.reading == step.outcome
        assert robot.placement == placement_of(step.now)
        assert (step.now["x_m"], step.now["y_m"]) == (0.0, 0.0)

    def test_same_seed_gives_the_same_run_and_another_seed_another(self, robot, other):
        first = self.run(robot, 5, self.iterations // 3)
        assert self.run(other, 5, self.iterations // 3) == first
        assert self.run(robot, 5, self.iterations // 3) == first
        assert Course(robot, PAPERS_RULES, 6).last != first[0]

    def test_steps_count_and_pair_readings_with_placements(self, robot):
        steps = self.run(robot, 1, self.iterations)
        for before, step in itertools.pairwise(steps):
            assert step.iteration == before.iteration + 1
            assert step.before == before.now
            assert step.successes == before.successes + (step.event == "capture")
            assert step.episode == before.episode + (step.event != NOTHING)
            assert (step.event == "capture") == is_captured(placement_of(step.reached), PioneerConfig())
            if step.event == NOTHING:
                assert step.now == step.reached
                assert step.reading == step.outcome
            else:
                assert (step.now["x_m"], step.now["y_m"]) == (0.0, 0.0)
                assert step.age == 0
        assert {step.event for step in steps} > {NOTHING}

    def test_readings_have_all_three_keys_within_bounds_or_none(self, robot):
        for step in self.run(robot, 2, self.iterations):
            for reading in (step.outcome, step.reading):
                assert set(reading) in (set(), {"distance", "angle", "continuity"})
                if reading:
                    assert 0.0 <= reading["distance"] <= PioneerConfig().attention_m + 0.2
                    assert abs(reading["angle"]) <= math.pi / 2
                    assert reading["continuity"] in (0.0, 1.0)

    @pytest.mark.parametrize("turn_deg", [*PAPERS_TURNS_DEG, 3.5, -137.0, 180.0, -180.0])
    def test_an_action_turns_by_its_angle_and_then_advances(self, robot, turn_deg):
        robot.put(Placement(Pose(0.0, 0.0, 1.0), -2.0, 0.0), 1)
        assert robot.act({"turn": turn_deg}).event == NOTHING
        reached = robot.placement.robot
        missed_rad = math.remainder(reached.heading_rad - 1.0 - math.radians(turn_deg), math.tau)
        assert missed_rad == pytest.approx(0.0, abs=math.radians(1.5))
        assert math.hypot(reached.x_m, reached.y_m) == pytest.approx(PioneerConfig().advance_m, abs=0.005)
        way_rad = math.atan2(reached.y_m, reached.x_m)
        assert math.remainder(way_rad - reached.heading_rad, math.tau) == pytest.approx(0.0, abs=math.radians(1.5))

    def test_sense_is_fresh_and_disturbs_nothing(self, robot, other):
        robot.put(IN_FRONT, 4)
        other.put(IN_FRONT, 4)
        assert robot.sense() != robot.sense()
        assert robot.act(STRAIGHT_ON) == other.act(STRAIGHT_ON)

    def test_a_course_goes_on_elsewhere_identically(self, robot, other):
        course, elsewhere = Course(robot, PAPERS_RULES, 8), Course(other, PAPERS_RULES, 8)
        for values in self.actions(8, self.iterations):
            elsewhere.go_on(course.state())
            step = course.act(values)
            assert elsewhere.act(values) == step
        assert course.last.episode > 0

    def test_noise_is_of_the_action_and_not_of_how_the_robot_came_there(self, robot, other):
        robot.put(BEHIND, 4, acts=7)
        other.reset(9, 0)
        other.act(STRAIGHT_ON)
        other.put(BEHIND, 4, acts=7)
        assert robot.act(STRAIGHT_ON) == other.act(STRAIGHT_ON)
        robot.put(BEHIND, 4, acts=8)
        other.put(BEHIND, 4, acts=7)
        assert robot.act(STRAIGHT_ON) != other.act(STRAIGHT_ON)

    def test_following_the_object_captures_it(self, robot):
        course, policy = Course(robot, PAPERS_RULES, 9), facing()
        for _ in range(60):
            course.act(policy(course.last.now))
        assert 10 <= course.last.successes <= 18

    def test_facing_the_object_nearby_is_a_capture_and_places_anew(self, robot):
        step = self.step_from(robot, IN_FRONT)
        assert (step.event, step.successes, step.episode) == ("capture", 1, 1)
        assert abs(bearing_rad(placement_of(step.reached))) < math.radians(20)
        assert step.now != step.reached

    def step_from(self, robot: ArenaRobot, placement: Placement, **counts: int):
        """Go straight on from a placement, on a course with so many iterations and such an age."""
        course = Course(robot, PAPERS_RULES, 1)
        state = course.state()
        robot.put(placement, 1)
        scene = msgspec.structs.replace(state.scene, iteration=counts.get("iteration", 0))
        course.go_on(msgspec.structs.replace(state, body=robot.state(), scene=scene, age=counts.get("age", 0)))
        return course.act(STRAIGHT_ON)

    def test_running_into_the_object_sideways_is_a_bump(self, robot):
        step = self.step_from(robot, BESIDE)
        assert (step.event, step.successes) == ("bump", 0)
        assert step.reached["x_m"] < PioneerConfig().advance_m - 0.02

    def test_running_into_a_wall_is_a_bump(self, robot):
        wall_m = PioneerConfig().arena_m / 2.0
        step = self.step_from(robot, Placement(Pose(wall_m - 0.25, 0.0, 0.0), 0.0, 0.0))
        assert step.event == "bump"
        assert step.reached["x_m"] < wall_m

    def test_object_unseen_three_times_in_a_row_is_lost(self, robot):
        robot.put(FAR_AWAY, 1)
        outcomes = [robot.act({"turn": turn_deg}) for turn_deg in (-20.0, 20.0, -20.0)]
        assert [outcome.event for outcome in outcomes] == [NOTHING, NOTHING, "lost"]
        assert not any(outcome.reading for outcome in outcomes)

    def test_in_a_new_episode_the_object_must_be_unseen_three_times_anew(self):
        with self.make(place_min_m=3.0, place_max_m=4.0) as robot:
            course = Course(robot, PAPERS_RULES, 1)
            events = [course.act(STRAIGHT_ON).event for _ in range(6)]
            assert events == [NOTHING, NOTHING, "lost"] * 2
            for episode in (2, 3):
                robot.act(STRAIGHT_ON)
                assert robot.act(STRAIGHT_ON).event == NOTHING
                robot.reset(1, episode)

    def test_how_often_the_object_was_not_seen_goes_with_the_state(self, robot, other):
        robot.put(FAR_AWAY, 1)
        for turn_deg in (-20.0, 20.0):
            robot.act({"turn": turn_deg})
        other.restore(robot.state())
        assert other.act({"turn": -20.0}).event == "lost"

    def test_an_episode_of_forty_iterations_times_out(self, robot):
        step = self.step_from(robot, BEHIND, iteration=39, age=39)
        assert (step.iteration, step.event, step.episode) == (40, "timeout", 1)
        assert self.step_from(robot, BEHIND, iteration=38, age=38).event == NOTHING

    @pytest.mark.parametrize(
        ("values", "says"),
        [
            ({"turn": 180.1}, r"turn = 180\.1; expected -180 to 180 deg"),
            ({"turn": -181.0}, r"turn = -181\.0; expected -180 to 180 deg"),
            ({"turn": math.nan}, "turn = nan; expected -180 to 180 deg"),
            ({"steer": 1.0}, "expected a value for each of turn, and for nothing else"),
            ({"turn": 1.0, "steer": 1.0}, "expected a value for each of turn, and for nothing else"),
        ],
    )
    def test_an_action_that_does_not_exist_is_refused_in_words(self, robot, values, says):
        robot.reset(1, 0)
        with pytest.raises(BodyError, match=says):
            robot.act(values)

    @pytest.mark.parametrize("seed", [-1, 2**64, 1.5, True])
    def test_a_seed_that_is_none_is_refused(self, robot, seed):
        with pytest.raises(BodyError, match=r"expected ints, the seed 0 to 2\*\*64 - 1"):
            robot.reset(seed, 0)
        with pytest.raises(BodyError, match=r"expected ints, the seed 0 to 2\*\*64 - 1"):
            robot.put(IN_FRONT, seed)

    def test_the_greatest_seed_is_one(self, robot):
        robot.reset(2**64 - 1, 0)
        assert robot.act(STRAIGHT_ON)

    def test_an_episode_before_the_first_is_refused(self, robot):
        with pytest.raises(BodyError, match=r"episode=-1; expected ints, .* the episode 0 or more"):
            robot.reset(1, -1)

    def test_places_outside_the_arena_and_negative_counts_are_refused_and_nothing_changes(self, robot):
        robot.put(IN_FRONT, 1)
        outside = Placement(Pose(50.0, 0.0, 0.0), 0.0, 0.0)
        nowhere = Placement(Pose(0.0, 0.0, math.nan), 1.0, 0.0)
        for placement in (outside, nowhere):
            with pytest.raises(BodyError, match="not inside the arena"):
                robot.put(placement, 1)
        with pytest.raises(BodyError, match="acts=-1"):
            robot.put(IN_FRONT, 1, acts=-1)
        assert robot.placement == IN_FRONT

    @pytest.mark.parametrize(
        ("name", "value"), [("acts", -9), ("unseen", -9), ("seed", -1), ("seed", 1.5), ("scene", {"x_m": 0.0})]
    )
    def test_a_state_that_no_pioneer_can_be_in_is_refused(self, robot, name, value):
        robot.put(IN_FRONT, 1)
        state = robot.state()
        with pytest.raises(BodyError):
            robot.restore(msgspec.msgpack.encode(msgspec.msgpack.decode(state) | {name: value}))
        assert robot.state() == state

    @pytest.mark.parametrize(("name", "value"), [("x_m", 1e5), ("object_y_m", -6.0), ("heading_rad", math.inf)])
    def test_a_state_somewhere_else_is_refused(self, robot, name, value):
        robot.put(IN_FRONT, 1)
        state = robot.state()
        whole = msgspec.msgpack.decode(state)
        with pytest.raises(BodyError, match="not inside the arena"):
            robot.restore(msgspec.msgpack.encode(whole | {"scene": whole["scene"] | {name: value}}))
        assert robot.state() == state

    def test_no_part_of_a_state_is_a_state(self, robot):
        robot.put(IN_FRONT, 1)
        state = robot.state()
        for length in range(len(state)):
            with pytest.raises(BodyError, match="no state of a Pioneer"):
                robot.restore(state[:length])
        assert robot.state() == state

    def test_before_reset_and_after_close_every_use_says_what_to_do(self):
        robot = self.make()
        for use in (lambda: robot.act(STRAIGHT_ON), robot.sense, lambda: robot.placement, robot.clean_ranges_m):
            with pytest.raises(BodyError, match=r"call reset\(seed, 0\)"):
                use()
        robot.close()
        robot.close()
        for use in (lambda: robot.act(STRAIGHT_ON), lambda: robot.put(IN_FRONT, 1), robot.sense):
            with pytest.raises(BodyError, match="closed"):
                use()

    def test_options_make_another_robot(self):
        with self.make(advance_m=0.1) as robot:
            robot.put(BEHIND, 1)
            robot.act(STRAIGHT_ON)
            assert robot.placement.robot.x_m == pytest.approx(0.1, abs=0.003)
        with self.make(attention_m=1.5) as robot:
            assert robot.spec.sensors[0].high == 1.5

    @pytest.mark.parametrize(
        ("options", "says"),
        [({"wheels": 3}, "wheels"), ({"advance_m": -1.0}, "advance_m"), ({"place_min_m": 9.0}, "place_min_m=9.0")],
    )
    def test_options_that_there_are_not_are_refused_by_name(self, options, says):
        with pytest.raises(BodyError, match=f"robot.options: .*{says}"):
            self.make(**options)

    # ---- what can be changed of it ----

    @pytest.fixture
    def mended(self, robot):
        """A robot that is given back as it was."""
        yield robot
        robot.change(swapped=False, turn_share=1.0, left_wheel=1.0, right_wheel=1.0, blind=[])

    def turned_deg(self, robot, turn_deg: float) -> float:
        robot.put(Placement(Pose(0.0, 0.0, 0.0), -2.0, 0.0), 1)
        robot.act({"turn": turn_deg})
        return math.degrees(robot.placement.robot.heading_rad)

    def test_swapped_motors_turn_the_other_way_and_tired_ones_less(self, mended):
        mended.change(swapped=True)
        assert self.turned_deg(mended, 45.0) == pytest.approx(-45.0, abs=1.5)
        mended.change(turn_share=0.5)
        assert self.turned_deg(mended, 90.0) == pytest.approx(-45.0, abs=1.5), "both hold"
        mended.change(swapped=False)
        assert self.turned_deg(mended, 90.0) == pytest.approx(45.0, abs=1.5)

    def test_a_wheel_that_slips_bends_the_way_ahead(self, mended):
        mended.change(left_wheel=0.9)
        expected_deg = math.degrees(0.1 * PioneerConfig().advance_m / TRACK_M)
        assert self.turned_deg(mended, 0.0) == pytest.approx(expected_deg, abs=0.5)
        mended.change(left_wheel=1.0, right_wheel=0.9)
        assert self.turned_deg(mended, 0.0) == pytest.approx(-expected_deg, abs=0.5)

    def test_blind_sonars_hear_nothing(self, mended):
        mended.put(IN_FRONT, 1)
        assert mended.sense()
        mended.change(blind=list(range(16)))
        assert mended.sense() == {}

    def test_the_object_is_put_elsewhere_once(self, mended):
        mended.put(BEHIND, 1)
        mended.change(object_x_m=1.5)
        assert mended.placement == Placement(BEHIND.robot, 1.5, 0.0)
        mended.change(object_y_m=1.0)
        assert mended.placement == Placement(BEHIND.robot, 1.5, 1.0)
        mended.reset(3, 0)
        there = mended.placement
        assert mended.reset(3, 0)
        assert mended.placement == there != Placement(there.robot, 1.5, 1.0), "the next episode has its own"
        with pytest.raises(BodyError, match="not inside the arena"):
            mended.change(object_x_m=6.0, swapped=True)
        assert self.turned_deg(mended, 20.0) == pytest.approx(20.0, abs=1.5)

    def test_of_a_state_that_is_refused_the_changes_are_not_taken_either(self, mended):
        with self.make() as another:
            another.change(swapped=True)
            another.put(IN_FRONT, 1)
            whole = msgspec.msgpack.decode(another.state())
        mended.put(IN_FRONT, 1)
        state = mended.state()
        with pytest.raises(BodyError):
            mended.restore(msgspec.msgpack.encode(whole | {"scene": whole["scene"] | {"x_m": 99.0}}))
        assert mended.state() == state

    # ---- its drawing ----

    def test_the_drawing_shows_arena_way_object_and_robot_where_they_are(self, robot):
        robot.put(BEHIND, 1)
        for _ in range(2):
            outcome = robot.act(STRAIGHT_ON)
        assert outcome.reading, "or else this placement shows nothing"
        drawing = robot.draw(outcome.reading)
        here = robot.placement.robot
        parts = shapes_by_meaning(drawing)
        assert list(parts) == ["wall", "trail", "thing", "sensed", "robot"]
        (wall,), (trail,), (thing,) = parts["wall"], parts["trail"], parts["thing"]
        assert {abs(value) for point in wall.points for value in point} == {PioneerConfig().arena_m / 2}
        assert wall.points[0] == wall.points[-1], "it is closed"
        assert trail.points[0] == (0.0, 0.0)
        assert trail.points[-1] == (here.x_m, here.y_m)
        assert len(trail.points) == 3
        assert (thing.kind, thing.points, thing.radius) == ("disc", [(-1.0, 0.0)], PioneerConfig().object_radius_m)
        hull, front = parts["robot"]
        assert (hull.kind, front.points[0]) == ("circle", (here.x_m, here.y_m))
        assert front.points[1][0] > here.x_m, "it looks along x"
        assert drawing.front_rad == here.heading_rad

    def test_what_is_perceived_is_drawn_where_the_robot_takes_it_to_be(self, robot):
        robot.put(IN_FRONT, 1)
        ray, cross = shapes_by_meaning(robot.draw(robot.sense()))["sensed"]
        assert (ray.points[1], cross.kind) == (cross.points[0], "cross")
        surface = 0.55 * math.cos(0.5), 0.55 * math.sin(0.5)
        assert math.dist(cross.points[0], surface) < 0.1
        assert "sensed" not in shapes_by_meaning(robot.draw({}))
        assert "sensed" not in shapes_by_meaning(robot.draw({"distance": 1.0}))

    def test_robot_and_object_are_in_the_box_that_is_sure_to_be_seen(self, robot):
        for episode in range(5):
            left, low, right, high = robot.draw(robot.reset(1, episode)).box
            place = robot.placement
            for x_m, y_m in ((place.robot.x_m, place.robot.y_m), (place.object_x_m, place.object_y_m)):
                assert left < x_m < right
                assert low < y_m < high

    def test_the_way_of_another_episode_is_not_drawn(self, robot):
        robot.reset(1, 0)
        robot.act(STRAIGHT_ON)
        assert "trail" not in shapes_by_meaning(robot.draw(robot.reset(1, 1)))


def shapes_by_meaning(drawing: messages.Drawing) -> dict[str, list[messages.Shape]]:
    found: dict[str, list[messages.Shape]] = {}
    for shape in drawing.shapes:
        found.setdefault(shape.what, []).append(shape)
    return found
