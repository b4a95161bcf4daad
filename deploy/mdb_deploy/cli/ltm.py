"""`mdb ltm`: what the long-term memory of a run holds."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mdb_deploy.cli.options import Commands


def add(commands: Commands) -> None:
    """Add `ltm` and its verbs."""
    ltm = commands.add_parser(
        "ltm",
        help="the long-term memory: list, show, export, import",
        description="Models that were good and stable, each with a sample of its context. SOURCE: a run folder or "
        "a file that 'export' wrote. MODEL: a model's name, for all stored under it, or NAME/ID.",
    )
    verbs = ltm.add_subparsers(required=True, metavar="VERB")
    listing = verbs.add_parser("list", help="one line a model")
    show = verbs.add_parser("show", help="all that is known of a model")
    export = verbs.add_parser("export", help="write models to a file")
    bring = verbs.add_parser("import", help="put models into a run that has not begun, or is stopped")
    for verb in (listing, show, export, bring):
        verb.add_argument("source", type=Path, metavar="SOURCE")
    bring.add_argument("run", type=Path, metavar="RUN", help="run folder ('mdb prepare --run RUN' makes one)")
    for verb in (listing, show, export, bring):
        verb.add_argument("models", nargs="*", metavar="MODEL", help="which models (all)")
    export.add_argument("--out", type=Path, required=True, metavar="FILE", help="the file to write")
    listing.set_defaults(command=_ltm_list)
    show.set_defaults(command=_ltm_show)
    export.set_defaults(command=_ltm_export)
    bring.set_defaults(command=_ltm_import)


def _ltm_list(arguments: argparse.Namespace) -> int:
    from mdb_deploy.runs import ltm

    sys.stdout.write(ltm.listing(ltm.read(arguments.source, arguments.models)) + "\n")
    return 0


def _ltm_show(arguments: argparse.Namespace) -> int:
    from mdb_deploy.runs import ltm

    sys.stdout.write("\n\n".join(map(ltm.show, ltm.read(arguments.source, arguments.models))) + "\n")
    return 0


def _ltm_export(arguments: argparse.Namespace) -> int:
    from mdb_deploy.runs import ltm

    count = ltm.export(arguments.source, arguments.models, arguments.out)
    sys.stdout.write(f"{count} models: {arguments.out}\n")
    return 0


def _ltm_import(arguments: argparse.Namespace) -> int:
    from mdb_deploy.runs import ltm

    count = ltm.bring(arguments.source, arguments.models, arguments.run)
    sys.stdout.write(f"{count} models: {arguments.run}\n")
    return 0
