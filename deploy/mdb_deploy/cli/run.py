"""`mdb run`, `prepare`, `follow` and `warm-up`: one service, what it needs before, and what is seen of the run."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from mdb_deploy.cli.options import OPEN_HELP, Commands, add_experiment, add_keys, content_of
from mdb_deploy.experiments import experiment_path
from mdb_protocol.endpoints import USUAL
from mdb_protocol.errors import MdbError

if TYPE_CHECKING:
    from mdb_services.shell.heartbeat import Heart
    from mdb_services.shell.service import Stopper


def add(commands: Commands) -> None:
    """Add `run`, `prepare`, `follow` and `warm-up`: what compose.yaml calls."""
    run = commands.add_parser("run", help="run one process of a brain ('mdb up' does this)", allow_abbrev=False)
    run.add_argument("service", help="router, recorder, memory, evolver, optimizer, robot, teacher, ear or web")
    run.add_argument("--run", type=Path, help="run folder with experiment.toml")
    run.add_argument("--connect", default=USUAL, help="the router's endpoint")
    run.add_argument("--listen", help="router: its endpoint; port 0: any free one. web: HOST:PORT of the page")
    add_keys(run)
    run.add_argument("--open-to-everyone", action="store_true", help=f"router and web: {OPEN_HELP}")
    run.add_argument("--model", help="evolver: the model it evolves")
    run.add_argument("--runs", type=Path, help="web: where past runs are")
    run.add_argument("--gui", action="store_true", help="robot: show the PyBullet window")
    run.add_argument("--with-parent", type=int, metavar="PID", help="stop when this, the parent process, is gone")
    run.add_argument(
        "--unattended",
        action="store_true",
        help="no 'mdb up' looks after it, as in a container: end it when it hangs, and once the run is finished",
    )
    run.add_argument("--until-finished", action="store_true", help="end once the run is finished")
    run.set_defaults(command=_run)
    prepare = commands.add_parser("prepare", help="write the resolved experiment into a run folder")
    add_experiment(prepare)
    prepare.add_argument("--run", type=Path, required=True, help="run folder, made if it is not there")
    prepare.add_argument("--settings", default="", metavar="NAME=VALUE;...", help="as --set, several in one word")
    prepare.set_defaults(command=_prepare)
    follow = commands.add_parser("follow", help="show a run to its end, then draw its figures", allow_abbrev=False)
    follow.add_argument("--run", type=Path, required=True, help="run folder with experiment.toml")
    follow.add_argument("--connect", default=USUAL, help="the router's endpoint")
    follow.add_argument("--known-as", metavar="FOLDER", help="what the run folder is called outside of the container")
    add_keys(follow)
    follow.set_defaults(command=_follow)
    warm_up = commands.add_parser("warm-up", help="compile what learns (the first 'mdb up' does it, too)")
    warm_up.set_defaults(command=_warm_up)


def _run(arguments: argparse.Namespace) -> int:
    from mdb_deploy.supervision.processes import (
        SERVICES,
        WEB,
        RouterOptions,
        ServiceOptions,
        run_router,
        run_service,
    )
    from mdb_deploy.supervision.unattended import run_unattended
    from mdb_services.experiment.reading import nearest
    from mdb_services.shell.heartbeat import CLOSE_S, START_S, Heart
    from mdb_services.shell.service import Stopper

    heart = Heart.inherited()
    if arguments.unattended and not heart.is_felt:
        return run_unattended(sys.argv[1:])
    heart.beat(START_S)
    stop = Stopper(arguments.with_parent, bound_s=CLOSE_S)
    stop.install()
    run, keys, until_finished = arguments.run, arguments.keys, arguments.until_finished
    if arguments.service == "router":
        run_router(
            RouterOptions(run, arguments.listen, keys, arguments.open_to_everyone, until_finished), stop, heart
        )
        return 0
    if arguments.service == WEB:
        return _run_web(arguments, stop, heart)
    if arguments.service not in SERVICES:
        raise MdbError(f"no service {arguments.service!r}{nearest(arguments.service, SERVICES)}")
    if run is None:
        raise MdbError(f"mdb run {arguments.service} needs --run FOLDER; 'mdb prepare --run FOLDER' makes one")
    options = ServiceOptions(run, arguments.connect, arguments.model, arguments.gui, keys, until_finished)
    run_service(arguments.service, options, stop, heart)
    return 0


def _run_web(arguments: argparse.Namespace, stop: Stopper, heart: Heart) -> int:
    """Serve the page of the brain in the run folder; where its router is, is in that folder if it is not said."""
    from mdb_deploy.cli.web import address_of
    from mdb_deploy.web.opening import Place, WebOptions
    from mdb_deploy.web.serve import serve

    if arguments.run is None:
        raise MdbError("mdb run web needs --run FOLDER; 'mdb web' finds the brain itself")
    host, port = address_of(arguments.listen)
    place = Place(arguments.connect or None, arguments.run, keys=arguments.keys)
    runs = arguments.runs or arguments.run.parent
    serve(
        WebOptions(place, host, port, runs, open_to_everyone=arguments.open_to_everyone),
        stop,
        heart,
    )
    return 0


def _prepare(arguments: argparse.Namespace) -> int:
    from mdb_deploy.supervision.unattended import FINISHED_FILE
    from mdb_services.experiment.run_folder import EXPERIMENT_FILE
    from mdb_sim.runs.experiment import Experiment

    path = experiment_path(arguments.experiment)
    arguments.set += [word.strip() for word in arguments.settings.split(";") if word.strip()]
    experiment = Experiment(content_of(path, arguments), path)
    experiment.check_machine()
    arguments.run.mkdir(parents=True, exist_ok=True)
    (arguments.run / FINISHED_FILE).unlink(missing_ok=True)
    experiment.write(arguments.run / EXPERIMENT_FILE)
    sys.stdout.write(f"{arguments.run / EXPERIMENT_FILE}\n")
    return 0


def _follow(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from mdb_deploy.cli.plot import draw
    from mdb_deploy.running.follow import follow
    from mdb_deploy.running.progress import Progress
    from mdb_deploy.running.watch import Watch
    from mdb_services.experiment.run_folder import EXPERIMENT_FILE
    from mdb_services.shell.service import Stopper
    from mdb_sim.runs.experiment import Experiment

    stop = Stopper()
    stop.install()
    console = Console(stderr=False)
    experiment = Experiment.read(arguments.run / EXPERIMENT_FILE)
    watch = Watch(experiment, arguments.run, arguments.keys)
    if not follow(watch, arguments.connect, Progress(console, experiment), stop):
        return 130
    console.print("drawing the figures")
    draw([arguments.run], None)
    console.print(f"results: {arguments.known_as or arguments.run.resolve()}", soft_wrap=True)
    return 0


def _warm_up(_: argparse.Namespace) -> int:
    from mdb_services.mechanism.evolution import native

    sys.stderr.write("compiling the evolvers' kernels once (about a quarter of a minute)\n")
    began_s = time.monotonic()
    native.load()
    sys.stderr.write(f"compiled in {time.monotonic() - began_s:.0f} s\n")
    return 0
