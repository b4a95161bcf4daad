"""`mdb web`: the console, a page from which a brain that runs is watched and taught, and past runs are looked at."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from mdb_deploy.cli.options import Commands, add_keys
from mdb_deploy.experiments import experiment_path
from mdb_protocol.endpoints import USUAL
from mdb_protocol.errors import MdbError

if TYPE_CHECKING:
    from mdb_deploy.web.guard import Guard

EPILOG = """\
  mdb up --web                        a brain with its page; this is all that most people need
  mdb web                             a page for the brain that runs on this machine, and for past runs
  mdb web --run runs/NAME             for the brain of this run folder
  mdb web --listen 0.0.0.0:8787 --keys keys    for other machines too: by HTTPS, with a link for each role
"""


def add(commands: Commands) -> None:
    """Add `web`."""
    web = commands.add_parser(
        "web",
        help="a page in the browser: watch a brain, teach it, look at past runs",
        description="Serves the page until Ctrl-C. Needs the extra 'web'.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    web.add_argument("--connect", metavar="ENDPOINT", help=f"the router ({USUAL}, with keys tls/)")
    web.add_argument("--brain", help="the brain's name (the one that is there)")
    web.add_argument("--run", type=Path, metavar="FOLDER", help="the brain's run folder (found, if it runs here)")
    web.add_argument("--experiment", type=experiment_path, metavar="FILE", help="what a brain elsewhere does")
    web.add_argument("--runs", type=Path, default=Path("runs"), help="where past runs are (runs)")
    web.add_argument("--listen", metavar="HOST:PORT", help="where the page is (127.0.0.1:8787, or the next port)")
    add_keys(web)
    web.set_defaults(command=_web, extra="web")


def _web(arguments: argparse.Namespace) -> int:
    from mdb_deploy.web.opening import Place, WebOptions
    from mdb_deploy.web.serve import serve
    from mdb_services.shell.heartbeat import CLOSE_S, Heart
    from mdb_services.shell.service import Stopper

    host, port = address_of(arguments.listen)
    usual = USUAL if arguments.keys is None else USUAL.replace("tcp/", "tls/")
    connect = arguments.connect or (None if arguments.run is not None else usual)
    run = arguments.run.resolve() if arguments.run is not None else None
    place = Place(connect, run, arguments.experiment, arguments.brain, arguments.keys)
    options = WebOptions(place, host, port, arguments.runs.resolve(), f"page-{os.getpid()}")
    stop = Stopper(bound_s=CLOSE_S)
    stop.install()
    serve(options, stop, Heart(), _say)
    return 0


def _say(guard: Guard) -> None:
    sys.stdout.writelines(f"{line}\n" for line in guard.lines())
    sys.stdout.flush()


def address_of(listen: str | None) -> tuple[str, int | None]:
    """Return host and port of words as 127.0.0.1:8787; MdbError when they are none. None: the usual ones."""
    if not listen:
        return "127.0.0.1", None
    host, colon, port = listen.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not (colon and host and port.isdecimal() and int(port) < 2**16):
        raise MdbError(f"{listen!r} is no place for the page; expected HOST:PORT as in 127.0.0.1:8787")
    return host, int(port)
