"""The shipped experiment as processes, with a robot of another make that keeps the last Twist for ever."""

from pathlib import Path

import pytest

pytest.importorskip("rosbags")
pytest.importorskip("zenoh_ros2_sdk")

from tests.integration.brain import Brain
from tests.ros2.other_side import robot
from tests.ros2.test_robot import moving, told_to_rest

SLOW = ("robot.options.angular_deg_s=15", "robot.options.linear_m_s=0.05", "robot.options.stale_s=10.0")


@pytest.mark.long
def test_a_brain_that_is_stopped_in_the_middle_of_an_action_leaves_the_robot_at_rest(tmp_path: Path) -> None:
    with robot("--pillar", "1.5", "0.9") as other:
        settings = (f"robot.options.connect={other.connect}", "experiment.iterations=20", *SLOW)
        with Brain(tmp_path, *settings, experiment=("ros2", ())) as brain:
            since = moving(other)
            brain.interrupt()
            brain.wait()
        assert told_to_rest(other, since)
