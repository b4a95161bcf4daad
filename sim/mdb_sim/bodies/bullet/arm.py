"""A KUKA iiwa that reaches for a point: three of its seven joints turn, the others stay.

Its eye sits at the shoulder and turns with nothing: it sees hand and point, and tells how far the point is aside of
the hand and above it, as angles, and how much farther away it is. See sim/README.md, "The arm".
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pybullet

from mdb_sim.bodies.bullet.machine import BulletMachine
from mdb_sim.body import NOTHING, Actuator, BodyError, Numbers, Reading, Sensor, Spec

HZ = 120
JOINTS = {"base": 0, "shoulder": 1, "elbow": 3}
"""Those that turn, by their place in the model."""
ALL, HAND = tuple(range(7)), 6
LOW = {"base": -1.5, "shoulder": 0.0, "elbow": -2.0}
HIGH = {"base": 1.5, "shoulder": 1.1, "elbow": -0.5}
"""Between which angles they turn, rad: the arm stays before its base, above the floor, and bent."""
EYE_M = (0.0, 0.0, 0.36)
"""The shoulder, about which upper arm and forearm turn."""
TORQUE_NM, SPEED_RAD_S = 300.0, 2.0
ARRIVED_RAD, STILL_RAD_S = 1e-3, 1e-2
GIVE_UP_S = 2.0
"""An arm that is held up has stopped by then."""
NEAREST_M, LOWEST_M = 0.15, 0.12
"""A point is so far from the hand at first, and so far above the floor, at least."""
TARGETS = 200
IMAGE = 240, 180
BALL_M = 0.04
"""Radius of the ball that marks the point in an image; nothing can touch it."""


class IiwaArm(BulletMachine):
    """See the module's docstring; options: `turn_rad`, the most that a joint turns in one action, and `reached_m`."""

    places = ("base", "shoulder", "elbow", "target_x_m", "target_y_m", "target_z_m")

    def __init__(self, *, turn_rad: float = 0.25, reached_m: float = 0.03) -> None:
        """BodyError when an option is out of its bounds."""
        if not 0.0 < turn_rad <= 1.0 or not 0.0 < reached_m <= NEAREST_M:
            raise BodyError(
                f"robot.options: turn_rad={turn_rad}, reached_m={reached_m}; expected above 0, to 1 and {NEAREST_M}"
            )
        self.spec = spec_of(turn_rad)
        self._reached_m = reached_m
        super().__init__("kuka_iiwa/model.urdf", 0.0, HZ, fixed=True)
        ball = pybullet.createVisualShape(
            pybullet.GEOM_SPHERE, radius=BALL_M, rgbaColor=(0.9, 0.1, 0.1, 1.0), physicsClientId=self._client
        )
        self._ball: int = pybullet.createMultiBody(
            0.0, baseVisualShapeIndex=ball, basePosition=(0.0, 0.0, -1.0), physicsClientId=self._client
        )
        self._rest: int = pybullet.saveState(physicsClientId=self._client)

    @staticmethod
    def spec_of(*, turn_rad: float = 0.25, reached_m: float = 0.03) -> Spec:
        """Return what such an arm has, without making one."""
        del reached_m
        return spec_of(turn_rad)

    def begin(self, rng: np.random.Generator) -> Numbers:
        """See `BulletMachine.begin`: any angles; the point is where the hand would be at any others."""
        angles = _any_angles(rng)
        hand = self._hand_at(angles)
        for _ in range(TARGETS):
            target = self._hand_at(_any_angles(rng))
            if target[2] >= LOWEST_M and math.dist(hand, target) >= NEAREST_M:
                break
        return angles | dict(zip(self.places[3:], target, strict=True))

    def place(self, at: Numbers) -> None:
        """See `BulletMachine.place`."""
        pybullet.restoreState(self._rest, physicsClientId=self._client)
        self._turn_to(at)

    def move(self, at: Numbers, values: Mapping[str, float]) -> Numbers:
        """See `BulletMachine.move`: each joint turns so far, or to its end."""
        goals = dict.fromkeys(ALL, 0.0)
        for name, joint in JOINTS.items():
            goals[joint] = min(HIGH[name], max(LOW[name], at[name] + values[f"turn_{name}"]))
        for joint, goal in goals.items():
            pybullet.setJointMotorControl2(
                self._machine,
                joint,
                pybullet.POSITION_CONTROL,
                targetPosition=goal,
                force=TORQUE_NM,
                maxVelocity=SPEED_RAD_S,
                physicsClientId=self._client,
            )
        for _ in range(int(GIVE_UP_S * HZ)):
            self.step()
            states = pybullet.getJointStates(self._machine, ALL, physicsClientId=self._client)
            left_rad = max(abs(state[0] - goals[joint]) for joint, state in enumerate(states))
            if left_rad < ARRIVED_RAD and max(abs(state[1]) for state in states) < STILL_RAD_S:
                break
        return at | {name: float(states[joint][0]) for name, joint in JOINTS.items()}

    def event(self) -> str:
        """See `BulletMachine.event`."""
        return "reached" if self.scene()["distance_m"] <= self._reached_m else NOTHING

    def reading(self) -> Reading:
        """See `BulletMachine.reading`."""
        scene = self.scene()
        return {
            "shoulder": scene["shoulder"],
            "elbow": scene["elbow"],
            "aside": scene["aside_rad"],
            "above": scene["above_rad"],
            "farther": scene["farther_m"],
            "distance": scene["distance_m"],
        }

    def scene(self) -> Numbers:
        """See `Body.scene`."""
        at = self.at
        hand = self._hand()
        target = tuple(at[name] for name in self.places[3:])
        seen, wanted = _from_the_eye(hand), _from_the_eye(target)
        return at | {
            "x_m": hand[0],
            "y_m": hand[1],
            "z_m": hand[2],
            "aside_rad": math.remainder(wanted[0] - seen[0], math.tau),
            "above_rad": wanted[1] - seen[1],
            "farther_m": wanted[2] - seen[2],
            "distance_m": math.dist(hand, target),
        }

    def image(self) -> np.ndarray:
        """See `Imaging.image`: the arm from aside, and a red ball where the point is."""
        at = self.at
        target = tuple(at[name] for name in self.places[3:])
        pybullet.resetBasePositionAndOrientation(
            self._ball, target, (0.0, 0.0, 0.0, 1.0), physicsClientId=self._client
        )
        view = pybullet.computeViewMatrix((1.6, -1.3, 1.2), (0.2, 0.0, 0.5), (0.0, 0.0, 1.0))
        lens = pybullet.computeProjectionMatrixFOV(42.0, IMAGE[0] / IMAGE[1], 0.1, 5.0)
        image = pybullet.getCameraImage(
            *IMAGE, view, lens, renderer=pybullet.ER_TINY_RENDERER, physicsClientId=self._client
        )[2]
        return np.ascontiguousarray(np.reshape(image, (IMAGE[1], IMAGE[0], 4))[..., :3], np.uint8)

    def _turn_to(self, angles: Mapping[str, float]) -> None:
        for joint in ALL:
            pybullet.resetJointState(self._machine, joint, 0.0, 0.0, physicsClientId=self._client)
        for name, joint in JOINTS.items():
            pybullet.resetJointState(self._machine, joint, angles[name], 0.0, physicsClientId=self._client)

    def _hand(self) -> tuple[float, float, float]:
        state = pybullet.getLinkState(self._machine, HAND, computeForwardKinematics=1, physicsClientId=self._client)
        x_m, y_m, z_m = map(float, state[4])
        return x_m, y_m, z_m

    def _hand_at(self, angles: Mapping[str, float]) -> tuple[float, float, float]:
        self._turn_to(angles)
        return self._hand()


def spec_of(turn_rad: float) -> Spec:
    """Return what an arm has whose joints turn so far in one action."""
    return Spec(
        sensors=(
            *(Sensor(name=name, low=LOW[name], high=HIGH[name], unit="rad") for name in ("shoulder", "elbow")),
            Sensor(name="aside", low=-math.pi, high=math.pi, unit="rad"),
            Sensor(name="above", low=-math.pi, high=math.pi, unit="rad"),
            Sensor(name="farther", low=-0.5, high=0.5, unit="m"),
            Sensor(name="distance", low=0.0, high=2.0, unit="m"),
        ),
        actuators=tuple(Actuator(name=f"turn_{name}", low=-turn_rad, high=turn_rad, unit="rad") for name in JOINTS),
        events=("reached",),
        scene=(*IiwaArm.places, "x_m", "y_m", "z_m", "aside_rad", "above_rad", "farther_m", "distance_m"),
    )


def _any_angles(rng: np.random.Generator) -> Numbers:
    return {name: float(rng.uniform(LOW[name], HIGH[name])) for name in JOINTS}


def _from_the_eye(point: tuple[float, ...]) -> tuple[float, float, float]:
    """Return a point's azimuth and elevation, rad, and its range, m."""
    x_m, y_m, z_m = (p - e for p, e in zip(point, EYE_M, strict=True))
    return math.atan2(y_m, x_m), math.atan2(z_m, math.hypot(x_m, y_m)), math.hypot(x_m, y_m, z_m)
