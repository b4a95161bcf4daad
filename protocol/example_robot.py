"""A robot for `mdb up --no-robot`, with zenoh and msgpack alone: it turns, drives 0.2 m, and senses an object."""

import json
import math
import queue
import random
import sys
import time
import uuid

import msgpack
import zenoh

ROUTER = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
HEAD = "application/msgpack;mdb=2;"
KEYS = f"mdb/{sys.argv[2] if len(sys.argv) > 2 else 'pioneer'}/"


class Body:
    """The machine: here a place on a plane, in the middle of which the object is."""

    def begin(self):
        away_m, self.heading = random.uniform(0.9, 1.6), random.uniform(-math.pi, math.pi)
        self.x, self.y, self.age = away_m, 0.0, 0

    def drive(self, turn_deg):
        time.sleep(0.05)  # a real one takes longer
        self.heading, self.age = self.heading + math.radians(turn_deg), self.age + 1
        self.x, self.y = self.x + 0.2 * math.cos(self.heading), self.y + 0.2 * math.sin(self.heading)
        near = self.sense()
        if not near or self.age > 40:
            return "lost"
        if near["distance"] > 0.4:
            return "none"
        return "capture" if abs(near["angle"]) < 0.35 and not near["continuity"] else "bump"

    def sense(self):
        distance, angle = math.hypot(self.x, self.y) - 0.15, math.atan2(-self.y, -self.x) - self.heading
        seen = {"distance": distance, "angle": math.asin(math.sin(angle)), "continuity": float(math.cos(angle) < 0)}
        return seen if distance < 2.0 else {}

    def scene(self):
        return {"x_m": self.x, "y_m": self.y, "heading_rad": self.heading, "object_x_m": 0.0, "object_y_m": 0.0}


def read(sample):
    """Return the action in a sample if it may be done now, else None (duties 9 and 10)."""
    kind, version, name = str(sample.encoding).split(";")  # who cannot read it raises an error
    action = msgpack.unpackb(sample.payload.to_bytes())
    age_s = time.monotonic() - action["stamp"]
    known = (kind, version.split(".")[0], name) == ("application/msgpack", "mdb=2", "Action")
    fits = {*action["action"]} == {"turn"} and -90 <= action["action"]["turn"] <= 90
    counts = isinstance(action["iteration"], int) and 0 <= age_s <= action["valid_for_s"]
    return action if known and fits and counts else None


def others_of(session, claim):
    """Return who else is this brain's robot, or is about to be, once we have claimed its place (duty 1)."""
    until_s = time.monotonic() + 3.0
    while True:
        replies = [r for key in ("alive/robot/*", "claim/robot/body/*") for r in session.liveliness().get(KEYS + key)]
        others = {str(reply.ok.key_expr) for reply in replies if reply.ok} - {claim}
        if not others or min(others) < claim or time.monotonic() > until_s:
            return others
        time.sleep(0.1)


def main():
    connect = {"endpoints": [ROUTER], "timeout_ms": 60_000, "exit_on_failure": True}  # waits for a router
    config = {"mode": "client", "connect": connect, "scouting": {"multicast": {"enabled": False}}}
    body, actions, ahead, since_s = Body(), queue.Queue(), None, 0.0
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
        claim = f"{KEYS}claim/robot/body/{uuid.uuid4().hex}"
        claimed = session.liveliness().declare_token(claim)  # a token ends with its variable
        if others := others_of(session, claim):
            sys.exit(f"a robot of this brain lives already, or starts at this moment: {', '.join(others)}")
        body.begin()
        here, near = body.scene(), body.sense()
        perception = {"iteration": 0, "event": "none", "outcome": near, "reading": near, "done": None}
        scene = {"iteration": 0, "episode": 0, "successes": 0, "event": "none", "success": False, "ended": False}
        scene |= {"action": None, "before": None, "reached": here, "now": here}
        hears = session.declare_subscriber(KEYS + "action", actions.put)
        with hears, claimed, session.liveliness().declare_token(KEYS + "alive/robot/body"):
            while True:
                perception["stamp"] = time.monotonic()
                for name, message in (("Scene", scene), ("Perception", perception)):
                    session.put(KEYS + name.lower(), msgpack.packb(message), encoding=f"{HEAD}{name}")
                try:
                    action = read(actions.get(timeout=0.25))
                except queue.Empty:
                    continue  # nobody commands: a body that goes on by itself is halted here (duty 12)
                except Exception:
                    continue  # whatever it was, it was no action
                if action is None or action["iteration"] < perception["iteration"]:
                    continue  # duty 8
                if action["iteration"] > perception["iteration"] and perception["done"]:  # duty 11
                    if action["iteration"] != ahead:
                        ahead, since_s = action["iteration"], time.monotonic()
                    if time.monotonic() - since_s < 1.0:
                        continue
                ahead, before, event = None, body.scene(), body.drive(action["action"]["turn"])
                reached, outcome, over = body.scene(), body.sense(), event != "none"
                if over:
                    body.begin()
                count = {"iteration": action["iteration"] + 1, "event": event}
                perception = {**count, "outcome": outcome, "reading": body.sense(), "done": action}
                scene |= {**count, "success": event == "capture", "ended": over, "episode": scene["episode"] + over}
                scene |= {"successes": scene["successes"] + (event == "capture"), "action": action["action"]}
                scene |= {"before": before, "reached": reached, "now": body.scene()}


if __name__ == "__main__":
    main()
