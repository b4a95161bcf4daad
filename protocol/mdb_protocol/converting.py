"""Plain values to classes by msgspec, from any thread.

msgspec learns a class when it first converts to it, and two threads that do so at once crash (0.22: a segmentation
fault). The console reads experiments in several threads. Messages are learnt when they are imported.
"""

from __future__ import annotations

import threading
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")
_LEARNING = threading.RLock()


def convert(plain: Any, cls: type[T]) -> T:
    """Return an object of a class, checked; msgspec.ValidationError, or the class's own error, says what is wrong."""
    with _LEARNING:
        return msgspec.convert(plain, cls)
