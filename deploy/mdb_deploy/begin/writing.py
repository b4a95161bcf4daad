"""The experiment file and the teacher of a Gymnasium environment: the templates, filled with what `looking` found."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from string import Template

from mdb_deploy.begin.looking import TERMINATED, TRUNCATED, Machine, Variable
from mdb_sim.bodies.environment import REWARD
from mdb_sim.body import Actuator, Numbers
from mdb_sim.robot.course import TIMEOUT

TEMPLATES = Path(__file__).parent / "templates" / "gymnasium"
NOTES = 128
"""Commands that notes can stand for, at most."""
WIDE = 64
"""Numbers into a model from which on gradients learn it sooner than evolution does."""
REACH, AT = 0.5, 5.0
"""How far a model is believed around what it knows, where so many numbers tell; distances grow with their root."""
LONGEST = 200
"""Actions in an episode of an environment that sets no bound itself."""
TOLD = 12
"""Numbers of a scene that the teacher's page lists."""
SMALL = "evolution = { generations = 10, elite = 5, step_min = 0.05, expressed_first = 0.75, error_penalty = 3e-3 }"
COMMITTEE = """\
members = 5                   # so many populations learn side by side, and the mean of their best counts
evolution = { population = 40, generations = 5, step_min = 0.02, mutation_rate = 0.5, weight_penalty = 1e-4 }"""


def experiment(machine: Machine, name: str, policy: str) -> str:
    """Return the text of an experiment file; policy: as `[teacher]` names it."""
    acts = ["action"] if machine.choices else [actuator.name for actuator in machine.actuators]
    heard, sensed = ["note", *acts], [*(variable.name for variable in machine.variables), *acts]
    return _filled(
        "experiment.toml.txt",
        env=machine.env,
        name=name,
        policy=policy,
        channels=_lines([*_left_out(machine), *(line for each in machine.variables for line in _channel(each))]),
        notes=len(commands(machine)),
        acted=_lines(_acted(machine)),
        actions=_lines(_choices(machine) if machine.choices else _ranges(machine.actuators)),
        heard=_texts(heard),
        sensed=_texts(sensed),
        communication=_gradients(_columns(machine, heard), 1) or SMALL,
        direct=_gradients(_columns(machine, sensed), 3) or COMMITTEE,
        reach=_reach(machine, acts),
        episodes=_lines(_episodes(machine)),
        options=_lines(_options(machine)),
    )


def teacher(machine: Machine) -> str:
    """Return the text of the teacher's module."""
    scene = [name for variable in machine.variables for name in _shown(variable)]
    told = [*scene[:TOLD], *(["..."] if len(scene) > TOLD else []), REWARD]
    constant, rule = _ending(machine.reward.ending)
    return _filled(
        "teacher.py.txt",
        env=machine.env,
        scene=", ".join(told),
        first=scene[0],
        commands=", ".join(map(json.dumps, commands(machine))),
        usual=_number(machine.reward.usual),
        spread=_number(machine.reward.spread),
        ending=constant,
        rule=rule,
    )


def commands(machine: Machine) -> tuple[str, ...]:
    """Return what a teacher can ask for: each choice, or the least and the most of each actuator; two or more."""
    if machine.choices:
        return tuple(name for name, _ in machine.choices)[:NOTES]
    return tuple(f"{actuator.name} {end}" for actuator in machine.actuators for end in ("least", "most"))[:NOTES]


def _filled(template: str, **values: object) -> str:
    return Template((TEMPLATES / template).read_text(encoding="utf-8")).substitute(values)


def _left_out(machine: Machine) -> Iterator[str]:
    if machine.left_out:
        yield f"# not sensed, since its length or kind changes: {', '.join(machine.left_out)}"


def _channel(variable: Variable) -> Iterator[str]:
    name = f"[channels.{variable.name}]"
    if variable.things:
        last = _number(variable.things - 1)
        yield f"{name:<29} # which of {variable.things} things it is. If their numbers are in an order, as sizes are,"
        yield f"{'encoding = ' + _text('one_hot'):<29} # it is learnt sooner with low = 0.0 and high = {last} alone"
        yield f"size = {variable.things}"
        return
    yield f"{name:<29} # measured: the environment gives no bounds" if variable.measured else name
    if variable.numbers > 1:
        yield f"numbers = {variable.numbers}"
    yield f"low = {_number(variable.low)}"
    yield f"high = {_number(variable.high)}"


def _acted(machine: Machine) -> Iterator[str]:
    if machine.choices:
        yield "[channels.action]             # which of the choices below it is"
        yield 'encoding = "one_hot"'
        yield f"size = {len(machine.choices)}"
        return
    for actuator in machine.actuators:
        yield f"[channels.{actuator.name}]"
        yield from _bounds(actuator)


def _choices(machine: Machine) -> Iterator[str]:
    for actuator in machine.actuators:
        yield f"[actuators.{actuator.name}]"
        yield from _bounds(actuator)
    yield "# All choices are tried in the models, and the best is done. Leave out what the robot need not do."
    for name, values in machine.choices:
        yield "[[choice]]"
        yield f"name = {_text(name)}"
        yield f"values = {_table(values)}"


def _ranges(actuators: Sequence[Actuator]) -> Iterator[str]:
    for actuator in actuators:
        yield f"[actuators.{actuator.name}]"
        yield from _bounds(actuator)
    yield ""
    yield "[search]                      # any point in these ranges is an action: the models are searched for it"
    yield 'method = "refine"             # "cma" is better with many actuators (extra `learners`)'
    yield f"evaluations = {min(256, 32 + 16 * len(actuators))}"


def _bounds(actuator: Actuator) -> Iterator[str]:
    yield f"low = {_number(actuator.low)}"
    yield f"high = {_number(actuator.high)}"


def _columns(machine: Machine, names: Iterable[str]) -> int:
    """Return how many numbers a model gets by some inputs."""
    widths = {variable.name: variable.things or variable.numbers for variable in machine.variables}
    widths |= {"note": len(commands(machine)), "action": len(machine.choices)}
    return sum(widths.get(name, 1) for name in names)


def _gradients(columns: int, members: int) -> str:
    """Return the settings of a model with so many inputs that evolution would be slow; "" for a smaller one."""
    if columns <= WIDE:
        return ""
    together = f"members = {members}                   # so many networks learn side by side, and their mean counts\n"
    return f'{together}learner = {{ name = "adam" }}    # gradients, since evolution is slow with {columns} inputs'


def _reach(machine: Machine, acts: Sequence[str]) -> float:
    scalars = sum(variable.numbers for variable in machine.variables if not variable.things)
    scalars += 0 if machine.choices else len(acts)
    return round(REACH * max(1.0, math.sqrt(scalars / AT)), 2)


def _episodes(machine: Machine) -> Iterator[str]:
    ending, end = machine.reward.ending, TRUNCATED if machine.longest else TIMEOUT
    if ending is None:
        yield "successes = []                # what counts as a success: events of the list below"
    elif ending > 0.0:
        yield f'successes = ["{TERMINATED}"]  # what counts as a success: to get to the end'
    else:
        yield f"{f'successes = {_texts([end])}':<29} # what counts as a success: to last until the time is over"
    yield f"ends = {_texts([TERMINATED, TRUNCATED])}"
    if machine.longest is None:
        yield f"episode_iterations = {LONGEST}      # the environment sets no bound; the event is then {TIMEOUT}"


def _options(machine: Machine) -> Iterator[str]:
    if machine.named:
        yield f"names = {_texts(variable.name for variable in machine.variables)}"
    yield f"actuators = {_texts(actuator.name for actuator in machine.actuators)}"
    if machine.endless:
        yield "limit = 1.0                   # an actuator whose range has no end goes from -1 to 1"
    if machine.image:
        yield "grid = 12                     # an image is seen as so many rows and columns of grey"


def _shown(variable: Variable) -> Iterator[str]:
    """Yield the names of a variable's numbers in a scene."""
    several = variable.numbers > 1
    yield from (f"{variable.name}_{place}" for place in range(variable.numbers)) if several else (variable.name,)


def _ending(ending: float | None) -> tuple[str, str]:
    """Return the constant of an end that the reward does not tell, and the lines that judge it."""
    if ending is None:
        return "", ""
    why = "each action costs, so that the end is the aim" if ending > 0.0 else "after the end no more reward comes"
    rule = f'        if event == "{TERMINATED}" and after["{REWARD}"] <= USUAL:\n            return ENDING\n'
    return f"ENDING = {ending}  # an end whose reward is as usual: {why}\n", rule


def _lines(lines: Iterable[str]) -> str:
    return "\n".join(lines)


def _number(value: float) -> str:
    """Return a number as TOML and Python write it, as short as it is right."""
    return repr(float(f"{value:.6g}"))


def _text(text: str) -> str:
    return json.dumps(text)


def _texts(texts: Iterable[str]) -> str:
    return json.dumps(list(texts))


def _table(values: Numbers) -> str:
    return f"{{ {', '.join(f'{name} = {_number(value)}' for name, value in values.items())} }}"
