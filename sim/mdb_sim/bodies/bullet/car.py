"""A racing car that drives to a ball: it steers, drives for a while, ahead or back, and brakes.

The rear wheels drive; the front ones steer, the inner one more, so that all roll about one point. It cannot turn on
the spot. See sim/README.md, "The car".
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np
import pybullet

from mdb_protocol.messages import Drawing, Shape
from mdb_sim.bodies.bullet.machine import BulletMachine
from mdb_sim.body import NOTHING, Actuator, BodyError, Numbers, Reading, Sensor, Spec

HZ = 120
REAR, FRONT, STEERING = (2, 3), (5, 7), (4, 6)
"""Joints, left and right."""
WHEEL_RADIUS_M, WHEELBASE_M, HALF_TRACK_M = 0.05, 0.325, 0.1
TORQUE_NM, STEERING_NM = 10.0, 10.0
SPEED_M_S = 0.6
STEER_S, DRIVE_S, BRAKE_S = 0.2, 0.6, 0.4
"""How long it steers before it drives, how long it drives, and how long it brakes at most."""
STILL_M_S = 2e-3
MOST_STEER_RAD = 0.6
BALL_M = 0.1
"""Radius."""
NOSE_M = 0.2
"""From the middle between the rear wheels to the point that is to come to the ball: between the axles."""
TRAIL = 256


class RaceCar(BulletMachine):
    """See the module's docstring.

    Options: the ball is placed `place_min_m` to `place_max_m` away, anywhere around, and captured at `capture_m`.
    An episode is over, `lost`, when the ball is more than `lost_m` away.
    """

    places = ("x_m", "y_m", "heading_rad", "ball_x_m", "ball_y_m")
    spec = Spec(
        sensors=(
            Sensor(name="distance", low=0.0, high=4.0, unit="m"),
            Sensor(name="angle", low=-math.pi / 2, high=math.pi / 2, unit="rad"),
            Sensor(name="behind", low=0.0, high=1.0),
            Sensor(name="ahead", low=-4.0, high=4.0, unit="m"),
            Sensor(name="aside", low=-4.0, high=4.0, unit="m"),
        ),
        actuators=(
            Actuator(name="steer", low=-MOST_STEER_RAD, high=MOST_STEER_RAD, unit="rad"),
            Actuator(name="drive", low=-1.0, high=1.0),
        ),
        events=("capture", "lost"),
        scene=places,
    )

    def __init__(
        self, *, place_min_m: float = 0.5, place_max_m: float = 1.5, capture_m: float = 0.25, lost_m: float = 4.0
    ) -> None:
        """BodyError when the options are not in order."""
        if not 0.0 < capture_m < place_min_m <= place_max_m < lost_m <= 100.0:
            raise BodyError(
                f"robot.options: capture_m={capture_m}, place_min_m={place_min_m}, place_max_m={place_max_m}, "
                f"lost_m={lost_m}; expected the lesser first, and 100 at most"
            )
        self._near_m, self._far_m, self._capture_m, self._lost_m = place_min_m, place_max_m, capture_m, lost_m
        self._trail: deque[tuple[float, float]] = deque(maxlen=TRAIL)
        super().__init__("racecar/racecar.urdf", WHEEL_RADIUS_M, HZ, fixed=False)
        for joint in (*REAR, *FRONT):
            pybullet.changeDynamics(self._machine, joint, lateralFriction=1.0, physicsClientId=self._client)
        self._roll(FRONT, (0.0, 0.0), 0.0)
        self._drive(0.0, 0.0)
        for _ in range(HZ):
            self.step()
        self._height_m = float(self._base()[0][2])
        self._rest: int = pybullet.saveState(physicsClientId=self._client)

    def begin(self, rng: np.random.Generator) -> Numbers:
        """See `BulletMachine.begin`: the car in the middle, with any heading, the ball anywhere around it."""
        heading_rad, towards_rad = rng.uniform(-math.pi, math.pi, 2).tolist()
        away_m = float(rng.uniform(self._near_m, self._far_m))
        self._trail.clear()
        ball = away_m * math.cos(towards_rad), away_m * math.sin(towards_rad)
        nose = NOSE_M * math.cos(heading_rad), NOSE_M * math.sin(heading_rad)
        return dict(zip(self.places, (0.0, 0.0, heading_rad, nose[0] + ball[0], nose[1] + ball[1]), strict=True))

    def place(self, at: Numbers) -> None:
        """See `BulletMachine.place`."""
        pybullet.restoreState(self._rest, physicsClientId=self._client)
        turned = (0.0, 0.0, math.sin(at["heading_rad"] / 2.0), math.cos(at["heading_rad"] / 2.0))
        pybullet.resetBasePositionAndOrientation(
            self._machine, (at["x_m"], at["y_m"], self._height_m), turned, physicsClientId=self._client
        )
        pybullet.resetBaseVelocity(self._machine, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), physicsClientId=self._client)

    def move(self, at: Numbers, values: Mapping[str, float]) -> Numbers:
        """See `BulletMachine.move`."""
        steer_rad, speed_m_s = values["steer"], values["drive"] * SPEED_M_S
        self._steer(steer_rad)
        for seconds, speed in ((STEER_S, 0.0), (DRIVE_S, speed_m_s), (BRAKE_S, 0.0)):
            self._drive(speed, steer_rad)
            for _ in range(round(seconds * HZ)):
                self.step()
                if not speed and seconds == BRAKE_S and self._still():
                    break
        place_m, turned = self._base()
        heading_rad = float(pybullet.getEulerFromQuaternion(turned)[2])
        self._trail.append((at["x_m"], at["y_m"]))
        return at | {"x_m": float(place_m[0]), "y_m": float(place_m[1]), "heading_rad": heading_rad}

    def event(self) -> str:
        """See `BulletMachine.event`."""
        away_m = math.hypot(*self._ball())
        if away_m <= self._capture_m:
            return "capture"
        return "lost" if away_m > self._lost_m else NOTHING

    def reading(self) -> Reading:
        """See `BulletMachine.reading`: where the ball is from the nose; the angle folded, as the Pioneer's."""
        ahead_m, aside_m = self._ball()
        angle_rad = math.atan2(aside_m, ahead_m)
        return {
            "distance": math.hypot(ahead_m, aside_m),
            "angle": math.asin(math.sin(angle_rad)),
            "behind": float(abs(angle_rad) > math.pi / 2),
            "ahead": ahead_m,
            "aside": aside_m,
        }

    def scene(self) -> Numbers:
        """See `Body.scene`."""
        return dict(self.at)

    def draw(self, reading: Reading) -> Drawing:
        """See `Drawable.draw`."""
        at = self.at
        heading_rad, here, ball = at["heading_rad"], (at["x_m"], at["y_m"]), (at["ball_x_m"], at["ball_y_m"])

        def there(ahead_m: float, aside_m: float) -> tuple[float, float]:
            cos, sin = math.cos(heading_rad), math.sin(heading_rad)
            return here[0] + ahead_m * cos - aside_m * sin, here[1] + ahead_m * sin + aside_m * cos

        outline = [
            there(*corner) for corner in ((-0.1, -0.15), (0.42, -0.15), (0.5, 0.0), (0.42, 0.15), (-0.1, 0.15))
        ]
        shapes = [Shape(kind="disc", points=[ball], radius=BALL_M, what="thing")]
        if self._trail:
            shapes.append(Shape(kind="line", points=[*self._trail, here], what="trail"))
        shapes.append(Shape(kind="line", points=[*outline, outline[0]], what="robot"))
        if {"ahead", "aside"} <= reading.keys():
            seen = there(NOSE_M + float(reading["ahead"]), float(reading["aside"]))  # type: ignore[arg-type]
            shapes.append(Shape(kind="line", points=[there(NOSE_M, 0.0), seen], what="sensed"))
        low, high = ([f(p) for p in zip(here, ball, strict=True)] for f in (min, max))
        box = (low[0] - 0.6, low[1] - 0.6, high[0] + 0.6, high[1] + 0.6)
        return Drawing(shapes=shapes, box=box, front_rad=heading_rad)

    def _ball(self) -> tuple[float, float]:
        """Where the ball is from the nose: ahead and to the left."""
        at = self.at
        x_m, y_m = at["ball_x_m"] - at["x_m"], at["ball_y_m"] - at["y_m"]
        cos, sin = math.cos(at["heading_rad"]), math.sin(at["heading_rad"])
        return x_m * cos + y_m * sin - NOSE_M, y_m * cos - x_m * sin

    def _base(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        where: tuple[tuple[float, ...], tuple[float, ...]] = pybullet.getBasePositionAndOrientation(
            self._machine, physicsClientId=self._client
        )
        return where

    def _still(self) -> bool:
        moves, turns = pybullet.getBaseVelocity(self._machine, physicsClientId=self._client)
        return bool(max(map(abs, (*moves, *turns))) < STILL_M_S)

    def _steer(self, steer_rad: float) -> None:
        slope = math.tan(steer_rad)
        angles = [
            math.atan2(WHEELBASE_M * slope, WHEELBASE_M - side_m * slope) for side_m in (HALF_TRACK_M, -HALF_TRACK_M)
        ]
        pybullet.setJointMotorControlArray(
            self._machine,
            STEERING,
            pybullet.POSITION_CONTROL,
            targetPositions=angles,
            forces=(STEERING_NM, STEERING_NM),
            physicsClientId=self._client,
        )

    def _drive(self, speed_m_s: float, steer_rad: float) -> None:
        """Turn the rear wheels, the outer one faster."""
        inner = HALF_TRACK_M * math.tan(steer_rad) / WHEELBASE_M
        self._roll(REAR, (speed_m_s * (1.0 - inner), speed_m_s * (1.0 + inner)), TORQUE_NM)

    def _roll(self, wheels: tuple[int, int], speeds_m_s: tuple[float, float], torque_nm: float) -> None:
        pybullet.setJointMotorControlArray(
            self._machine,
            wheels,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=[speed / WHEEL_RADIUS_M for speed in speeds_m_s],
            forces=(torque_nm, torque_nm),
            physicsClientId=self._client,
        )
