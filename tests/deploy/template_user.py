"""A process with a template, as `mdb up` is one: `python -m tests.deploy.template_user WHAT FOLDER`.

A process of its own, for a template is made before there are threads, and a test has some.
"""

import asyncio
import os
import resource
import signal
import sys
import time
from pathlib import Path

from mdb_deploy.cli.main import main as mdb
from mdb_deploy.supervision import template as module
from mdb_deploy.supervision.template import Forked, Template, TemplateGoneError

BOUND_S = 60.0
HELD = 4
"""A number under which the template holds its end of the channel."""
GIVEN: list[int] = []
"""A pipe that whoever started us has left open."""
ROUTER = ("run", "router", "--listen", "tcp/127.0.0.1:0")


async def fork(template: Template, log: Path, *words: str, given: tuple[int, ...] = ()) -> Forked:
    """Start `mdb` with these words."""
    with log.open("ab") as output:
        return await template.fork(words, os.environ, (output.fileno(), *given))


async def ended(process: Forked) -> int:
    """Return how it ended."""
    return await asyncio.wait_for(process.wait(), BOUND_S)


async def until(condition: object) -> None:
    """Wait until a function gives true."""
    deadline = time.monotonic() + BOUND_S
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < deadline
        await asyncio.sleep(0.01)


async def speaks(template: Template, folder: Path) -> None:
    """What it says is in its log, and its status is that of the command."""
    log = folder / "log"
    assert await ended(await fork(template, log, "--version")) == 0
    assert log.read_text().startswith("mdb ")
    assert await ended(await fork(template, log, "sing")) == 2
    assert "sing" in log.read_text()


async def serves(template: Template, folder: Path) -> None:
    """It is a service like any: ready, known by its words, our child, stopped by SIGTERM, killed by SIGKILL."""
    log = folder / "log"
    process = await fork(template, log, *ROUTER)
    await until(lambda: "listen" in log.read_text())
    words = Path(f"/proc/{process.pid}/cmdline").read_text(encoding="utf-8").replace("\0", " ")
    assert words.startswith("mdb run router"), words
    parent = int(Path(f"/proc/{process.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[1])
    assert parent == os.getpid()
    assert os.getsid(process.pid) == process.pid
    process.send_signal(signal.SIGTERM)
    assert await ended(process) == 0, log.read_text()
    process = await fork(template, log, *ROUTER)
    process.send_signal(signal.SIGKILL)
    assert await ended(process) == -signal.SIGKILL


async def gives(template: Template, folder: Path) -> None:
    """A descriptor is the same number there, even one that the template has for something else."""
    reading, writing = os.pipe()
    number = os.dup2(writing, HELD)
    os.close(writing)
    process = await fork(template, folder / "log", *ROUTER, given=(number,))
    os.close(number)
    pipe, place = os.readlink(f"/proc/self/fd/{reading}"), Path(f"/proc/{process.pid}/fd/{number}")
    await until(lambda: place.is_symlink() and os.readlink(place) == pipe)  # it is told of before that
    process.send_signal(signal.SIGKILL)
    await ended(process)
    assert os.read(reading, 1) == b"", "somebody else has it, too"


async def stays_alone(template: Template, folder: Path) -> None:
    """It has one thread when all is loaded, and no descriptors of others."""
    await until(lambda: "template" in Path(f"/proc/{template.pid}/cmdline").read_text(encoding="utf-8"))
    for _ in range(3):
        await ended(await fork(template, folder / "log", "--version"))
        await asyncio.sleep(0.5)
    assert len(os.listdir(f"/proc/{template.pid}/task")) == 1
    held = {
        int(name): os.readlink(f"/proc/{template.pid}/fd/{name}") for name in os.listdir(f"/proc/{template.pid}/fd")
    }
    assert held == {0: os.devnull, 1: os.devnull, 2: os.devnull, HELD: held[HELD]}, held


async def leaves(template: Template, folder: Path) -> None:
    """Neither it nor a service has what we were given by whoever started us."""
    process = await fork(template, folder / "log", *ROUTER)
    os.close(GIVEN[1])
    assert os.read(GIVEN[0], 1) == b""
    process.send_signal(signal.SIGKILL)
    await ended(process)


async def dies(template: Template, folder: Path) -> None:
    """Killed: who asks is told, and it is no child that nobody waits for."""
    os.kill(template.pid, signal.SIGKILL)
    await told(template, folder)


async def freezes(template: Template, folder: Path) -> None:
    """Stopped: who asks is told in time, and it is ended."""
    module.ANSWER_S = 0.3
    os.kill(template.pid, signal.SIGSTOP)
    await told(template, folder)


async def told(template: Template, folder: Path) -> None:
    """Who asks is told, again and again."""
    for _ in range(2):
        try:
            await fork(template, folder / "log", "--version")
        except TemplateGoneError:
            continue
        raise AssertionError("there is one")
    assert not Path(f"/proc/{template.pid}").exists()


async def is_late(template: Template, folder: Path) -> None:
    """Who comes when nobody waits any more is ended."""
    asking = asyncio.create_task(fork(template, folder / "log", *ROUTER))
    await asyncio.sleep(0)
    asking.cancel()
    await asyncio.wait({asking})
    assert asking.cancelled()
    try:
        while True:
            os.waitpid(-1, os.WNOHANG) == (0, 0) and await asyncio.sleep(0.01)
    except ChildProcessError:
        return


def main() -> None:
    """Do one of them."""
    what = sys.argv[1]
    if what == "leaves":
        GIVEN.extend(os.pipe())
        os.set_inheritable(GIVEN[1], True)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # as some who start us do
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
    template = Template.begin(mdb)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    assert template is not None
    assert what == "leaves" or os.open(os.devnull, os.O_RDONLY) == HELD
    try:
        asyncio.run(asyncio.wait_for(globals()[what](template, Path(sys.argv[2])), 2 * BOUND_S))
    finally:
        template.close()


if __name__ == "__main__":
    main()
