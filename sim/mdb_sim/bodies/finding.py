"""How a body is found by its name: one rule for every way in which a process starts.

A name is a short one of ours or `package.module:Factory`. A module is looked for among what is installed first, and
then beside the experiment file, so that no file there can take the place of a module of the project's.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from mdb_sim.body import Body, BodyError, Spec

BODIES = {
    "kinematic": "mdb_sim.bodies.pioneer.twin:KinematicRobot",
    "pybullet": "mdb_sim.bodies.pioneer.physics:PioneerRobot",
    "gymnasium": "mdb_sim.bodies.environment:GymnasiumBody",
    "ros2": "mdb_sim.bodies.ros2.robot:Ros2Robot",
    "iiwa": "mdb_sim.bodies.bullet.arm:IiwaArm",
    "racecar": "mdb_sim.bodies.bullet.car:RaceCar",
}
"""The bodies that have a short name."""
EXTRAS = {"pybullet": "pybullet", "gymnasium": "gymnasium", "rosbags": "ros2", "xxhash": "ros2"}
"""The extra that installs a package that a body needs, by the package's name."""
INSTEAD = {"pybullet": ", or use body='kinematic', its twin"}
"""What else would do, for want of a package."""
_BESIDE: list[Path] = []
"""The folders of experiment files in which modules were looked for."""
MEMBERS = ("spec", "reset", "act", "halt", "scene", "state", "restore", "close")


def make_body(name: str, options: Mapping[str, Any], folder: Path | None = None, *, gui: bool = False) -> Body:
    """Make a body with the options of `[robot.options]`; `gui` asks for a window.

    BodyError when there is none of that name, when a package it needs is missing, when the options are wrong, or when
    what the factory gives does not keep the contract.
    """
    factory = find(name, folder, "body", BODIES)
    if gui:
        check_window(name, folder)
    try:
        body = factory(**options, gui=True) if gui else factory(**options)
    except TypeError as error:
        raise BodyError(f"body={name!r}: its factory does not take the options {dict(options)}: {error}") from error
    check_members(body, MEMBERS, f"body={name!r}", "mdb_sim.body.Body")
    made: Body = body
    return made


def get_ready(name: str, folder: Path | None = None) -> None:
    """Let one of our bodies do what is to be done before the process has threads: its class's `get_ready`, if any."""
    if name in BODIES:
        with suppress(BodyError):  # which is told when the body is made
            getattr(find(name, folder, "body", BODIES), "get_ready", lambda: None)()


def check_window(name: str, folder: Path | None = None) -> None:
    """Raise BodyError when a body has no window: its class says `has_window = True` if it has."""
    if not getattr(find(name, folder, "body", BODIES), "has_window", False):
        raise BodyError(f"body={name!r} has no window; leave --gui out")


def is_simulated(name: str, folder: Path | None = None) -> bool:
    """Whether another body of this name may be made and moved: its class says `simulated = True`, so nothing real is.

    BodyError when there is none of that name, or when a package it needs is missing.
    """
    return bool(getattr(find(name, folder, "body", BODIES), "simulated", False))


def spec_of(name: str, options: Mapping[str, Any], folder: Path | None = None) -> Spec:
    """Return what a body has: by its factory's `spec_of`, or else by making and closing one."""
    factory = find(name, folder, "body", BODIES)
    if hasattr(factory, "spec_of"):
        found: Spec = factory.spec_of(**options)
        return found
    body = make_body(name, options, folder)
    try:
        return body.spec
    finally:
        body.close()


def check_members(made: object, members: Sequence[str], what: str, contract: str) -> None:
    """Raise BodyError when something that a factory made lacks members of its contract."""
    missing = [member for member in members if not hasattr(made, member)]
    if missing:
        raise BodyError(
            f"{what} gave a {type(made).__name__} without {', '.join(missing)}; expected the members of {contract}; "
            "add them to that class"
        )


def find(name: str, folder: Path | None, what: str, known: Mapping[str, str]) -> Callable[..., Any]:
    """Import what a name stands for; BodyError tells what was expected."""
    module_name, colon, attribute = known.get(name, name).partition(":")
    if not (colon and module_name and attribute):
        raise BodyError(
            f"no {what} named {name!r}; expected {', '.join(map(repr, known))} or 'package.module:Factory'"
        )
    if folder is not None:
        _look_beside(folder.resolve(), module_name)
        importlib.invalidate_caches()  # what was written there since this process began is found, too
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        raise BodyError(_missing_module(what, name, module_name, error)) from error
    except Exception as error:
        raise BodyError(
            f"{what}={name!r}: importing {module_name} failed: {type(error).__name__}: {error}; correct that module"
        ) from error
    factory = getattr(module, attribute, None)
    if not callable(factory):
        raise BodyError(
            f"{what}={name!r}: {module_name} has no callable {attribute!r}; correct the name after the colon"
        )
    found: Callable[..., Any] = factory
    return found


def _look_beside(folder: Path, module_name: str) -> None:
    """Let modules be found in a folder, after all others; BodyError when another folder's is loaded in its place."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
        _BESIDE.append(folder)
    loaded = getattr(sys.modules.get(module_name.partition(".")[0]), "__file__", None)
    where = Path(loaded).parent if loaded else folder
    there = folder / f"{module_name.partition('.')[0]}.py"
    if there.exists() and where != folder and where in _BESIDE:
        raise BodyError(
            f"{module_name} is loaded from {where} already, and there is another in {folder}; rename one of them"
        )


def _missing_module(what: str, name: str, module_name: str, error: ModuleNotFoundError) -> str:
    if error.name in EXTRAS:
        return (
            f"{what}={name!r} needs the package {error.name}, which is not installed; run"
            f" `pip install 'multilevel-darwinist-brain[{EXTRAS[error.name]}]'`{INSTEAD.get(name, '')}"
        )
    return (
        f"{what}={name!r}: importing {module_name} failed: {error}; install it, put it beside the experiment "
        "file, or correct the name"
    )
