"""The example robot of the protocol's page, as it is and broken in one place, in processes of their own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

EXAMPLE = Path(__file__).parents[2] / "protocol" / "example_robot.py"


class Broken(NamedTuple):
    """What is wrong with a robot: some words of the example, others in their place, and the duty that then fails."""

    instead_of: str
    stands: str
    duty: int
    said: str


BROKEN = {
    "has no token": Broken(
        '"alive/robot/body"',
        '"alive/machine/body"',
        1,
        "no token",
    ),
    "claims nothing": Broken(
        "claim/robot/body/{",
        "claim/machine/body/{",
        1,
        "there is no claim; expected one",
    ),
    "speaks another version": Broken(
        'HEAD = "application/msgpack;mdb=2;"',
        'HEAD = "application/msgpack;mdb=3;"',
        2,
        "could not be read, as",
    ),
    "sends what is no number": Broken(
        'perception["stamp"] = time.monotonic()',
        'perception |= {"stamp": time.monotonic(), "reading": {"distance": math.nan}}',
        2,
        "Perception",
    ),
    "senses something else": Broken(
        'perception["stamp"] = time.monotonic()',
        'perception |= {"stamp": time.monotonic(), "reading": {"distance": [1.0, 2.0], "light": 3.0}}',
        3,
        "'distance' has [1, 2] numbers; the file says 1",
    ),
    "shows no scene": Broken(
        '(("Scene", scene), ("Perception", perception))',
        '(("Perception", perception),)',
        3,
        "no scene of iteration 0",
    ),
    "does not show again": Broken(
        "timeout=0.25",
        "timeout=60",
        4,
        "nothing was shown for",
    ),
    "shows with the same stamp": Broken(
        'perception["stamp"] = time.monotonic()',
        'perception.setdefault("stamp", time.monotonic())',
        5,
        "a stamp of",
    ),
    "answers too slowly": Broken(
        "time.sleep(0.05)",
        "time.sleep(5)",
        6,
        "of iteration 0 within 2 s",
    ),
    "does not give back what it did": Broken(
        '"done": action',
        '"done": None',
        7,
        "`done` is missing",
    ),
    "gives back another intention": Broken(
        '"done": action',
        '"done": action | {"intention": action["intention"] | {"explored": True}}',
        7,
        "another intention",
    ),
    "does an action twice": Broken(
        'action["iteration"] < perception["iteration"]',
        "False",
        8,
        "after an action that was done was sent again",
    ),
    "does what is too old": Broken(
        '0 <= age_s <= action["valid_for_s"]',
        "True",
        9,
        "valid for 0.3 s",
    ),
    "does what it cannot": Broken(
        "fits = ",
        "fits = 'turn' in action['action'] or ",
        10,
        "after what is no action",
    ),
    "dies of junk": Broken(
        "except Exception:\n                    continue",
        "except ZeroDivisionError:\n                    continue",
        10,
        "shows nothing any more",
    ),
    "counts for itself": Broken(
        '"iteration": action["iteration"] + 1',
        '"iteration": perception["iteration"] + 1',
        11,
        "after the action of 7 it shows 1; expected 8",
    ),
    "believes a single word": Broken(
        "time.monotonic() - since_s < 1.0",
        "False",
        11,
        "which may be junk",
    ),
    "never halts": Broken(
        "except queue.Empty:\n",
        'except queue.Empty:\n                    body.x += 0.01; scene["now"] = body.scene()\n',
        12,
        "of its scene changed",
    ),
}

NEGLECTS = Broken("if others := others_of(session, claim):", "if others := []:", 1, "")
"""One that does not ask whether there is another: from outside nobody sees that of it alone."""


class Robot:
    """A process with the example robot, changed in one place; ended when its block ends."""

    def __init__(self, endpoint: str, brain: str, broken: Broken | None = None) -> None:
        code = EXAMPLE.read_text()
        if broken is not None:
            assert code.count(broken.instead_of) == 1, broken
            code = code.replace(broken.instead_of, broken.stands)
        command = [sys.executable, "-c", code, endpoint, brain]
        self.process = subprocess.Popen(command, stderr=subprocess.DEVNULL)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.process.kill()
        self.process.wait(10.0)
