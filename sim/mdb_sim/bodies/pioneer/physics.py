"""The PyBullet body: a Pioneer 2 DX driven by its two wheels in a physics world.

Owns: the robot's build, its drive with feedback from the wheel encoders, walls and object, and the sonar's
rays. Keeps the same contract, sonar rules and episodes as the kinematic body. Every pybullet call names its
own physics client, so that several robots in one process do not mix.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pybullet

from mdb_sim.bodies.bullet import client
from mdb_sim.bodies.pioneer.arena import BODY_RADIUS_M, ArenaRobot
from mdb_sim.bodies.pioneer.sonar import BODY_CENTRE_X_M, SONAR_HEIGHT_M, Array
from mdb_sim.bodies.pioneer.world import TRACK_M, Placement, Pose
from mdb_sim.body import BodyError

WHEEL_RADIUS_M = 0.0825
MASS_KG = 9.0
"""See sim/README.md, "The Pioneer 2 DX"."""

CASTER_X_M, CASTER_RADIUS_M = -0.20, 0.0375
WHEEL_WIDTH_M = 0.037
WHEEL_KG, CASTER_KG, AXLE_KG = 0.4, 0.2, 1.0
BODY_BOTTOM_M, BODY_TOP_M = 0.06, 0.24
"""Where the mass and the shapes are, within the 9 kg and the outline above (ours)."""

SOLVER_ITERATIONS = 50
"""How often the engine goes over all constraints in a step. With fewer the errors grow
(ours; sim/README.md, "Physics")."""

TURN_SPEED_M_S, ADVANCE_SPEED_M_S = 0.35, 0.60
"""Top speeds of a wheel (ours)."""
ACCELERATION_M_S2 = 2.0
BRAKING_M_S2 = 1.6
"""The drive plans to brake less sharply than its wheels can, so that it does not run past its goal (ours)."""
SLOWDOWN_PER_S = 40.0
"""Close to its goal the drive goes at most this many times what remains a second (ours)."""
ARRIVED_M = 0.0002
"""A motion is over when the wheels have no more than this to go, together and against each other (ours)."""
GIVE_UP_S = 4.0
WHEEL_TORQUE_NM = 6.0
ROBOT_COLOUR = (0.85, 0.20, 0.10, 1.0)

_GROUND, _OBSTACLE, _WHEEL, _BODY = 2, 4, 8, 16
_RAY = 1  # Bullet casts rays as members of its default group.
_LEFT, _RIGHT, _HULL, _CASTER = 0, 1, 2, 3


def pioneer_urdf() -> str:
    """The robot as URDF: its base is the axle's middle, so that the base's pose is the centre of rotation."""
    hull_kg = MASS_KG - 2.0 * WHEEL_KG - CASTER_KG - AXLE_KG
    middle_m = (BODY_BOTTOM_M + BODY_TOP_M) / 2.0 - WHEEL_RADIUS_M
    quarter_turn = f'<origin xyz="0 0 0" rpy="{math.pi / 2} 0 0"/>'
    wheel = f'{quarter_turn}<geometry><cylinder radius="{WHEEL_RADIUS_M}" length="{WHEEL_WIDTH_M}"/></geometry>'
    # A cylinder's contact wanders over its width, and the track with it: turns were up to 5 degrees wrong.
    # A sphere touches the ground in one point below the wheel's middle.
    point_contact = f'<geometry><sphere radius="{WHEEL_RADIUS_M}"/></geometry>'
    hull_height_m = BODY_TOP_M - BODY_BOTTOM_M
    hull = f'<geometry><cylinder radius="{BODY_RADIUS_M}" length="{hull_height_m}"/></geometry>'
    caster = f'<geometry><sphere radius="{CASTER_RADIUS_M}"/></geometry>'
    return "\n".join(
        [
            '<?xml version="1.0"?>',
            '<robot name="pioneer2dx">',
            _link("axle", AXLE_KG, 0.01),
            _link("left_wheel", WHEEL_KG, 0.0014, wheel, point_contact),
            _link("right_wheel", WHEEL_KG, 0.0014, wheel, point_contact),
            _link("hull", hull_kg, 0.1, hull, hull),
            _link("caster", CASTER_KG, 0.0002, caster, caster),
            _joint("left_wheel", "continuous", (0.0, TRACK_M / 2.0, 0.0)),
            _joint("right_wheel", "continuous", (0.0, -TRACK_M / 2.0, 0.0)),
            _joint("hull", "fixed", (BODY_CENTRE_X_M, 0.0, middle_m)),
            _joint("caster", "fixed", (CASTER_X_M, 0.0, CASTER_RADIUS_M - WHEEL_RADIUS_M)),
            "</robot>",
        ]
    )


def _link(name: str, mass_kg: float, inertia: float, visual: str = "", collision: str = "") -> str:
    """One URDF link; inertia in kg m2, alike about every axis."""
    shapes = f"<visual>{visual}</visual><collision>{collision}</collision>" if collision else ""
    moments = f'ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"'
    inertial = f'<inertial><mass value="{mass_kg}"/><inertia {moments}/></inertial>'
    return f'<link name="{name}">{inertial}{shapes}</link>'


def _joint(child: str, kind: str, place_m: tuple[float, float, float]) -> str:
    axis = '<axis xyz="0 1 0"/>' if kind == "continuous" else ""
    place = " ".join(str(value) for value in place_m)
    return (
        f'<joint name="{child}_joint" type="{kind}"><parent link="axle"/><child link="{child}"/>'
        f'<origin xyz="{place}" rpy="0 0 0"/>{axis}</joint>'
    )


class PioneerRobot(ArenaRobot):
    """See `mdb_sim.body.Body`; `gui=True` opens PyBullet's window."""

    has_window = True
    get_ready = staticmethod(client.get_ready)

    def __init__(self, *, gui: bool = False, **options: Any) -> None:
        super().__init__(**options)
        config = self.config
        if gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
            # Asked for a window without one, pybullet ends the whole process.
            raise BodyError("gui=True needs a display, and DISPLAY is not set; set it or drop the gui option")
        self._client = pybullet.connect(pybullet.GUI) if gui else client.connect()
        if self._client < 0:
            raise BodyError(f"pybullet gave no physics client (gui={gui}); a process can hold one window only")
        self._step_s = 1.0 / config.physics_hz
        self._near = True
        self._build_world()
        self._robot = self._load_robot()
        if gui:
            self._dress_window()
        self._object = self._fixed(
            pybullet.GEOM_CYLINDER, (0.0, 0.0, 0.25), radius=config.object_radius_m, height=0.5
        )
        self._rest_m = self._settle()
        self._at_rest: int = pybullet.saveState(physicsClientId=self._client)

    def close(self) -> None:
        """Disconnect this robot's physics client."""
        super().close()
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def _dress_window(self) -> None:
        """Look down on the arena, without PyBullet's panels, at a robot that stands out from the floor."""
        pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_GUI, 0, physicsClientId=self._client)
        pybullet.resetDebugVisualizerCamera(3.2, 20.0, -50.0, (0.0, 0.0, 0.0), physicsClientId=self._client)
        for link in range(-1, pybullet.getNumJoints(self._robot, physicsClientId=self._client)):
            pybullet.changeVisualShape(self._robot, link, rgbaColor=ROBOT_COLOUR, physicsClientId=self._client)

    def _build_world(self) -> None:
        pybullet.setGravity(0.0, 0.0, -9.81, physicsClientId=self._client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=self._step_s,
            numSolverIterations=SOLVER_ITERATIONS,
            # Friction in each of two directions for itself, not in a cone: fewer computations, and the solver
            # comes nearer to the answer in the same iterations. Wheels that roll hardly tell the difference.
            enableConeFriction=0,
            deterministicOverlappingPairs=1,
            physicsClientId=self._client,
        )
        ground = pybullet.createMultiBody(
            0.0,
            pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self._client),
            physicsClientId=self._client,
        )
        self._filter(ground, -1, _GROUND, _WHEEL)
        pybullet.changeDynamics(ground, -1, lateralFriction=1.0, physicsClientId=self._client)
        half_m, thick_m = self.config.arena_m / 2.0, 0.1
        for sign in (-1.0, 1.0):
            middle_m = sign * (half_m + thick_m)
            along_m = half_m + 2.0 * thick_m
            self._fixed(pybullet.GEOM_BOX, (middle_m, 0.0, 0.25), halfExtents=(thick_m, along_m, 0.25))
            self._fixed(pybullet.GEOM_BOX, (0.0, middle_m, 0.25), halfExtents=(along_m, thick_m, 0.25))

    def _fixed(self, shape: int, place_m: tuple[float, float, float], **size: object) -> int:
        """A body that nothing moves: a wall or the object."""
        collision = pybullet.createCollisionShape(shape, physicsClientId=self._client, **size)
        body: int = pybullet.createMultiBody(0.0, collision, basePosition=place_m, physicsClientId=self._client)
        self._filter(body, -1, _OBSTACLE, _BODY | _RAY)
        return body

    def _filter(self, body: int, link: int, group: int, mask: int) -> None:
        pybullet.setCollisionFilterGroupMask(body, link, group, mask, physicsClientId=self._client)

    def _load_robot(self) -> int:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "pioneer2dx.urdf"
            path.write_text(pioneer_urdf(), encoding="ascii")
            robot: int = pybullet.loadURDF(
                str(path),
                basePosition=(0.0, 0.0, WHEEL_RADIUS_M),
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=self._client,
            )
        for link, friction in ((_LEFT, 1.0), (_RIGHT, 1.0), (_CASTER, 0.0)):
            self._filter(robot, link, _WHEEL, _GROUND)
            pybullet.changeDynamics(robot, link, lateralFriction=friction, physicsClientId=self._client)
        self._filter(robot, _HULL, _BODY, _OBSTACLE)
        pybullet.changeDynamics(robot, _HULL, lateralFriction=0.0, physicsClientId=self._client)
        return robot

    def _settle(self) -> float:
        """Let the robot come to rest at the arena's centre; returns the axle's height in metres."""
        away_m = self.config.arena_m / 2.0 - 2.0 * self.config.object_radius_m
        self._move_object(away_m, away_m)
        self._at = Pose(0.0, 0.0, 0.0)
        self._drive(0.0, 0.0)
        for _ in range(self.config.physics_hz):
            pybullet.stepSimulation(physicsClientId=self._client)
        place_m, _ = pybullet.getBasePositionAndOrientation(self._robot, physicsClientId=self._client)
        return float(place_m[2])

    def _move_object(self, x_m: float, y_m: float) -> None:
        pybullet.resetBasePositionAndOrientation(
            self._object, (x_m, y_m, 0.25), (0.0, 0.0, 0.0, 1.0), physicsClientId=self._client
        )

    def _place(self, placement: Placement) -> None:
        # From one saved state, so that no contact or velocity of the past reaches what follows: a restored
        # run must go on as the first one did.
        pybullet.restoreState(self._at_rest, physicsClientId=self._client)
        robot = placement.robot
        turned = (0.0, 0.0, math.sin(robot.heading_rad / 2.0), math.cos(robot.heading_rad / 2.0))
        pybullet.resetBasePositionAndOrientation(
            self._robot, (robot.x_m, robot.y_m, self._rest_m), turned, physicsClientId=self._client
        )
        pybullet.resetBaseVelocity(self._robot, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), physicsClientId=self._client)
        for wheel in (_LEFT, _RIGHT):
            pybullet.resetJointState(self._robot, wheel, 0.0, 0.0, physicsClientId=self._client)
        self._move_object(placement.object_x_m, placement.object_y_m)
        self._at = robot

    def _pose(self) -> Pose:
        return self._at

    def _true_pose(self) -> Pose:
        place_m, turned = pybullet.getBasePositionAndOrientation(self._robot, physicsClientId=self._client)
        x, y, z, w = turned
        heading_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return Pose(float(place_m[0]), float(place_m[1]), heading_rad)

    def _move(self, turn_rad: float, advance_m: float) -> bool:
        self._place(self.placement)
        self._near = self._may_touch(self._at, advance_m)
        bumped = self._travel(0.0, turn_rad * TRACK_M / 2.0, TURN_SPEED_M_S)
        bumped = bumped or self._travel(advance_m, turn_rad * TRACK_M / 2.0, ADVANCE_SPEED_M_S)
        self._at = self._true_pose()
        return bumped

    def _travel(self, forward_goal_m: float, turning_goal_m: float, top_speed_m_s: float) -> bool:
        """Drive until the wheels have gone so far together (forward) and against each other (turning).

        Both are counted from the wheels' zero, so that the advance mends what the turn left. Returns whether
        the robot touched something, at which it stops.
        """
        forward_m_s = turning_m_s = 0.0
        for _ in range(int(GIVE_UP_S * self.config.physics_hz)):
            left_m, right_m = self._wheels_m()
            forward_left_m = forward_goal_m - (left_m + right_m) / 2.0
            turning_left_m = turning_goal_m - (right_m - left_m) / 2.0
            if abs(forward_left_m) <= ARRIVED_M and abs(turning_left_m) <= ARRIVED_M:
                break
            forward_m_s = self._speed(forward_m_s, forward_left_m, top_speed_m_s)
            turning_m_s = self._speed(turning_m_s, turning_left_m, top_speed_m_s)
            self._drive(forward_m_s - turning_m_s, forward_m_s + turning_m_s)
            pybullet.stepSimulation(physicsClientId=self._client)
            if self._near and self._touches():
                return True
        return False

    def _speed(self, last_m_s: float, remaining_m: float, top_m_s: float) -> float:
        """The next wheel speed: what still lets it brake to the goal, within top speed and acceleration."""
        distance_m = abs(remaining_m)
        size_m_s = min(top_m_s, math.sqrt(2.0 * BRAKING_M_S2 * distance_m), SLOWDOWN_PER_S * distance_m)
        wanted_m_s = math.copysign(size_m_s, remaining_m)
        change_m_s = ACCELERATION_M_S2 * self._step_s
        return min(max(wanted_m_s, last_m_s - change_m_s), last_m_s + change_m_s)

    def _wheels_m(self) -> tuple[float, float]:
        """How far the encoders say the left and the right wheel have rolled since the motion began.

        A wheel that rolls a share of what it is told does not know of it.
        """
        left, right = pybullet.getJointStates(self._robot, (_LEFT, _RIGHT), physicsClientId=self._client)
        changes = self.changes
        return WHEEL_RADIUS_M * left[0] / changes.left_wheel, WHEEL_RADIUS_M * right[0] / changes.right_wheel

    def _drive(self, left_m_s: float, right_m_s: float) -> None:
        left_m_s, right_m_s = left_m_s * self.changes.left_wheel, right_m_s * self.changes.right_wheel
        pybullet.setJointMotorControlArray(
            self._robot,
            (_LEFT, _RIGHT),
            pybullet.VELOCITY_CONTROL,
            targetVelocities=(left_m_s / WHEEL_RADIUS_M, right_m_s / WHEEL_RADIUS_M),
            forces=(WHEEL_TORQUE_NM, WHEEL_TORQUE_NM),
            physicsClientId=self._client,
        )

    def _touches(self) -> bool:
        """Whether something pushed the hull in the last step.

        The engine pushes in the very step in which the hull would enter a thing, so the robot stops at its
        surface, however long the steps are.
        """
        contacts = pybullet.getContactPoints(bodyA=self._robot, linkIndexA=_HULL, physicsClientId=self._client)
        return any(contact[9] > 0.0 for contact in contacts or ())

    def cast(self, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        """Rays in the physics world, at the sonars' height; see `sonar.RayCaster`."""
        reach_m = self.config.sonar_max_m
        height_m = np.full((len(origins_m), 1), SONAR_HEIGHT_M)
        hits = pybullet.rayTestBatch(
            np.hstack([origins_m, height_m]).tolist(),
            np.hstack([origins_m + reach_m * directions, height_m]).tolist(),
            collisionFilterMask=_OBSTACLE,
            physicsClientId=self._client,
        )
        fractions = np.array([hit[2] for hit in hits])
        normals = np.array([hit[4][:2] for hit in hits])
        distances_m = np.where(fractions < 1.0, fractions * reach_m, np.inf)
        return distances_m, np.abs(np.einsum("ij,ij->i", normals, directions))
