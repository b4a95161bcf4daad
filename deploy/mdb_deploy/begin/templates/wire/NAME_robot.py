"""The robot as a program of its own, for `mdb up FOLDER --no-robot`: python NAME_robot.py [tcp/127.0.0.1:7447]

It needs `mdb_protocol` only (pip install . without extras), and runs on any machine that reaches the router. `Robot`
is the one of NAME_body.py; anything with `reset`, `act` and `scene` will do. What a robot owes the brain is in
protocol/README.md, in any language; `mdb check-robot FOLDER` tries it.
"""

import sys
import time

from msgspec import structs
from NAME_body import Robot

from mdb_protocol import keys, messages
from mdb_protocol.errors import MdbError
from mdb_protocol.holding import hold
from mdb_protocol.zenoh_bus import ZenohBus

SEED, LONGEST = 1, 60  # of the places where it is put; actions in an episode
SUCCESSES, ENDS = {"reached"}, {"reached", "outside", "timeout"}  # events, as in the experiment file
AGAIN_S, INSISTS_S = 0.25, 1.0  # shown again after so long; so long another count must be said to be believed


def acted(body, before, action, age):
    """Do an action; return what is perceived and what is true after it. An episode that is over begins anew."""
    outcome = body.act(action.action)
    event = "timeout" if outcome.event == messages.NOTHING and age >= LONGEST else outcome.event
    reached, ended, success = body.scene(), event in ENDS, event in SUCCESSES
    episode = before.episode + ended
    reading = body.reset(SEED, episode) if ended else outcome.reading
    count = {"iteration": action.iteration + 1, "event": event}
    perception = messages.Perception(**count, outcome=outcome.reading, reading=reading, done=action)
    scene = messages.Scene(
        **count,
        episode=episode,
        successes=before.successes + success,
        success=success,
        ended=ended,
        action=action.action,
        before=before.now,
        reached=reached,
        now=body.scene(),
    )
    return perception, scene


def may(body, action):
    """Return whether an action is one of this robot's, and not too old by its own clock."""
    ranges = {actuator.name: (actuator.low, actuator.high) for actuator in body.spec.actuators}
    fits = action.action.keys() == ranges.keys()
    fits = fits and all(low <= action.action[name] <= high for name, (low, high) in ranges.items())
    return fits and 0.0 <= time.monotonic() - action.stamp <= action.valid_for_s


def main(endpoint):
    """Show what is perceived, again and again, and do each action once."""
    body, age, ahead, since_s = Robot(), 0, None, 0.0
    with ZenohBus("NAME", endpoint, connect_timeout_s=60.0) as bus:  # waits so long for a router
        hold(bus, "robot", "body")  # an error that says who it is if another robot has the place, or takes it now
        actions = bus.subscriber(keys.ACTION)
        scenes, perceptions = bus.publisher(keys.SCENE), bus.publisher(keys.PERCEPTION)
        reading, now = body.reset(SEED, 0), body.scene()
        perception = messages.Perception(iteration=0, outcome=reading, reading=reading)
        scene = messages.Scene(
            iteration=0, episode=0, successes=0, event="none", action=None, before=None, reached=now, now=now
        )
        bus.token("robot", "body")  # from now on the brain knows that it is there
        while True:
            perception = structs.replace(perception, stamp=time.monotonic())
            scenes.put(scene)
            perceptions.put(perception)
            bus.wait(AGAIN_S)
            action = actions.take()
            if action is None or action.iteration < perception.iteration or not may(body, action):
                continue  # nobody commands: a robot that goes on by itself is halted here
            if action.iteration > perception.iteration and perception.done is not None:
                if action.iteration != ahead:
                    ahead, since_s = action.iteration, time.monotonic()
                if time.monotonic() - since_s < INSISTS_S:
                    continue
            ahead, age = None, 0 if scene.ended else age
            age += 1
            perception, scene = acted(body, scene, action, age)


if __name__ == "__main__":
    try:
        main(sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447")
    except MdbError as error:
        sys.exit(str(error))
