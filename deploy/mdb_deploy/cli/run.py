"""`mdb run`, `mdb prepare` and `mdb warm-up`: one service, and what it needs before."""

from __future__ import annotations

import argparse
from pathlib import Path

from mdb_deploy.cli.options import OPEN_HELP, Commands, add_experiment, add_keys, content_of
from mdb_deploy.experiments import experiment_path
from mdb_protocol.errors import MdbError
from mdb_protocol.zenoh_bus import DEFAULT_ENDPOINT


def add(commands: Commands) -> None:
    """Add `run`, `prepare` and `warm-up`: what compose.yaml calls."""
    run = commands.add_parser("run", help="run one service (compose does this)", allow_abbrev=False)
    run.add_argument("service", help="router, recorder, memory, evolver, optimizer, robot, teacher or ear")
    run.add_argument("--run", type=Path, help="run folder with experiment.toml")
    run.add_argument("--connect", default=DEFAULT_ENDPOINT, help="the router's endpoint")
    run.add_argument("--listen", help="router: its endpoint; port 0: any free one")
    add_keys(run)
    run.add_argument("--open-to-everyone", action="store_true", help=f"router: {OPEN_HELP}")
    run.add_argument("--model", help="evolver: the model it evolves")
    run.add_argument("--gui", action="store_true", help="robot: show the PyBullet window")
    run.add_argument("--with-parent", type=int, metavar="PID", help="stop when this, the parent process, is gone")
    run.set_defaults(command=_run)
    prepare = commands.add_parser("prepare", help="write the resolved experiment into a run folder")
    add_experiment(prepare)
    prepare.add_argument("--run", type=Path, required=True, help="run folder, made if it is not there")
    prepare.set_defaults(command=_prepare)
    warm_up = commands.add_parser("warm-up", help="compile the evolvers' kernels (the first start does it too)")
    warm_up.set_defaults(command=_warm_up)


def _run(arguments: argparse.Namespace) -> int:
    from mdb_deploy.running.processes import RouterOptions, ServiceOptions, run_router, run_service
    from mdb_services.shell.heartbeat import START_S, Heart
    from mdb_services.shell.service import Stopper

    heart = Heart.inherited()
    heart.beat(START_S)
    stop = Stopper(arguments.with_parent)
    stop.install()
    if arguments.service == "router":
        options = RouterOptions(arguments.run, arguments.listen, arguments.keys, arguments.open_to_everyone)
        run_router(options, stop, heart)
        return 0
    if arguments.run is None:
        raise MdbError(f"mdb run {arguments.service} needs --run FOLDER; 'mdb prepare --run FOLDER' makes one")
    service = ServiceOptions(arguments.run, arguments.connect, arguments.model, arguments.gui, arguments.keys)
    run_service(arguments.service, service, stop, heart)
    return 0


def _prepare(arguments: argparse.Namespace) -> int:
    from mdb_services.experiment.brain import EXPERIMENT_FILE
    from mdb_sim.runs.experiment import Experiment

    path = experiment_path(arguments.experiment)
    experiment = Experiment(content_of(path, arguments), path)
    experiment.check_machine()
    arguments.run.mkdir(parents=True, exist_ok=True)
    experiment.write(arguments.run / EXPERIMENT_FILE)
    return 0


def _warm_up(_: argparse.Namespace) -> int:
    from mdb_services.evolver import compile_kernels

    compile_kernels()
    return 0
