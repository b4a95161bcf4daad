"""Environments of other people's, with all that Gymnasium's spaces can be; registered as gymnasium environments."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

F = np.float32
NUMBERS = spaces.Box(-1.0, 1.0, (2,), F)
TWO = spaces.Discrete(2)

SEEN: dict[str, spaces.Space[Any]] = {
    "Dict": spaces.Dict(
        {
            "arm": spaces.Dict(
                {"joints": spaces.Box(-np.inf, np.inf, (3,), F), "grip": spaces.Discrete(3, start=-1)}
            ),
            "next.goal": spaces.Box(0.0, 9.0, (), F),
            "action": spaces.MultiBinary(4),
        }
    ),
    "Tuple": spaces.Tuple((spaces.Discrete(5), spaces.MultiDiscrete([2, 3]), NUMBERS)),
    "Image": spaces.Box(0, 255, (64, 48, 3), np.uint8),
    "Stacked": spaces.Dict(
        {"camera": spaces.Box(0, 255, (4, 84, 84), np.uint8), "speed": spaces.Box(0.0, np.inf, (1,), F)}
    ),
    "Grid": spaces.Box(0, 10, (7, 7, 3), np.uint8),
    "Many": spaces.Discrete(500),
}


class Mission(spaces.Space[str]):
    """A kind of space that is not Gymnasium's own, as MiniGrid has one."""

    def sample(self, *_: Any, **__: Any) -> str:
        return "go there"

    def contains(self, x: object) -> bool:
        return isinstance(x, str)

    def __repr__(self) -> str:
        return "Mission()"  # names of tests must be the same in each process


SEEN["Mission"] = spaces.Dict(
    {
        "mission": Mission(),
        "goal": spaces.Text(5),
        "pose": spaces.Tuple((NUMBERS, spaces.Sequence(NUMBERS))),
        "image": NUMBERS,
    }
)
SEEN["Words"] = spaces.Dict({"motor": NUMBERS, "note": spaces.Discrete(3), "reward": NUMBERS, "0": NUMBERS})
DONE: dict[str, spaces.Space[Any]] = {
    "Start": spaces.Discrete(3, start=2),
    "MultiDiscrete": spaces.MultiDiscrete([2, 3]),
    "ManyDiscrete": spaces.MultiDiscrete([9, 9, 9]),
    "MultiBinary": spaces.MultiBinary(3),
    "Square": spaces.Box(-2.0, 3.0, (2, 2), F),
    "Endless": spaces.Box(-np.inf, np.inf, (2,), F),
    "Whole": spaces.Box(0, 5, (1,), np.int64),
    "Words": spaces.Dict(
        {"gas": spaces.Box(0.0, 1.0, (1,), F), "feedback": spaces.Discrete(2), "observation_1": TWO}
    ),
    "Mixed": spaces.Dict({"gear": spaces.Discrete(3), "gas": spaces.Box(0.0, 1.0, (1,), F)}),
}
REFUSED: dict[str, tuple[spaces.Space[Any], spaces.Space[Any], str]] = {
    "Text": (spaces.Text(5), TWO, "observation is .*, a Text: its length or its kind changes"),
    "Sequence": (spaces.Sequence(NUMBERS), TWO, "a Sequence: its length or its kind changes"),
    "Graph": (
        spaces.Dict({"map": spaces.Graph(NUMBERS, None)}),
        TWO,
        "has nothing that can be a number; expected Box",
    ),
    "Said": (NUMBERS, spaces.Dict({"gas": TWO, "say": spaces.Text(5)}), "say is .*, a Text"),
    "States": (spaces.Discrete(5000), TWO, "a Discrete of 5000 values, among which nothing tells which are alike"),
    "Long": (spaces.Box(-1.0, 1.0, (5000,), F), TWO, "has 5000 numbers; expected at most 1024"),
    "One": (NUMBERS, spaces.Discrete(1), "there is one action only"),
    "Name": (spaces.Dict({"a" * 70: TWO}), TWO, "has a name of 70 letters"),
    "Keys": (spaces.Dict({"a.b": TWO, "a/b": TWO}), TWO, "names that are the same when written in plain letters"),
}


class Sampled(gymnasium.Env[Any, Any]):
    """Any observation; each action is worth its first number, and it ends after nine. It cannot show images."""

    def __init__(self, seen: spaces.Space[Any], done: spaces.Space[Any]) -> None:
        self.observation_space, self.action_space = seen, done

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.observation_space.seed(seed)
        self._steps = 0
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action), action
        self._steps += 1
        first = action["gas"] if isinstance(action, dict) else action
        return self.observation_space.sample(), float(np.ravel(first)[0]), self._steps == 9, False, {}


def register() -> None:
    """Make them known; once is enough."""
    kinds = {f"See{name}-v0": (seen, TWO) for name, seen in SEEN.items()}
    kinds |= {f"Do{name}-v0": (NUMBERS, done) for name, done in DONE.items()}
    kinds |= {f"Not{name}-v0": (seen, done) for name, (seen, done, _) in REFUSED.items()}
    for name, (seen, done) in kinds.items():
        if name not in gymnasium.registry:
            gymnasium.register(name, Sampled, kwargs={"seen": seen, "done": done})
