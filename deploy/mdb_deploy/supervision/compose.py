"""The process table: `compose.yaml` read for processes on this machine.

Owns what of the Compose format the runner understands: command, depends_on, healthcheck (`deploy/health NAME`),
restart, environment, `${NAME:-default}`. Starts nothing.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from mdb_deploy.shipped import shipped
from mdb_protocol.errors import ConfigError
from mdb_sim.runs.experiment import Experiment

COMPOSE_FILE = shipped("compose.yaml")
VARIABLE = re.compile(r"\$\{(\w+)(?::-([^}]*))?\}")
ROUTER = "router"
TEACHER = "teacher"
EAR = "ear"
OPTIMIZER = "optimizer"
WEB = "web"
ROBOT = "robot"


@dataclass(frozen=True)
class ProcessSpec:
    """One process: its command (variables not filled in yet), whom it waits for, who it is when it is alive."""

    name: str
    command: tuple[str, ...]
    after: tuple[str, ...]
    token: str
    environment: Mapping[str, str]
    restarts: bool
    awaits: tuple[str, ...] = ()
    """Roles: not started before somebody of each is alive."""
    given: tuple[int, ...] = ()
    """Descriptors that it gets from the runner."""
    needed: bool = True
    """Whether the run ends when it cannot be kept alive, and begins only with it."""

    def argv(self, variables: Mapping[str, str]) -> list[str]:
        """Return the command with its variables filled in; a word that is empty then is left out."""
        return [filled for word in self.command if (filled := fill(word, variables))]


def fill(word: str, variables: Mapping[str, str]) -> str:
    """Replace `${NAME}` and `${NAME:-default}`; ConfigError when a name has neither value nor default."""

    def value(found: re.Match[str]) -> str:
        name, default = found.group(1), found.group(2)
        if name in variables:
            return variables[name]
        if default is None:
            raise ConfigError(f"${{{name}}} in {word!r} has no value and no default")
        return default

    return VARIABLE.sub(value, word)


def read(path: Path = COMPOSE_FILE) -> dict[str, ProcessSpec]:
    """Return the processes of a compose file in an order that respects depends_on.

    Raises ConfigError when the file cannot be read or a service lacks what the runner needs.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        services: dict[str, Any] = content["services"]
    except (OSError, yaml.YAMLError, KeyError, TypeError) as error:
        raise ConfigError(f"{path} is not a usable compose file: {error}") from error
    specs = {name: _spec(path, name, row) for name, row in services.items() if not row.get("x-mdb-skip")}
    return in_order({name: replace(s, after=tuple(a for a in s.after if a in specs)) for name, s in specs.items()})


def _spec(path: Path, name: str, row: Mapping[str, Any]) -> ProcessSpec:
    command = row.get("command")
    if not isinstance(command, list) or not command:
        raise ConfigError(f"{path}: service {name} needs a command as a list of words")
    test = (row.get("healthcheck") or {}).get("test") or []
    if len(test) < 3 or test[1] != "deploy/health":
        raise ConfigError(f"{path}: service {name} needs healthcheck.test [CMD, deploy/health, ROLE/INSTANCE]")
    return ProcessSpec(
        name=name,
        command=tuple(str(word) for word in command),
        after=tuple(row.get("depends_on") or ()),
        token=str(test[2]),
        environment={str(k): str(v) for k, v in (row.get("environment") or {}).items()},
        restarts=row.get("restart", "no") != "no",
        needed=bool(row.get("x-mdb-needed", True)),
    )


def in_order(specs: Mapping[str, ProcessSpec]) -> dict[str, ProcessSpec]:
    """Return the processes so that each comes after those it waits for; ConfigError on a circle."""
    ordered: dict[str, ProcessSpec] = {}
    while len(ordered) < len(specs):
        ready = [s for s in specs.values() if s.name not in ordered and all(a in ordered for a in s.after)]
        if not ready:
            left = sorted(set(specs) - set(ordered))
            raise ConfigError(f"depends_on of {', '.join(left)} goes in a circle or names no service")
        ordered |= {spec.name: spec for spec in ready}
    return ordered


def for_experiment(
    specs: Mapping[str, ProcessSpec], experiment: Experiment, *, web: bool = False
) -> dict[str, ProcessSpec]:
    """Return the processes an experiment needs: an evolver a model, a teacher and an ear only if the file has one.

    web: with the page.
    """
    evolvers = {s.command[s.command.index("--model") + 1]: s for s in specs.values() if "--model" in s.command}
    if not evolvers:
        raise ConfigError("the compose file has no evolver (a command with --model) to take as a pattern")
    pattern = next(iter(evolvers.values()))
    chosen = {s.name: s for s in specs.values() if "--model" not in s.command}
    if experiment.teacher is None:
        chosen.pop(TEACHER, None)
    if experiment.brain.ear is None:
        chosen.pop(EAR, None)
    if not web:
        chosen.pop(WEB, None)
    names = [model.name for model in experiment.brain.model]
    for name in names:
        spec = evolvers.get(name) or _for_model(pattern, name)
        chosen[spec.name] = spec
    gone = set(specs) - set(chosen)
    added = {s.name for s in chosen.values() if "--model" in s.command or s.name == EAR}
    waits_for_evolvers = {s.name for s in specs.values() if any("evolver" in a for a in s.after)}
    result = {}
    for spec in chosen.values():
        after = [a for a in spec.after if a not in gone]
        if spec.name in waits_for_evolvers:
            after = sorted({*after, *added})
        result[spec.name] = replace(spec, after=tuple(after))
    return in_order(result)


def elsewhere(specs: Mapping[str, ProcessSpec], *names: str) -> dict[str, ProcessSpec]:
    """Return the processes without those that somebody else runs."""
    return {
        name: replace(spec, after=tuple(after for after in spec.after if after not in names))
        for name, spec in specs.items()
        if name not in names
    }


def _for_model(pattern: ProcessSpec, model: str) -> ProcessSpec:
    words = list(pattern.command)
    words[words.index("--model") + 1] = model
    return replace(pattern, name=f"evolver-{model}", command=tuple(words), token=f"evolver/{model}")
