"""What every body must do: derive a test class from `RobotConformance` and supply `make`.

Owns the meaning of the `Robot` contract as tests. Uses the contract's members only, so that it fits any body
with the default world rules.
"""

import itertools
import math

import numpy as np
import pytest

from mdb_sim.bodies.pioneer.arena import bearing_rad, is_captured
from mdb_sim.body import Placement, Pose, Robot, RobotConfig, Step
from mdb_sim.teaching.teacher import wanted_action

IN_FRONT = Placement(Pose(0.0, 0.0, 0.5), 0.7 * math.cos(0.5), 0.7 * math.sin(0.5))
FAR_AWAY = Placement(Pose(0.0, 0.0, 0.0), 4.0, 4.0)
BESIDE = Placement(Pose(0.0, 0.0, 0.0), 0.42 * math.cos(0.8), 0.42 * math.sin(0.8))
STRAIGHT_ON = 0


class RobotConformance:
    """The suite; a subclass supplies `make` and may lower `iterations` when its body is slow."""

    iterations = 150

    def make(self, config: RobotConfig) -> Robot:
        raise NotImplementedError

    @pytest.fixture(scope="class")
    @classmethod
    def bodies(cls):
        made = cls().make(RobotConfig()), cls().make(RobotConfig())
        yield made
        for body in made:
            body.close()

    @pytest.fixture
    def robot(self, bodies):
        return bodies[0]

    @pytest.fixture
    def other(self, bodies):
        return bodies[1]

    def run(self, robot, seed, iterations):
        actions = np.random.default_rng(seed).integers(robot.actions, size=iterations).tolist()
        return [robot.reset(seed), *(robot.act(action) for action in actions)]

    def test_reset_begins_at_iteration_zero_with_one_placement(self, robot):
        step = robot.reset(3)
        assert (step.iteration, step.event, step.captures, step.episode) == (0, "none", 0, 0)
        assert step.now is step.reached
        assert step.next_reading is step.reading
        assert robot.placement == step.now
        assert (step.now.robot.x_m, step.now.robot.y_m) == (0.0, 0.0)

    def test_same_seed_gives_the_same_run_and_another_seed_another(self, robot, other):
        first = self.run(robot, 5, self.iterations // 3)
        assert self.run(other, 5, self.iterations // 3) == first
        assert self.run(robot, 5, self.iterations // 3) == first
        assert robot.reset(6) != first[0]

    def test_steps_count_and_pair_readings_with_placements(self, robot):
        steps = self.run(robot, 1, self.iterations)
        for before, step in itertools.pairwise(steps):
            assert step.iteration == before.iteration + 1
            assert step.captures == before.captures + (step.event == "capture")
            assert step.episode == before.episode + (step.event != "none")
            assert (step.event == "capture") == is_captured(step.reached, RobotConfig())
            if step.event == "none":
                assert step.now is step.reached
                assert step.next_reading is step.reading
            else:
                assert (step.now.robot.x_m, step.now.robot.y_m) == (0.0, 0.0)
                assert step.episode_age == 0
                assert step.unseen == 0

    def test_readings_have_all_three_keys_within_bounds_or_none(self, robot):
        for step in self.run(robot, 2, self.iterations):
            for reading in (step.reading, step.next_reading):
                assert set(reading) in (set(), {"distance", "angle", "continuity"})
                if reading:
                    assert 0.0 <= reading["distance"] <= RobotConfig().attention_m + 0.2
                    assert abs(reading["angle"]) <= math.pi / 2
                    assert reading["continuity"] in (0.0, 1.0)

    def test_each_action_turns_by_its_angle_and_then_advances(self, robot):
        config = RobotConfig()
        for action, turn_rad in enumerate(config.turns_rad):
            robot.restore(Placement(Pose(0.0, 0.0, 1.0), -2.0, 0.0), 0, seed=1)
            reached = robot.act(action).reached.robot
            assert math.remainder(reached.heading_rad - 1.0 - turn_rad, math.tau) == pytest.approx(
                0.0, abs=math.radians(1.5)
            )
            assert math.hypot(reached.x_m, reached.y_m) == pytest.approx(config.advance_m, abs=0.005)

    def test_sense_is_fresh_and_disturbs_nothing(self, robot, other):
        robot.restore(IN_FRONT, 0, seed=4)
        other.restore(IN_FRONT, 0, seed=4)
        assert robot.sense() != robot.sense()
        assert robot.act(STRAIGHT_ON) == other.act(STRAIGHT_ON)

    def test_restored_elsewhere_a_run_continues_identically(self, robot, other):
        rng = np.random.default_rng(8)
        step = robot.reset(8)
        for _ in range(self.iterations):
            restore(other, step, seed=8)
            action = int(rng.integers(robot.actions))
            step = robot.act(action)
            assert other.act(action) == step

    def test_following_the_object_captures_it(self, robot):
        turns_rad = RobotConfig().turns_rad
        step = robot.reset(9)
        for _ in range(60):
            step = robot.act(wanted_action(step.now, turns_rad))
        assert 10 <= step.captures <= 18

    def test_facing_the_object_nearby_is_a_capture_and_places_anew(self, robot):
        robot.restore(IN_FRONT, 0, seed=1)
        step = robot.act(STRAIGHT_ON)
        assert (step.event, step.captures, step.episode) == ("capture", 1, 1)
        assert abs(bearing_rad(step.reached)) < math.radians(20)
        assert step.now != step.reached

    def test_running_into_the_object_sideways_is_a_bump(self, robot):
        robot.restore(BESIDE, 0, seed=1)
        step = robot.act(STRAIGHT_ON)
        assert (step.event, step.captures) == ("bump", 0)
        assert step.reached.robot.x_m < RobotConfig().advance_m - 0.02

    def test_running_into_a_wall_is_a_bump(self, robot):
        wall_m = RobotConfig().arena_m / 2.0
        robot.restore(Placement(Pose(wall_m - 0.25, 0.0, 0.0), 0.0, 0.0), 0, seed=1)
        step = robot.act(STRAIGHT_ON)
        assert step.event == "bump"
        assert step.reached.robot.x_m < wall_m

    def test_object_unseen_three_times_in_a_row_is_lost(self, robot):
        robot.restore(FAR_AWAY, 0, seed=1)
        steps = [robot.act(action) for action in (1, 4, 1)]
        assert [step.event for step in steps] == ["none", "none", "lost"]
        assert [step.unseen for step in steps] == [1, 2, 0]
        assert not any(step.reading for step in steps)

    def test_an_episode_of_forty_iterations_times_out(self, robot):
        robot.restore(Placement(Pose(0.0, 0.0, 0.0), -1.0, 0.0), 39, seed=1, episode_age=39)
        step = robot.act(STRAIGHT_ON)
        assert (step.iteration, step.event, step.episode) == (40, "timeout", 1)

    @pytest.mark.parametrize("action", [-1, 7, 1.0, True, "left", None])
    def test_an_action_that_does_not_exist_is_refused_and_moves_nothing(self, robot, action):
        before = robot.reset(1).now
        with pytest.raises(ValueError, match="expected an int from 0 to 6"):
            robot.act(action)
        assert robot.placement == before

    @pytest.mark.parametrize("seed", [-1, 2**64, 1.5, True])
    def test_a_seed_that_is_none_is_refused(self, robot, seed):
        with pytest.raises(ValueError, match=r"expected an int from 0 to 2\*\*64 - 1"):
            robot.reset(seed)

    def test_restoring_outside_the_arena_or_to_negative_counts_is_refused(self, robot):
        with pytest.raises(ValueError, match="not inside the arena"):
            robot.restore(Placement(Pose(50.0, 0.0, 0.0), 0.0, 0.0), 0, seed=1)
        with pytest.raises(ValueError, match="not inside the arena"):
            robot.restore(Placement(Pose(0.0, 0.0, math.nan), 1.0, 0.0), 0, seed=1)
        with pytest.raises(ValueError, match="negative count"):
            robot.restore(IN_FRONT, -1, seed=1)

    def test_before_reset_and_after_close_every_use_says_what_to_do(self):
        robot = self.make(RobotConfig())
        for use in (lambda: robot.act(0), robot.sense, lambda: robot.placement):
            with pytest.raises(ValueError, match=r"call reset\(seed\)"):
                use()
        robot.close()
        robot.close()
        for use in (lambda: robot.act(0), lambda: robot.reset(1), robot.sense):
            with pytest.raises(ValueError, match="closed"):
                use()

    def test_other_turns_make_another_action_set(self):
        robot = self.make(RobotConfig(turns_deg=(0.0, 30.0, -30.0), advance_m=0.1))
        robot.reset(1)
        assert robot.actions == 3
        with pytest.raises(ValueError, match="from 0 to 2"):
            robot.act(3)
        robot.close()


def restore(robot: Robot, step: Step, *, seed: int) -> None:
    counts = {name: getattr(step, name) for name in ("episode", "captures", "episode_age", "unseen")}
    robot.restore(step.now, step.iteration, seed=seed, **counts)
