"""A Pioneer whose actions take long, and that writes down what it is told. It lies beside an experiment file."""

import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.body import Outcome, Spec


class SlowPioneer(KinematicRobot):
    """See the module's docstring; `diary` is a file with one line for each thing that happened, and when."""

    def __init__(self, *, takes_s: float, diary: str, **options: Any) -> None:
        super().__init__(**options)
        self._takes_s, self._diary = takes_s, Path(diary)
        self._halted = threading.Event()

    @classmethod
    def spec_of(cls, *, takes_s: float, diary: str, **options: Any) -> Spec:
        del takes_s, diary
        return super().spec_of(**options)

    def act(self, values: Mapping[str, float]) -> Outcome:
        self._halted.clear()
        self._write("acts")
        self._halted.wait(self._takes_s)
        outcome = super().act(values)
        self._write("rests")
        return outcome

    def halt(self) -> None:
        self._write("halts")
        self._halted.set()

    def _write(self, what: str) -> None:
        with self._diary.open("a", encoding="ascii") as file:
            file.write(f"{time.monotonic()} {what}\n")
