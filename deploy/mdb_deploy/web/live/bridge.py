"""The bridge's thread: finds the brain, joins it with a hub, joins it again; the page is told what is waited for.

Nothing that happens to router or brain ends it. It gives way to acting when both want the same core, as learning
does.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable

import structlog

from mdb_deploy.web.live.fan import Fan, Waiting
from mdb_deploy.web.live.finding import BRAIN, Found, NotYetError, find, run_of
from mdb_deploy.web.live.hub import FRAME_S, ROLE, Hub
from mdb_deploy.web.opening import Place
from mdb_deploy.web.telling.hello import hello
from mdb_deploy.web.telling.story import Story
from mdb_protocol.bundle import Bundle
from mdb_protocol.errors import MdbError
from mdb_protocol.roles import Role
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.shell.heartbeat import SILENT_S, START_S, Heart
from mdb_services.shell.service import run

log = structlog.get_logger()

AGAIN_S = 0.2
"""Between two looks for the brain."""
JOIN_S = 2.0
"""Bound on joining a router."""
NICE = 5
"""Showing gives way to acting when both want the same core, as learning does."""
CLOSE_S = 5.0
"""Bound on the thread's own end."""
NOTHING_RUNS = {"live": False, "brain": "", "run": ""}
"""The frame `hello` as long as there is no brain."""
MEMORY = "memory/store"
JOINS = "The console joins the brain."


class Beats(Heart):
    """The heart of a thread: it notes when it has beaten, and another thread asks."""

    def __init__(self) -> None:
        super().__init__()
        self._until_s = time.monotonic() + START_S

    def beat(self, next_s: float = SILENT_S) -> None:
        """See `Heart.beat`."""
        self._until_s = time.monotonic() + next_s

    def goes_on(self) -> bool:
        """Whether the thread has beaten in time."""
        return time.monotonic() <= self._until_s


class Bridge:
    """See the module's docstring."""

    def __init__(self, place: Place, instance: str, fan: Fan) -> None:
        self.beats = Beats()
        self.fan = fan
        self.found: Found | None = None
        """The brain that is shown."""
        self.hub: Hub | None = None
        """There while a router is joined."""
        self.on_found: Callable[[], None] = lambda: None
        """Called in this thread when another brain or run is shown."""
        self._place, self._role, self._instance = place, ROLE, instance
        user = Bundle.read(place.keys).user if place.keys is not None and place.keys.is_file() else None
        if user is not None and user.role is not Role.BRAIN:
            self._role, self._instance = user.role.value, user.name  # it may be nothing else
        self._waiting = Waiting()
        self._story: Story
        self._fresh = False
        """Whether the story has not been told yet what was before we came."""
        self._was_here = True
        self._stop, self._needed = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="bridge", daemon=True)
        fan.on_need = self._poke

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """Leave the router; returns when that is done, or after `CLOSE_S`."""
        self._stop.set()
        self._poke()
        self._thread.join(CLOSE_S)

    def _poke(self) -> None:
        self._needed.set()
        if (hub := self.hub) is not None:
            hub.bus.poke()

    def _run(self) -> None:
        os.nice(NICE)  # of this thread, and of those that it starts
        self.fan.begin(dict(NOTHING_RUNS), self._waiting)
        told = ""
        while not self._stop.is_set():
            self.beats.beat(START_S)
            try:
                words = self._show_brain()
            except NotYetError as error:
                words = str(error)
            except MdbError as error:
                words = str(error)
                if words != told:
                    log.warning("the brain cannot be shown", reason=words)
            except Exception as error:
                if told != (words := f"the console failed ({type(error).__name__}); it begins again"):
                    log.exception("the bridge failed; it begins again")
            told = words
            self._say(words)
            self._rest()

    def _show_brain(self) -> str:
        """Show the brain as long as it can be heard; return what is waited for then."""
        found = find(self._place)
        bus = ZenohBus(
            found.brain,
            found.endpoint,
            credentials=self._place.keys,
            connect_timeout_s=JOIN_S,
            give_up=self._stop.is_set,
        )
        try:
            story = self._story_of(found)
            hub = Hub(bus, self._instance, story, self.fan, role=self._role)
            self._begin(found, story, hub)
            if self._fresh:
                self._catch_up(hub, found)
                self._fresh = False
            run(hub, lambda: self._stop.is_set() or self._is_another(hub), found.run, self.beats)
        finally:
            self.hub = None
            bus.close()
        return "the brain is looked for"

    def _catch_up(self, hub: Hub, found: Found) -> None:
        """Tell the story what was before we came."""
        if found.run is not None:
            hub.catch_up(found.run, lambda: self.beats.beat(START_S))
        if MEMORY in hub.bus.alive():
            hub.ask_for_what_was(model.name for model in found.experiment.brain.model)

    def _story_of(self, found: Found) -> Story:
        """Return the story of this brain: the one that is told, if it is of this run."""
        before = self.found
        same = before is not None and (before.brain, before.run) == (found.brain, found.run)
        return self._story if same else Story(found.experiment)

    def _begin(self, found: Found, story: Story, hub: Hub) -> None:
        """Be there for orders; then tell of this brain, unless it is the one that was told of before."""
        before = self.found
        if before is not None and story is self._story:
            self.hub = hub
            return
        story.trouble(JOINS)  # said first, so that what comes after is another word, whatever a page knows of before
        greeting = hello(found.experiment, found.name, live=True)
        self._story, self._fresh, self.found, self.hub = story, True, found, hub
        self.fan.begin(greeting, story)
        self.fan.send()
        if before is not None:  # who is quick has come to teach the first one already
            self.on_found()

    def _is_another(self, hub: Hub) -> bool:
        """Whether the brain works in another run folder than the one that is shown, where it was not said which."""
        if self._place.run is not None or self._place.experiment is not None:
            return False
        here = BRAIN in hub.bus.alive()
        came, self._was_here = here and not self._was_here, here
        if not came or self.found is None:
            return False
        run_folder = run_of(hub.bus)
        return run_folder is not None and run_folder != self.found.run

    def _say(self, words: str) -> None:
        """Tell the page what is waited for."""
        if self.found is not None:
            self._story.trouble(words)
        else:
            self._waiting.trouble(words)

    def _rest(self) -> None:
        """Wait before the next look; browsers that come meanwhile are told."""
        until_s = time.monotonic() + AGAIN_S
        while not self._stop.is_set() and (left_s := until_s - time.monotonic()) > 0:
            self.fan.send()
            self._needed.wait(left_s)
            self._needed.clear()
            self._stop.wait(min(left_s, FRAME_S))
