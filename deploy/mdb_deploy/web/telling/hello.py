"""What never changes of a run: the frame `hello`."""

from __future__ import annotations

from itertools import takewhile
from typing import Any

from mdb_deploy.experiments import EXPERIMENTS, SUFFIX
from mdb_deploy.web.telling.plan import Plan
from mdb_protocol.errors import MdbError
from mdb_services.experiment.brain import BrainConfig
from mdb_sim.bodies.finding import BODIES, find, is_simulated, spec_of
from mdb_sim.runs.experiment import Experiment

LOWEST_HZ = 261.63
"""Of the scale of an experiment without an ear: C4."""
MAJOR = (0, 2, 4, 5, 7, 9, 11)
"""Semitones of the notes of a major scale."""


def hello(
    experiment: Experiment, run: str, *, live: bool = False, teach: bool = False, operate: bool = False
) -> dict[str, Any]:
    """Return the frame `hello`. `run`: its folder's name; teach, operate: what this visitor may do."""
    plan, brain = Plan(experiment), experiment.brain
    phases = () if plan.schedule is None else plan.schedule.phases
    return {
        "is": "hello",
        "brain": brain.experiment.brain,
        "run": run,
        "live": live,
        "experiment": {
            "name": brain.experiment.name,
            "iterations": brain.experiment.iterations,
            "pace": brain.experiment.pace,
            "seed": brain.experiment.seed,
            "words": words_of(brain.experiment.name),
        },
        "rights": {"teach": teach, "operate": operate},
        "choices": [{"name": choice.name, "values": choice.values} for choice in brain.choice],
        "actuators": {
            name: {"low": section.low, "high": section.high, "unit": section.unit}
            for name, section in brain.actuators.items()
        },
        "commands": [] if plan.policy is None else list(plan.policy.commands),
        "order": [] if plan.policy is None else list(plan.policy.order),
        "notes": plan.notes,
        "scale_hz": scale_hz(brain, plan.notes),
        "ear": brain.ear is not None,
        "models": [
            {
                "name": model.name,
                "role": model.role,
                "inputs": list(model.inputs),
                "outputs": list(model.outputs),
                "hidden": list(model.hidden),
                "capacity": model.capacity,
                "members": model.members,
                "learner": brain.learner_of(model)[0],
            }
            for model in brain.model
        ],
        "modes": [{"name": mode.name, "world": mode.world, "satisfaction": mode.satisfaction} for mode in brain.mode],
        "phases": [{"start": phase.start, "name": phase.name, "teacher": phase.teacher} for phase in phases],
        "languages": {teacher: list(language.notes) for teacher, language in plan.languages.items()},
        "successes": list(experiment.robot.successes),
        "changes": changes_of(experiment),
        "patience_s": [brain.optimizer.command_patience_s, brain.optimizer.feedback_patience_s],
        "action_s": 0.0 if brain.lockstep else experiment.robot.action_s,
    }


def words_of(name: str) -> str:
    """Return the first sentence of what a shipped experiment file says of itself; "" when none is shipped."""
    try:
        text = (EXPERIMENTS / f"{name}{SUFFIX}").read_text(encoding="utf-8")
    except OSError:
        return ""
    lines = takewhile(lambda line: line.startswith("# "), text.splitlines())
    first, stop, _ = " ".join(line[2:].strip() for line in lines).partition(". ")
    return f"{first}." if stop else first


def scale_hz(brain: BrainConfig, notes: int) -> list[float]:
    """Return the pitch of each note (notes,): the ear's, or else a major scale from C4."""
    if brain.ear is not None and len(brain.ear.notes_hz) == notes:
        return list(brain.ear.notes_hz)
    semitones = [12 * (note // len(MAJOR)) + MAJOR[note % len(MAJOR)] for note in range(notes)]
    return [round(LOWEST_HZ * 2 ** (semitone / 12), 2) for semitone in semitones]


def changes_of(experiment: Experiment) -> list[str]:
    """Return what of the body can be changed while it runs. A real machine is not touched to ask it."""
    robot, folder = experiment.robot, experiment.folder
    try:
        if hasattr(find(robot.body, folder, "body", BODIES), "spec_of") or is_simulated(robot.body, folder):
            return list(spec_of(robot.body, robot.options, folder).changes)
    except (MdbError, ValueError, TypeError, ImportError, OSError):  # it is not installed here
        pass
    return []
