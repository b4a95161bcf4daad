"""`mdb status` and `mdb health`: who is alive."""

from __future__ import annotations

import argparse
from pathlib import Path

from mdb_deploy.cli.options import Commands, add_keys, number
from mdb_protocol.endpoints import USUAL


def add(commands: Commands) -> None:
    """Add `status` and `health`."""
    status = commands.add_parser("status", help="which processes live, and how each does")
    health = commands.add_parser("health", help="exit status 0 when ROLE/INSTANCE (or the router) is ready")
    health.add_argument("name", help="router, or ROLE/INSTANCE as in 'mdb status'")
    for parser in (status, health):
        parser.add_argument("--connect", default=USUAL, help="the router's endpoint")
        add_keys(parser)
    status.add_argument("--brain", help="the brain's name (all brains of the router)")
    health.add_argument("--brain", help="the brain's name (any brain of the router)")
    health.add_argument("--run", type=Path, help="its run folder, which tells the brain's name")
    status.add_argument("--json", action="store_true", help="one line of JSON a brain, for scripts")
    status.add_argument(
        "--watch",
        type=number(0.1, 86400, float),
        nargs="?",
        const=1.0,
        metavar="SECONDS",
        help="again and again (every second)",
    )
    status.set_defaults(command=_status)
    health.set_defaults(command=_health)


def _status(arguments: argparse.Namespace) -> int:
    from mdb_deploy.running.status import show_status

    return show_status(
        arguments.brain, arguments.connect, arguments.keys, as_json=arguments.json, every_s=arguments.watch
    )


def _health(arguments: argparse.Namespace) -> int:
    from mdb_protocol.zenoh_bus import ZenohBus
    from mdb_services.experiment.sections import DEFAULT_BRAIN

    brain = arguments.brain or _brain_of(arguments.run)

    def bus_of(name: str) -> ZenohBus:
        return ZenohBus(name, arguments.connect, credentials=arguments.keys, connect_timeout_s=1.0)

    bus = bus_of(brain or DEFAULT_BRAIN)
    with bus:
        if arguments.name == "router":
            return 0
        brains = [brain] if brain is not None else bus.brains()
    for name in brains:
        with bus_of(name) as one:
            if arguments.name in one.alive():
                return 0
    return 1


def _brain_of(run: Path | None) -> str | None:
    """Return the name of the brain of a run; None without one."""
    if run is None:
        return None
    from mdb_services.experiment.reading import read_file
    from mdb_services.experiment.run_folder import EXPERIMENT_FILE
    from mdb_services.experiment.sections import DEFAULT_BRAIN

    return str(read_file(run / EXPERIMENT_FILE)["experiment"].get("brain", DEFAULT_BRAIN))
