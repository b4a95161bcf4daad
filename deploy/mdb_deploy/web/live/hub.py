"""What hears a brain for all browsers: one service, one bus, one story.

Hears all that the story is told of. While nobody watches it does nothing else; for those who watch it makes frames,
20 a second at most, and fewer where that would take more than its share of a processor. The robot makes pictures only
for those who watch: a token of ours says so, as long as a browser is there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

import structlog

from mdb_deploy.web.live.fan import Fan
from mdb_deploy.web.live.finding import BRAIN
from mdb_deploy.web.telling.story import Story
from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus
from mdb_protocol.errors import BusError, MdbError, QueryError
from mdb_services.recorder import read_log

log = structlog.get_logger()

ROLE, VIEWER = "web", "viewer"
FRAME_S = 0.05
"""The least time from one frame to the next: 20 a second."""
SHARE = 0.25
"""Of one processor, what telling takes at most: where frames take long, they come more seldom."""
COST_MEAN = 10
"""Frames in the running mean of what one takes: a large part now and then does not hold up those after it."""
LOOK_S = 0.25
"""So often it is looked whether the router is there, and whether the story has become another with time."""
ANSWER_S = 1.0
"""Bound on the memory store's answers."""
SILENT_S = 1.0
"""After so long without a word on how the run goes on there is nobody who would say it to who comes late."""
HEARD = (
    keys.SCENE, keys.PERCEPTION, keys.PICTURE, keys.ACTION, keys.ITERATION, keys.CURRENT_MODEL, keys.PHASE,
    keys.LESSON, keys.CONTEXT, keys.COMMAND, keys.FEEDBACK, keys.MEMORY_CHANGE, keys.PAIR, keys.CONTROL, keys.TIMING,
    keys.FINISHED,
)  # fmt: skip
"""What the story is told of."""
ROUTER_GONE = "The router is gone. Everything goes on by itself when it is back."
NO_BRAIN = "The brain is not at work: it starts, or it starts again."


class Hub:
    """See the module's docstring. The story is kept by the owner: the next hub goes on with it."""

    def __init__(self, bus: Bus, instance: str, story: Story, fan: Fan, *, role: str = ROLE) -> None:
        """Subscribe; what comes waits until `step`. `role`: as what it is alive, where keys let it be one alone."""
        self.bus, self.role, self.instance = bus, role, instance
        self._story, self._fan = story, fan
        self._inboxes = [(row, bus.subscriber(row)) for row in HEARD]
        self._unwatch: Callable[[], None] | None = None
        self._alive: frozenset[str] = frozenset()
        self._frame_s = self._look_s = self._cost_s = 0.0
        self._new = True
        self._frames = 0
        self._strange: set[str] = set()
        self._listens_s: float | None = None
        """Since when it takes what comes; None: not yet."""
        self.hears_control = False
        """Whether somebody has said over the bus how the run goes on, and so says it to who comes late."""

    @property
    def iteration(self) -> int:
        """The newest scene's."""
        scene = self._story.heard.scene
        return 0 if scene is None else scene.iteration

    @property
    def control(self) -> messages.Control:
        """How the run goes on, as somebody said it last; the story knows it, which outlives this hub."""
        return self._story.heard.control or messages.Control(iteration=0)

    @property
    def nobody_controls(self) -> bool:
        """Whether nobody says any more how the run goes on, so that who comes late would not hear it."""
        since_s = self._listens_s
        return not self.hears_control and since_s is not None and time.monotonic() - since_s > SILENT_S

    def catch_up(self, run: Path, beat: Callable[[], None]) -> None:
        """Take from the run's log what was said before; what comes meanwhile waits. `beat` is called now and then."""
        with suppress(MdbError, OSError):  # there is no log yet, or nothing in it
            for count, recorded in enumerate(read_log(run, self.bus.brain)):
                self._take(recorded.row, recorded.message)
                if count % 100 == 0:
                    beat()

    def ask_for_what_was(self, models: Iterable[str]) -> None:
        """Ask the memory store for what models and memories are, where there is no log to read it in."""
        for model in models:
            for row in (keys.MEMORY_SNAPSHOT, keys.KEPT_MODEL):
                with suppress(QueryError):  # it is not there, or has nothing yet
                    for answer in self.bus.query(row, ANSWER_S, model=model):
                        self._take(row, answer)

    def due_in_s(self) -> float:
        """See `Timed`."""
        if not self._fan.watched:
            return LOOK_S
        now_s = time.monotonic()
        return max(0.0, (self._frame_s if self._new or self._fan.needs else self._look_s) - now_s)

    def step(self) -> bool:
        """Take what has come; when it is time, hand frames to those who can take them."""
        moved = self._receive()
        now_s = time.monotonic()
        self._listens_s = self._listens_s or now_s
        if now_s >= self._look_s:
            self._look_s, self._new = now_s + LOOK_S, True
            self._look()
        self._new = self._new or moved
        self._say_watched()
        if self._fan.watched and now_s >= self._frame_s and (self._new or self._fan.needs):
            self._new = False
            self._frames += self._fan.send()
            self._cost_s += (time.monotonic() - now_s - self._cost_s) / COST_MEAN
            self._frame_s = now_s + max(FRAME_S, self._cost_s / SHARE)
        return moved

    def _receive(self) -> bool:
        moved = False
        for row, inbox in self._inboxes:
            for message in inbox.some():
                self._take(row, message)
                self.hears_control = self.hears_control or row is keys.CONTROL
                moved = True
        if (alive := self.bus.alive()) != self._alive:
            self._alive, moved = alive, True
            self._story.alive(alive)
        return moved

    def _take(self, row: keys.Key, message: messages.Message) -> None:
        """Tell the story; a message that it cannot take must not keep the others from those who watch."""
        try:
            self._story.take(row, message)
        except Exception:
            if row.path not in self._strange:
                log.exception("a message cannot be told", key=row.path)
                self._strange.add(row.path)

    def _look(self) -> None:
        """Say what is wrong, if something is."""
        connected = getattr(self.bus, "connected", lambda: True)()
        if not connected:
            self._story.trouble(ROUTER_GONE)
        else:
            self._story.trouble(None if BRAIN in self._alive or self._story.heard.finished else NO_BRAIN)

    def _say_watched(self) -> None:
        """Say to the robot whether somebody watches."""
        if self.role == VIEWER:
            return  # it says so all the time
        if self._fan.watched and self._unwatch is None:
            with suppress(BusError):  # keys that may not: then there are no pictures
                self._unwatch = self.bus.token(VIEWER, self.instance)
        elif not self._fan.watched and self._unwatch is not None:
            self._unwatch()
            self._unwatch = None

    def values(self) -> dict[str, float]:
        """Browsers that are there, frames made for them, the newest iteration."""
        counts = {"browsers": self._fan.count, "frames": self._frames, "iteration": self.iteration}
        return {name: float(value) for name, value in counts.items()}

    def close(self) -> None:
        """Leave the story as it is: the next hub goes on with it."""
