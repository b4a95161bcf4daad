"""Pictures of a run of before: an episode is done again from the log, in another body, as far as it is looked at.

A simulated body, begun with the same seed and episode, does the same actions with the same effect, which is checked
against the log at each step. What is no simulation is never moved. Why there is no picture is said in its place.
"""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from mdb_deploy.web.telling.parts import picture_part
from mdb_protocol.errors import MdbError
from mdb_protocol.messages import Scene
from mdb_sim.bodies.finding import is_simulated
from mdb_sim.body import Body, BodyError, Changeable, Numbers, Reading, picture_of
from mdb_sim.runs.experiment import Experiment

MOST_STEPS = 2000
"""Actions of an episode that are done again, at the most."""
MOST_S = 5.0
"""For one picture an episode is gone on with for so long; who asks again gets further."""
MOST_PICTURES = 256
"""Pictures that are kept."""
ALIKE = 1e-6
"""Numbers of a scene that differ by no more, as a share of 1 or of themselves, are the same."""


class _NotYetError(BodyError):
    """The picture takes longer than it may; what was done so far is kept."""


class Film:
    """See the module's docstring. Keeps the body for the episode that is looked at."""

    def __init__(
        self,
        experiment: Experiment,
        scene: Callable[[int], Scene | None],
        sensed: Callable[[int], Reading | None],
        changes: Sequence[tuple[int, dict[str, Any]]],
    ) -> None:
        """`scene`, `sensed`: the log's, by the number of actions done; `changes`: of the body, after so many."""
        self._experiment, self._scene, self._sensed = experiment, scene, sensed
        self._changes = sorted(changes, key=lambda change: change[0])
        self._body: Body | None = None
        self._reading: Reading = {}
        self._start, self._done = -1, 0
        self._kept: OrderedDict[int, dict[str, Any]] = OrderedDict()

    def close(self) -> None:
        """Free the body."""
        if self._body is not None:
            self._body.close()
            self._body = None

    def picture(self, iteration: int) -> dict[str, Any]:
        """Return {iteration, drawing, image, missing} of the moment after so many actions."""
        if iteration not in self._kept:
            try:
                self._kept[iteration] = {**self._made(iteration), "missing": None}
            except (MdbError, BodyError) as error:
                if not isinstance(error, _NotYetError):
                    self._start = -1
                return {"iteration": iteration, "drawing": None, "image": None, "missing": str(error)}
            if len(self._kept) > MOST_PICTURES:
                self._kept.popitem(last=False)
        return self._kept[iteration]

    def _made(self, iteration: int) -> dict[str, Any]:
        start = self._beginning(iteration)
        if start != self._start or self._done > iteration:
            self._begin(start)
        assert self._body is not None
        until_s = time.monotonic() + MOST_S
        while self._done < iteration:
            if time.monotonic() > until_s:
                left = iteration - self._done
                raise _NotYetError(f"{left} actions of this episode are still to be done again; ask once more")
            self._act(self._done)
        sensed = self._sensed(iteration)  # another body's sensors have other noise
        picture = picture_of(self._body, self._reading if sensed is None else sensed, iteration)
        if picture.drawing is None and picture.image is None:
            raise BodyError("this body has neither a drawing nor an image")
        return picture_part(picture)

    def _beginning(self, iteration: int) -> int:
        """Return after how many actions the episode began that goes on at a moment."""
        for start in range(iteration, max(-1, iteration - MOST_STEPS), -1):
            scene = self._scene(start)
            if scene is None:
                raise BodyError(f"the log has no scene after {start} actions, so the episode cannot be done again")
            if scene.ended or scene.action is None:
                return start
        raise BodyError(f"the episode is longer than {MOST_STEPS} actions, too long to be done again")

    def _begin(self, start: int) -> None:
        """Begin an episode, in a body that was changed as the run's was."""
        if self._body is None or self._changes:
            self.close()
            self._body = self._another()
        for at, settings in self._changes:
            if at < start:
                self._change(settings)
        scene = self._logged(start)
        self._reading = self._body.reset(self._experiment.brain.experiment.seed, scene.episode)
        self._start = self._done = start
        self._change_now()
        _check_same(self._body.scene(), scene.now, 0)

    def _act(self, iteration: int) -> None:
        """Do the action of an iteration again."""
        assert self._body is not None
        scene = self._logged(iteration + 1)
        if scene.action is None:
            raise BodyError(f"the log does not say what was done in iteration {iteration}")
        self._reading = self._body.act(scene.action).reading
        self._done += 1
        _check_same(self._body.scene(), scene.reached, self._done - self._start)
        self._change_now()

    def _logged(self, iteration: int) -> Scene:
        scene = self._scene(iteration)
        if scene is None:
            raise BodyError(f"the log has no scene after {iteration} actions")
        return scene

    def _change_now(self) -> None:
        for at, settings in self._changes:
            if at == self._done:
                self._change(settings)

    def _change(self, settings: dict[str, Any]) -> None:
        if isinstance(self._body, Changeable):
            with suppress(BodyError):  # refused here, refused there
                self._body.change(**settings)

    def _another(self) -> Body:
        """Make the run's body anew; MdbError or BodyError tells why there is none."""
        name = self._experiment.robot.body
        if not is_simulated(name, self._experiment.folder):
            raise BodyError(f"the body {name!r} does not say that it is simulated, so it is not moved for a picture")
        return self._experiment.body()


def _check_same(found: Numbers, logged: Numbers, done: int) -> None:
    for name, value in logged.items():
        if name in found and not math.isclose(found[name], value, rel_tol=ALIKE, abs_tol=ALIKE):
            raise BodyError(
                f"done again, the episode goes another way: after {done} actions {name} is {found[name]:g}, in the "
                f"log {value:g}"
            )
