"""A new folder with an experiment: which kinds there are, and what is written for each."""

from __future__ import annotations

import re
from pathlib import Path

from mdb_deploy.experiments import EXPERIMENTS
from mdb_protocol.errors import MdbError
from mdb_protocol.words import close_to
from mdb_services.experiment.run_folder import EXPERIMENT_FILE

TEMPLATES = Path(__file__).parent / "templates"
GYMNASIUM = "gymnasium"
TEMPLATE_KINDS = ("arm", "wheeled", "wire")
ROS2 = "ros2"
WIRE, WHEELED = "wire", "wheeled"
NAME = "NAME"
"""Stands in a template's text, and in its files' names, for the experiment's name as Python writes it."""

Files = dict[str, str]
"""Texts by the names of their files."""


def begin(folder: Path, like: str) -> list[Path]:
    """Write the files of an experiment into a new or empty folder; return their paths, the experiment first.

    like: "gymnasium:ENV", or a kind of `TEMPLATE_KINDS`. MdbError when it is none, or when files are there already.
    """
    name = re.sub(r"[^A-Za-z0-9_-]", "-", folder.resolve().name)[:64] or "robot"
    module = re.sub(r"\W", "_", name.lower())
    module = module if module[:1].isalpha() else f"robot_{module}"
    kind, _, which = like.partition(":")
    if kind == GYMNASIUM and which:
        files = _environment(which, name, module, folder)
    elif kind in TEMPLATE_KINDS and not which:
        files = _wire(name, module) if kind == WIRE else _template(kind, name, module)
    elif like == ROS2:
        files = _ros2(name)
    else:
        kinds = ", ".join((f"{GYMNASIUM}:ENV (as {GYMNASIUM}:CartPole-v1)", *TEMPLATE_KINDS, ROS2))
        near = close_to(kind, (GYMNASIUM, *TEMPLATE_KINDS, ROS2))
        meant = f"; did you mean {near}{like[len(kind) :]}?" if near else ""
        raise MdbError(f"--like {like!r} is no kind of robot; expected one of {kinds}{meant}")
    there = [file for file in files if (folder / file).exists()]
    if there:
        raise MdbError(f"{folder} has {', '.join(there)} already; give another folder, or move them away")
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in files.items():
        (folder / file).write_text(text, encoding="utf-8")
    return [folder / file for file in files]


def _environment(env: str, name: str, module: str, folder: Path) -> Files:
    from mdb_deploy.begin import writing
    from mdb_deploy.begin.looking import look

    machine = look(env, folder)
    file = f"{module}_teacher"
    return {
        EXPERIMENT_FILE: writing.experiment(machine, name, f"{file}:Teacher"),
        f"{file}.py": writing.teacher(machine),
    }


def _wire(name: str, module: str) -> Files:
    """Return the wheeled robot, in a process of its own."""
    files = _template(WHEELED, name, module) | _template(WIRE, name, module)
    whole, wire = "The whole: mdb up FOLDER.", f"Its own process: mdb up FOLDER --no-robot, python {module}_robot.py."
    return files | {EXPERIMENT_FILE: files[EXPERIMENT_FILE].replace(whole, wire)}


def _ros2(name: str) -> Files:
    """Return the shipped experiment of a ROS 2 robot, under another name."""
    path = EXPERIMENTS / f"{ROS2}.toml"
    return {
        EXPERIMENT_FILE: re.sub(rf'^(name|brain) = "{ROS2}"$', rf'\1 = "{name}"', path.read_text("utf-8"), flags=re.M)
    }


def _template(kind: str, name: str, module: str) -> Files:
    found = sorted((TEMPLATES / kind).iterdir(), key=lambda path: path.name != EXPERIMENT_FILE)
    texts = {path.name: path.read_text(encoding="utf-8") for path in found if path.is_file()}
    return {
        file.replace(NAME, module): text.replace(f'"{NAME}"', f'"{name}"').replace(NAME, module)
        for file, text in texts.items()
    }
