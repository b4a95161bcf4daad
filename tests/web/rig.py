"""A console as users have it: a real router, a real server on a port of its own, real clients.

The robot and the optimizer are played by hand, so that a test knows what there is to see.
"""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Queue
from types import TracebackType
from typing import Any, Self

import httpx
from websockets.asyncio.client import ClientConnection, connect

from mdb_deploy.experiments import experiment_path
from mdb_deploy.web.guard import Guard
from mdb_deploy.web.opening import Place, WebOptions
from mdb_deploy.web.serve import serve
from mdb_protocol import keys, messages
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import Router
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_services.shell.heartbeat import Heart
from mdb_sim.runs.experiment import Experiment

BRAIN = "pioneer"
BOUND_S = 20.0
BY_NAME = ("models", "memory")
"""Parts of which a frame holds those models only that are new."""
ROUTER_CONFIG = Path(__file__).parents[2] / "deploy" / "router.json5"


class Console:
    """A served page; `at` is where."""

    def __init__(self, options: WebOptions) -> None:
        self._ended = threading.Event()
        self._guards: Queue[Guard | BaseException] = Queue()
        self._options = options
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def _serve(self) -> None:
        try:
            serve(self._options, self._ended.is_set, Heart(), self._guards.put)
        except BaseException as error:
            self._guards.put(error)
            raise

    def __enter__(self) -> Self:
        self._thread.start()
        found = self._guards.get(timeout=BOUND_S)
        if isinstance(found, BaseException):
            raise found
        self.guard = found
        self.at = found.site.address()
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join(BOUND_S)
        assert not self._thread.is_alive()

    def get(self, path: str, **options: Any) -> httpx.Response:
        """Ask for a path."""
        return httpx.get(self.at.rstrip("/") + path, timeout=BOUND_S, **options)

    @property
    def live(self) -> str:
        """Where the socket is."""
        return self.at.replace("http", "ws", 1) + "live"


class Page:
    """One browser, as far as the wire knows it."""

    def __init__(self, console: Console, **options: Any) -> None:
        self._loop = asyncio.new_event_loop()  # in this thread alone: TLS in two threads at once is not safe
        opening = connect(console.live, max_size=None, open_timeout=BOUND_S, **options)
        try:
            self._socket: ClientConnection = self._loop.run_until_complete(_open(opening))
        except BaseException:
            self._loop.close()
            raise
        self.state: dict[str, Any] = {}
        self.frames = 0

    def take(self, bound_s: float = BOUND_S) -> dict[str, Any]:
        """Return the next frame; parts are merged into `state`."""
        frame: dict[str, Any] = json.loads(
            self._loop.run_until_complete(asyncio.wait_for(self._socket.recv(), bound_s))
        )
        self.frames += 1
        if frame["is"] == "now":
            by_name = {part: self.state.get(part, {}) | frame[part] for part in BY_NAME if part in frame}
            self.state |= frame | by_name
        elif frame["is"] == "hello":
            self.state = {"you": self.state.get("you", {}), "hello": frame}
        else:
            self.state[frame["is"]] = frame
        return frame

    def until(self, condition: Callable[[dict[str, Any]], object], bound_s: float = BOUND_S) -> dict[str, Any]:
        """Take frames until the state is as wanted; return it."""
        deadline = time.monotonic() + bound_s
        while not condition(self.state):
            assert time.monotonic() < deadline, f"not within {bound_s} s; {str(self.state)[:2000]}"
            self.take(max(0.01, deadline - time.monotonic()))
        return self.state

    def ask(self, **order: Any) -> dict[str, Any]:
        """Send an order; return the answer to it."""
        return self.say(json.dumps(order))

    def say(self, text: str | bytes) -> dict[str, Any]:
        """Send text as it is; return the answer."""
        self.send(text)
        deadline = time.monotonic() + BOUND_S
        while (frame := self.take())["is"] != "said":
            assert time.monotonic() < deadline, f"no answer to {text[:200]!r}"
        return frame

    def send(self, text: str | bytes) -> None:
        """Send text as it is, or sound."""
        self._loop.run_until_complete(self._socket.send(text))

    def close(self) -> None:
        """Close the window."""
        self._loop.run_until_complete(self._socket.close())
        self._loop.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


async def _open(opening: Any) -> ClientConnection:
    found: ClientConnection = await opening
    return found


def scene(iteration: int, **more: Any) -> messages.Scene:
    """Return a scene of the Pioneer's."""
    now = {"x_m": 0.1 * iteration, "y_m": 0.0, "heading_rad": 0.0, "object_x_m": 2.0, "object_y_m": 0.0}
    done = {"action": {"turn": 0.0}, "before": now} if iteration else {"action": None, "before": None}
    plain: dict[str, Any] = {"episode": 0, "successes": 0, "event": "none", "reached": now, "now": now, **done}
    return messages.Scene(iteration=iteration, **(plain | more))


def run_folder(path: Path, *overrides: str) -> Path:
    """Make a run folder of the paper's experiment, as `mdb up` makes one."""
    path.mkdir(parents=True)
    Experiment.read(experiment_path("paper"), overrides).write(path / EXPERIMENT_FILE)
    return path


@contextmanager
def router(listen: str = "tcp/127.0.0.1:0") -> Iterator[Router]:
    """A router."""
    running = Router(ROUTER_CONFIG, listen)
    try:
        yield running
    finally:
        running.close()


class Played:
    """A brain whose robot and optimizer are played by a test."""

    def __init__(self, endpoint: str) -> None:
        self.bus = ZenohBus(BRAIN, endpoint)
        self.commands = self.bus.subscriber(keys.COMMAND)
        self.feedback = self.bus.subscriber(keys.FEEDBACK)
        self.controls = self.bus.subscriber(keys.CONTROL)
        self.audio = self.bus.subscriber(keys.AUDIO)
        self.scenes = self.bus.publisher(keys.SCENE)
        self.pictures = self.bus.publisher(keys.PICTURE)
        self.bus.token("optimizer", "action")
        self.bus.alive()

    def show(self, iteration: int) -> None:
        """Show a scene."""
        self.scenes.put(scene(iteration))

    def wait_for(self, inbox: Any, fits: Callable[[Any], bool] = lambda _: True) -> Any:
        """Return the next message of an inbox that fits."""
        deadline = time.monotonic() + BOUND_S
        while True:
            while (message := inbox.take()) is not None:
                if fits(message):
                    return message
            assert time.monotonic() < deadline, "no such message came"
            self.bus.wait(0.1)

    def wait_until(self, condition: Callable[[frozenset[str]], bool]) -> None:
        """Wait until those who are alive are as wanted."""
        deadline = time.monotonic() + BOUND_S
        while not condition(self.bus.alive()):
            assert time.monotonic() < deadline, str(self.bus.alive())
            self.bus.wait(0.1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.bus.close()


def options_of(endpoint: str | None, run: Path | None, **more: Any) -> WebOptions:
    """What a console is started with, at a free port."""
    return WebOptions(Place(endpoint, run), port=0, **more)
