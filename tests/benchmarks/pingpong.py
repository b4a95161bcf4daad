"""Two bare Zenoh processes over a router: how long it takes there and back, with nothing of ours in it.

`python pingpong.py pong ROUTER` answers; `python pingpong.py ping ROUTER EVERY_S` asks for as long as its input is
open, then prints its times in seconds as JSON. `Bare` starts both.
"""

import json
import os
import queue
import subprocess
import sys
import time
from types import TracebackType
from typing import Self

import zenoh
from zenoh.handlers import Callback

THERE, BACK = "pingpong/there", "pingpong/back"
PERCEPTION, ACTION = bytes(350), bytes(250)
"""As large as those of the paper's experiment."""


def joined(router: str) -> zenoh.Session:
    config = {"mode": "client", "connect": {"endpoints": [router]}, "scouting": {"multicast": {"enabled": False}}}
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def pong(router: str) -> None:
    came: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    with joined(router) as session:
        back = session.declare_publisher(BACK)
        hears = session.declare_subscriber(THERE, Callback(came.put, indirect=False))
        os.write(1, b"ready\n")
        while hears:
            came.get().payload.to_bytes()
            back.put(ACTION)


def ping(router: str, every_s: float) -> None:
    came: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    times: list[float] = []
    os.set_blocking(sys.stdin.fileno(), False)
    with joined(router) as session:
        there = session.declare_publisher(THERE)
        hears = session.declare_subscriber(BACK, Callback(came.put, indirect=False))
        time.sleep(0.5)
        os.write(1, b"ready\n")
        while hears and sys.stdin.buffer.read() is None:
            began_s = time.perf_counter()
            there.put(PERCEPTION)
            came.get(timeout=5.0).payload.to_bytes()
            times.append(time.perf_counter() - began_s)
            time.sleep(every_s)
    sys.stdout.write(json.dumps(times))


class Bare:
    """Both processes at work; leaves none behind."""

    def __init__(self, router: str, every_s: float) -> None:
        self._pong = self._start("pong", router)
        self._ping = self._start("ping", router, str(every_s))

    @staticmethod
    def _start(*words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, __file__, *words]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        return process

    def times(self) -> list[float]:
        """End, and return how long each took, in seconds."""
        said, _ = self._ping.communicate(timeout=10.0)
        return list(json.loads(said))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        for process in (self._ping, self._pong):
            process.kill()
            process.communicate()


if __name__ == "__main__":
    what, *words = sys.argv[1:]
    pong(*words) if what == "pong" else ping(words[0], float(words[1]))
