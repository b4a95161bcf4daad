"""Seeded randomness: every random number is a function of (seed, name, counter), of nothing else.

A process that is killed and started again continues with the numbers it would have drawn, because no
generator has a state that could be lost. Compiled code draws its own numbers in the same spirit
(``operators.py``), from the 64-bit ``key`` given here.
"""

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import NDArray

_KEY_BYTES = 8
_PHILOX_KEY_BYTES = 16
_COUNTER_LIMIT = 2**64


def _digest(seed: int, name: str, size: int) -> int:
    text = f"{seed}:{name}".encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=size).digest(), "little")


def key(seed: int, name: str) -> int:
    """Return a stable 64-bit key of the seed and the name: the same in every process and Python version."""
    return _digest(seed, name, _KEY_BYTES)


def generator(seed: int, name: str, counter: int) -> np.random.Generator:
    """Return the generator of one step, say an iteration: a pure function of its three arguments.

    The counter is the highest word of Philox's own counter, so steps are 2**192 draws apart.
    Raises ValueError when the counter is negative or has more than 64 bits.
    """
    if not 0 <= counter < _COUNTER_LIMIT:
        raise ValueError(f"counter is {counter}; expected 0 <= counter < 2**64: count steps from zero")
    high, low = divmod(_digest(seed, name, _PHILOX_KEY_BYTES), 2**64)
    return philox((low, high), (0, 0, 0, counter))


def philox(key: Sequence[int], counter: Sequence[int]) -> np.random.Generator:
    """Return the generator of a key of two 64-bit words and a counter of four, the lowest word first."""
    words, seed = np.array(counter, dtype=np.uint64), _Key(np.array(key, dtype=np.uint64))
    return np.random.Generator(np.random.Philox(seed, counter=words))  # type: ignore[arg-type] # numpy takes any such


class _Key(ISeedSequence):
    """A key as it is. With `Philox(key=...)` numpy asks the system each time for entropy, which it does not use."""

    def __init__(self, words: NDArray[np.uint64]) -> None:
        self._words = words

    def generate_state(self, n_words: int, dtype: Any = np.uint64) -> NDArray[Any]:
        """Return the key; Philox asks for two words of 64 bits."""
        return self._words[:n_words].astype(dtype, copy=False)
