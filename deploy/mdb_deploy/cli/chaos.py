"""`mdb chaos`: what a brain survives."""

from __future__ import annotations

import argparse
from pathlib import Path

from mdb_deploy.cli.options import Commands, add_experiment, number, overrides_of
from mdb_deploy.experiments import experiment_path

CHAOS_EPILOG = """\
recovery: from the kill until the successor's liveliness token is there (after the router's: everybody's) and two
more iterations are done. A witness, a process outside the brain, writes down what is acknowledged; in the end all of
that must be in the memory, once, as it was. Status 1 when it is not, or recovery is far too slow.

  mdb chaos                                      300 kills, the paper's experiment over and over: some ten minutes
  mdb chaos --hangs 0.3                          a third are stopped for good: to be noticed, and replaced
  mdb chaos --kills 12 --roles memory,optimizer --set robot.body=kinematic
  mdb chaos --pace lockstep --iterations 500     to the experiment's end, however many kills fit in
  mdb chaos --soak 60                            no kills: full speed, and what each process holds
"""


def add(commands: Commands) -> None:
    """Add `chaos`."""
    chaos = commands.add_parser(
        "chaos",
        help="kill processes of a brain at random, and see that nothing is lost",
        description="Kills processes of a running brain at random, and measures what comes of it.",
        epilog=CHAOS_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add_experiment(chaos, "paper")
    chaos.add_argument("--kills", type=number(1), default=300, help="how many (300)")
    chaos.add_argument(
        "--hangs",
        type=number(0, 1, float),
        default=0.0,
        metavar="SHARE",
        help="share of them that hang instead, as 0.3 (0)",
    )
    chaos.add_argument("--roles", default="", help="who may die, as in memory,evolver-object (everybody)")
    chaos.add_argument(
        "--bound", type=number(0.1, kind=float), default=20.0, metavar="SECONDS", help="give up on a recovery (20)"
    )
    chaos.add_argument(
        "--pause", type=number(0, kind=float), default=1.0, metavar="SECONDS", help="to the next kill, at most (1)"
    )
    chaos.add_argument(
        "--soak", type=number(0.1, kind=float), metavar="MINUTES", help="watch memory, threads and files instead"
    )
    chaos.add_argument("--out", type=Path, default=Path("runs/chaos"), help="where run and report go (runs/chaos)")
    chaos.set_defaults(command=_chaos, goes_on=True)


def _chaos(arguments: argparse.Namespace) -> int:
    path, overrides, out = experiment_path(arguments.experiment), tuple(overrides_of(arguments)), arguments.out
    if arguments.soak is not None:
        from mdb_deploy.trials import soak

        return soak.command(soak.SoakOptions(path, overrides, out, arguments.soak))
    from mdb_deploy.trials import chaos

    return chaos.command(
        chaos.ChaosOptions(
            path,
            overrides,
            out,
            kills=arguments.kills,
            hangs=arguments.hangs,
            seed=arguments.seed or 0,
            roles=tuple(name for name in arguments.roles.split(",") if name),
            bound_s=arguments.bound,
            pause_s=arguments.pause,
            to_the_end=arguments.iterations is not None,
        )
    )
