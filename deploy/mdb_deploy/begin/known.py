"""Names for what Gymnasium's own environments observe and do, by their documentation: spaces have numbers only."""

from __future__ import annotations

from typing import NamedTuple


class Names(NamedTuple):
    """Names of an observation's numbers, of an action's numbers, and of the things that can be done."""

    numbers: tuple[str, ...] = ()
    actuators: tuple[str, ...] = ()
    choices: tuple[str, ...] = ()


_LANDER = ("x", "y", "x_speed", "y_speed", "angle", "angle_speed", "left_leg", "right_leg")
KNOWN = {
    "CartPole": Names(("x", "x_speed", "angle", "angle_speed"), (), ("left", "right")),
    "MountainCar": Names(("position", "speed"), (), ("left", "none", "right")),
    "MountainCarContinuous": Names(("position", "speed"), ("force",)),
    "Pendulum": Names(("cos", "sin", "speed"), ("torque",)),
    "Acrobot": Names(("cos_1", "sin_1", "cos_2", "sin_2", "speed_1", "speed_2"), (), ("left", "none", "right")),
    "LunarLander": Names(_LANDER, (), ("none", "left engine", "main engine", "right engine")),
    "LunarLanderContinuous": Names(_LANDER, ("main", "aside")),
    "CarRacing": Names((), ("steer", "gas", "brake")),
    "Blackjack": Names(("sum", "dealer", "ace"), (), ("stick", "hit")),
    "FrozenLake": Names(("place",), (), ("left", "down", "right", "up")),
    "FrozenLake8x8": Names(("place",), (), ("left", "down", "right", "up")),
    "CliffWalking": Names(("place",), (), ("up", "right", "down", "left")),
    "CliffWalkingSlippery": Names(("place",), (), ("up", "right", "down", "left")),
    "Taxi": Names(("state",), (), ("south", "north", "east", "west", "pick up", "drop off")),
    "InvertedPendulum": Names(("x", "angle", "x_speed", "angle_speed"), ("force",)),
}
"""By the environment's name without its version."""


def names_of(env: str) -> Names:
    """Return the names of an environment's numbers; empty ones for what is not in the table."""
    plain = env.rpartition("/")[2].rpartition(":")[2].rpartition("-v")[0]
    return KNOWN.get(plain, Names())
