"""A teacher as a script: python teacher.py tcp/127.0.0.1:7447 300 (where the router is, how many lessons; keys)."""

import math
import sys
from pathlib import Path

from mdb_protocol import keys, messages
from mdb_protocol.zenoh_bus import ZenohBus

TURNS = [0, -20, -45, -90, 20, 45, 90]  # the turns that I want of it, in degrees, to the left
NOTES = [6, 3, 0, 5, 1, 4, 2]  # my language: the note that I play for each of them
AIM = 0  # degrees from the robot's nose to the object, as I like it best: 0 it goes for it, 180 it flees


def missing(turn: float, seen: dict[str, float]) -> float:  # degrees by which it then misses my aim
    bearing = math.atan2(seen["object_y_m"] - seen["y_m"], seen["object_x_m"] - seen["x_m"]) - seen["heading_rad"]
    return abs(math.degrees(math.remainder(bearing - math.radians(turn + AIM), math.tau)))


with ZenohBus("pioneer", sys.argv[1], credentials=Path(sys.argv[3]) if len(sys.argv) > 3 else None) as bus:
    scenes = bus.subscriber(keys.SCENE)
    notes, feedback = (bus.publisher(row, teacher="ann") for row in (keys.COMMAND, keys.FEEDBACK))
    bus.token("teacher", "ann")  # I am here; when this program ends, I am gone
    iteration, lessons = -1, int(sys.argv[2])
    while iteration < lessons:
        if (scene := scenes.take()) is None or scene.iteration == iteration:
            bus.wait(0.1)
            continue
        iteration = scene.iteration
        if scene.before is not None:
            turned = math.degrees(scene.reached["heading_rad"] - scene.before["heading_rad"])
            best = min(missing(turn, scene.before) for turn in TURNS)
            value = min(1.0, 1 - (missing(turned, scene.before) - best) / 45)
            feedback.put(messages.Feedback(teacher="ann", iteration=iteration - 1, value=max(-1.0, value)))
        wanted = min(range(len(TURNS)), key=lambda command: missing(TURNS[command], scene.now))
        notes.put(messages.Command(teacher="ann", iteration=iteration, note=NOTES[wanted]))
