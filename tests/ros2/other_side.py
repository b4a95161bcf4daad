"""A router, and the robot of `peer` as a process on it, for tests."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mdb_protocol.zenoh_sessions import Router

ROOT = Path(__file__).parents[2]
BOUND_S = 30.0


class OtherRobot:
    """The process, asked by lines."""

    def __init__(self, connect: str, *options: str) -> None:
        self.connect = connect
        port = connect.rpartition(":")[2]
        command = [sys.executable, "-m", "tests.ros2.peer", "--port", port, *options]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, text=True)
        assert self._line() == {"ready": True}

    def _line(self) -> dict[str, Any]:
        """The next line; the process is killed when none comes in time, so that no test waits for ever."""
        assert self.process.stdout is not None
        watch = threading.Timer(BOUND_S, self.process.kill)
        watch.start()
        line = self.process.stdout.readline()
        watch.cancel()
        assert line, "the peer has ended, or did not answer within the bound"
        found: dict[str, Any] = json.loads(line)
        return found

    def ask(self, words: str = "say") -> dict[str, Any]:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{words}\n")
        self.process.stdin.flush()
        return self._line()

    def graph(self, topic: str, like: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """What it sees of a topic, once that is so; tokens take a moment through the router."""
        deadline = time.monotonic() + BOUND_S
        while not like(found := self.ask(f"graph {topic}")):
            assert time.monotonic() < deadline, f"the graph stays {found}"
        return found

    def freeze(self) -> None:
        self.process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        self.process.send_signal(signal.SIGCONT)

    def close(self) -> None:
        self.thaw()
        self.process.kill()
        self.process.wait(BOUND_S)


@contextmanager
def router(listen: str = "tcp/127.0.0.1:0") -> Iterator[str]:
    """A real router, on any free port at first; gives where it is."""
    serving = Router(ROOT / "deploy" / "router.json5", listen)
    try:
        yield serving.endpoint()
    finally:
        serving.close()


@contextmanager
def robot(*options: str) -> Iterator[OtherRobot]:
    """A router and the robot on it."""
    with router() as connect:
        other = OtherRobot(connect, *options)
        try:
            yield other
        finally:
            other.close()
