"""Options that several commands share."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

from mdb_deploy.experiments import DEFAULT, default_experiment

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
KEYS_HELP = "your bundle of 'mdb keys', or on the brain's machine the key folder; for a router at tls/ or quic/"
OPEN_HELP = "listen beyond this machine without keys: everyone there may read all and command the robot"


def keys_path(text: str) -> Path | None:
    """Return the path that is named; None for an empty word."""
    return Path(text).resolve() if text else None  # compose.yaml gives an empty word for none


def number(least: float, most: float = math.inf, kind: type[int] | type[float] = int) -> Callable[[str], float]:
    """Return how a number is read that has bounds."""

    def read(text: str) -> float:
        try:
            found = kind(text)
        except ValueError:
            found = kind(least) - 1
        if not least <= found <= most or not math.isfinite(found):
            bounds = f"from {least:g} on" if math.isinf(most) else f"from {least:g} to {most:g}"
            raise argparse.ArgumentTypeError(f"{text!r}: expected a {'whole ' if kind is int else ''}number {bounds}")
        return found

    return read


def add_keys(parser: argparse.ArgumentParser) -> None:
    """Add `--keys`."""
    parser.add_argument("--keys", type=keys_path, metavar="PATH", help=KEYS_HELP)


def add_experiment(parser: argparse.ArgumentParser, default: str = DEFAULT) -> None:
    """Add the experiment file and what changes it. `default`: the shipped one that is meant when none is named."""
    parser.add_argument(
        "experiment",
        nargs="?",
        default=default_experiment(default),
        help=f"experiment file, its folder, or the name of a shipped one; else the one in this folder, or {default}",
    )
    parser.add_argument("--pace", choices=["concurrent", "lockstep"], help="override the file's pace")
    parser.add_argument("--seed", type=number(0), help="override the file's seed")
    parser.add_argument(
        "--iterations",
        type=lambda text: number(1)(text) if text else None,
        help="override the file's number of iterations",
    )  # compose.yaml gives an empty word for none
    parser.add_argument(
        "--without-pybullet", action="store_true", help="where the file says pybullet, use its kinematic twin"
    )
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="override any setting")


def content_of(path: Path, arguments: argparse.Namespace, *more: str) -> dict[str, Any]:
    """Return the content of an experiment file, with what the command line changes."""
    from mdb_services.experiment.reading import read_file
    from mdb_sim.runs.experiment import placed

    content = placed(read_file(path, [*overrides_of(arguments), *more]), path)
    robot = content.setdefault("robot", {})
    if arguments.without_pybullet and isinstance(robot, dict) and robot.get("body", "pybullet") == "pybullet":
        robot["body"] = "kinematic"
    return content


def overrides_of(arguments: argparse.Namespace) -> list[str]:
    """Return the options that stand for settings as overrides, the explicit ones last."""
    named = {"pace": arguments.pace, "seed": arguments.seed, "iterations": arguments.iterations}
    given = [f"experiment.{name}={value}" for name, value in named.items() if value is not None]
    return given + list(arguments.set)
