"""Seeded randomness: every random number is a function of (seed, name, counter), of nothing else.

A process that is killed and started again continues with the numbers it would have drawn, because no
generator has a state that could be lost. Compiled code draws its own numbers in the same spirit
(``operators.py``), from the 64-bit ``key`` given here.
"""

import hashlib

import numpy as np

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
    words = np.array([0, 0, 0, counter], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=_digest(seed, name, _PHILOX_KEY_BYTES), counter=words))
