"""What `mdb init --like wire` writes: a robot in a process of its own, which does each action of the brain once."""

import subprocess
import sys
from pathlib import Path

from mdb_deploy.begin.folder import begin
from mdb_protocol import keys, messages
from mdb_protocol.zenoh_bus import ZenohBus
from tests.integration.brain import ENDED_S, until
from tests.integration.test_keys_at_work import router_process

AHEAD = {"left": 0.3, "right": 0.3}


def test_the_robot_program_acts_once_and_shows_again(tmp_path: Path) -> None:
    begin(tmp_path / "mine", "wire")
    (tmp_path / "run").mkdir()
    with (
        router_process(tmp_path / "run", "--listen", "tcp/127.0.0.1:0") as endpoint,
        ZenohBus("mine", endpoint) as bus,
    ):
        shown = bus.subscriber(keys.PERCEPTION)
        scenes = bus.subscriber(keys.SCENE)
        actions = bus.publisher(keys.ACTION)
        program = [sys.executable, "mine_robot.py", endpoint]
        robot = subprocess.Popen(program, cwd=tmp_path / "mine")
        newest: list[messages.Perception] = []

        def saw(iteration: int) -> bool:
            bus.wait(0.05)
            newest.extend(shown.some())
            return bool(newest) and newest[-1].iteration == iteration

        def act(iteration: int, **changed: float) -> None:
            action = messages.Action(
                iteration=iteration, action=AHEAD | changed, valid_for_s=5.0, stamp=newest[-1].stamp
            )
            actions.put(action)

        try:
            until(lambda: saw(0))
            assert "robot/body" in bus.alive()
            act(0)
            until(lambda: saw(1))
            done = newest[-1].done
            assert done is not None
            assert done.action == AHEAD
            act(0)  # once more, and then what it cannot do: neither is done
            act(1, left=9.0)
            seen = newest[-1].stamp
            until(lambda: saw(1) and newest[-1].stamp > seen + 0.5)
            act(1)
            until(lambda: saw(2))
            assert {perception.iteration for perception in newest} == {0, 1, 2}
            scene = [*scenes.some()][-1]
            assert isinstance(scene, messages.Scene)
            assert scene.before is not None
            assert scene.reached["distance_m"] != scene.before["distance_m"]
            second = subprocess.run(
                program, cwd=tmp_path / "mine", capture_output=True, text=True, timeout=30.0, check=False
            )
            assert "brain mine has its robot/body already: process " in second.stderr
        finally:
            robot.terminate()
            robot.wait(ENDED_S)
