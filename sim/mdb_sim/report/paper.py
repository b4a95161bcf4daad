"""The statements of the paper's sections 2 and 3, one by one: what is kept of each, where, and what was measured.

Owns the rows and the measures that fill their last column, from the results of the study `reproduction` (graded
reward unless said) and of others where named. "Faithful": as the paper says. "Adapted": its idea, done in another
way or with details that it leaves out. "Missing": not here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mdb_sim.report.comings import comings_of
from mdb_sim.report.quantities import OBEDIENCE, SHARE, TO_ERROR, TO_OBEDIENCE, Measure, Runs, capture_rate, runs_of
from mdb_sim.report.statistics import Shape, Statistic, estimate, interval, markdown, number, percent, text
from mdb_sim.studies import tables
from mdb_sim.studies.results import Result
from mdb_sim.studies.rows import PhaseRow

Verdict = Literal["faithful", "adapted", "missing"]
Found = Mapping[str, Sequence[Result]]
"""Results by study."""
Seeds = Mapping[int, Sequence[PhaseRow]]
Measured = Callable[[Found], str]

MAIN = "reproduction"
GRADED, BINARY = "graded reward", "binary reward"
NOT_YET = "not measured yet"
MECHANISM, SIM = "services/mdb_services/mechanism", "sim/mdb_sim"


@dataclass(frozen=True)
class Statement:
    """One statement of the paper."""

    section: str
    says: str
    verdict: Verdict
    where: str
    """Where in the code, or what is otherwise."""
    measured: Measured | None = None


def statements_table(found: Found) -> str:
    """Return Markdown: a row a statement, the last column filled from results."""
    head = ["section", "the paper says", "here", "where, and how", "measured"]
    rows = []
    for statement in STATEMENTS:
        told = "" if statement.measured is None else statement.measured(found)
        verdict = statement.verdict if statement.verdict == "faithful" else f"**{statement.verdict}**"
        rows.append([statement.section, statement.says, verdict, statement.where, told])
    counts = {
        verdict: sum(s.verdict == verdict for s in STATEMENTS) for verdict in ("faithful", "adapted", "missing")
    }
    shown = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    return f"{len(STATEMENTS)} statements: {shown}.\n\n{_left(markdown(head, rows))}"


def _left(table: str) -> str:
    """Return a table of words, all columns to the left."""
    return table.replace("--:", "---", 4 if table.count("--:") >= 4 else 0)


# ---- what was measured ----


def _runs(found: Found, study: str) -> Runs | None:
    results = found.get(study)
    if not results:
        return None
    body = results[0].label.body
    return runs_of(result for result in results if result.label.body == body)


def _main(told: Callable[[Seeds], str], variant: str = GRADED) -> Measured:
    """Return what is told of the runs of the reproduction."""

    def measured(found: Found) -> str:
        runs = _runs(found, MAIN)
        if runs is None or not runs.get(variant):
            return NOT_YET
        return told(runs[variant])

    return measured


def _of(measure: Measure, phase: int) -> Callable[[Seeds], str]:
    def told(seeds: Seeds) -> str:
        rows = [rows[phase] for rows in seeds.values()]
        return _spread([measure.value(row) for row in rows], seeds, measure.statistic, measure.shape)

    return told


def _spread(values: Sequence[float], seeds: Seeds, statistic: Statistic, shape: Shape) -> str:
    return f"{statistic} {interval(estimate(values, statistic), shape)} ({len(seeds)} seeds)"


def _both(measure: Measure, words: tuple[str, str], phases: tuple[int, int]) -> Callable[[Seeds], str]:
    return lambda seeds: "; ".join(
        f"{word}: {_of(measure, phase)(seeds)}" for word, phase in zip(words, phases, strict=True)
    )


def _later_is_better(seeds: Seeds) -> str:
    def part(row: PhaseRow, part: slice) -> float:
        errors = row.prequential_curve[np.isfinite(row.prequential_curve)][part]
        return float(errors.mean()) if len(errors) else math.nan

    first = [part(rows[0], slice(None, 100)) for rows in seeds.values()]
    last = [part(rows[0], slice(-100, None)) for rows in seeds.values()]
    return (
        f"prequential MSE of the first teacher's first 100 commands {interval(estimate(first, 'mean'), percent)}, of "
        f"the last 100 {interval(estimate(last, 'mean'), percent)}"
    )


def _relearning(seeds: Seeds) -> str:
    from_zero = [rows[0].iterations_to_error for rows in seeds.values()]
    again = [rows[2].iterations_to_error for rows in seeds.values()]
    first, second = estimate(from_zero, "median").value, estimate(again, "median").value
    return f"iterations to 10 %, medians: first teacher {text(first, number)}, second {text(second, number)}"


def _slope(seeds: Seeds) -> str:
    changes = []
    for rows in seeds.values():
        taught, alone = (capture_rate(rows[phase]) for phase in (0, 1))
        changes.append(alone / taught - 1 if taught > 0 else math.nan)
    return _spread(changes, seeds, "mean", percent)


def _slopes(found: Found) -> str:
    graded, binary = _main(_slope)(found), _main(_slope, BINARY)(found)
    return (
        f"captures an iteration, first phase alone against the phase taught before: graded {graded}; binary {binary}"
    )


def _gap(seeds: Seeds) -> str:
    def first(row: PhaseRow) -> float:
        done = np.flatnonzero(row.captured)
        return float(done[0] + 1) if len(done) else math.inf

    second, alone = [first(rows[2]) for rows in seeds.values()], [first(rows[1]) for rows in seeds.values()]
    return (
        f"iterations to the first capture: second teacher {_spread(second, seeds, 'median', number)}, "
        f"alone before {text(estimate(alone, 'median').value, number)}"
    )


def _random_part(seeds: Seeds) -> str:
    counts = [float(rows[0].captured[: rows[0].counted_from].sum()) for rows in seeds.values()]
    until = next(iter(seeds.values()))[0].counted_from
    return f"captures by chance in 0–{until}: {_spread(counts, seeds, 'mean', number)}"


def _movements(seeds: Seeds) -> str:
    def mean(alone: bool) -> list[float]:
        return [
            float(np.mean([step for row in rows if row.alone == alone for step in row.capture_steps] or [math.nan]))
            for rows in seeds.values()
        ]

    return (
        f"movements to a capture: taught {interval(estimate(mean(False), 'mean'), number)}, "
        f"alone {interval(estimate(mean(True), 'mean'), number)}"
    )


def _returns(found: Found) -> str:
    runs = _runs(found, "memory")
    if runs is None:
        return f"{NOT_YET} (`mdb study memory`)"
    told = []
    for variant, rows in comings_of(runs).items():
        if variant in (tables.LONG_TERM_ON, tables.LONG_TERM_OFF) and rows and len(rows[0].comings) > 2:
            median = estimate([row.comings[2].iterations for row in rows], "median").value
            told.append(f"{variant} {text(median, number)}")
    return f"iterations to 90 % obedience when the first teacher returns, medians: {', '.join(told)}"


TEACHERS = ("first teacher", "second")
AFTER = ("after the first teacher", "after the second")

STATEMENTS: tuple[Statement, ...] = (
    Statement(
        "2",
        "The acquisition of knowledge is automatic: the designers do not impose theirs.",
        "adapted",
        "No model is given. But the experiment file says which sensors each model reads, and how each is scaled "
        "(`[channels]`, `[[model]]`).",
    ),
    Statement(
        "2.1",
        "A motivation guides the behaviour by the degree of its satisfaction.",
        "faithful",
        f"`[[mode]]`; `{MECHANISM}/choice.py`",
    ),
    Statement(
        "2.1",
        "Action: a set of commands applied to the actuators.",
        "faithful",
        f"An index; what the motors do for it is the body's (`{SIM}/robot.py`).",
    ),
    Statement(
        "2.1",
        "World model: from the sensory inputs at t and an action to those at t+1. Satisfaction model: from sensory "
        "inputs to the satisfaction in the same instant.",
        "faithful",
        "`role` of a `[[model]]`; one evolver each (`services/mdb_services/evolver.py`)",
    ),
    Statement(
        "2.1",
        "Action-perception pair: sensory inputs and satisfaction after an action in the real world.",
        "faithful",
        f"`messages.Pair`; `{MECHANISM}/encoding.py`",
    ),
    Statement(
        "2.2",
        "Cycle: act, sense, store the pair, learn the models, take the best, optimise the action.",
        "faithful",
        "`services/mdb_services/optimizer.py`. Processes of their own and their acknowledgements are ours.",
    ),
    Statement(
        "2.2",
        "With more iterations the models become more accurate, and the actions more appropriate.",
        "faithful",
        "",
        _main(_later_is_better),
    ),
    Statement(
        "2.2",
        "Long-term memory: models that were successful and stable, used again directly or as seeds.",
        "adapted",
        f"`{MECHANISM}/ltm.py`. When a model is stable, and the sample of pairs that comes back with it, are ours "
        "(the paper refers to its reference 13).",
        _returns,
    ),
    Statement(
        "2.3",
        "The search for models is learning, not optimisation: the best generalisation is sought, which is not the "
        "least error at an instant.",
        "adapted",
        "Gradual learning serves it, as in the next rows. Which individual acts is still decided by its error over "
        "the short-term memory.",
    ),
    Statement(
        "2.3",
        "Models are artificial neural networks, the search is evolutionary.",
        "faithful",
        f"`{MECHANISM}/network.py`, `learners/pbga.py`; other learners by name, see section 4",
    ),
    Statement(
        "2.3",
        "A few generations for each content of the short-term memory.",
        "faithful",
        "`generations` in the experiment file; the evolver does no more for a version of the memory",
    ),
    Statement("2.3", "Populations are kept between iterations.", "faithful", "`services/mdb_services/evolver.py`"),
    Statement(
        "2.3",
        "Fitness: the error between predicted and real values of the pairs.",
        "faithful",
        f"`{MECHANISM}/kernel.py`; every individual anew on every version of the memory, which is ours",
    ),
    Statement(
        "2.3",
        "The short-term memory has a replacement strategy that keeps the most relevant samples.",
        "adapted",
        f"`{MECHANISM}/stm.py`. The paper refers to its reference 12; the label's terms in detail are ours.",
    ),
    Statement(
        "2.3",
        "The search for the action is an optimisation, for which any technique will do.",
        "faithful",
        f"All seven are tried: `{MECHANISM}/choice.py`",
    ),
    Statement("2.3", "The mechanism was tested in real agents.", "missing", "Simulated bodies only."),
    Statement(
        "3",
        "Interaction with the world and learning go on at the same time, on all models.",
        "faithful",
        "The pace `concurrent`. The runs of this report are in lockstep, so that they can be repeated.",
    ),
    Statement(
        "3",
        "Several satisfaction models may arise, which relate different sensory patterns to the satisfaction.",
        "adapted",
        "Which there are is written in the experiment file; none arises by itself.",
    ),
    Statement(
        "3",
        "A model is applicable only when its inputs are present. With a teacher the first pair of models acts, "
        "without one the induced pair.",
        "faithful",
        f"`{MECHANISM}/choice.py`: the first `[[mode]]` whose inputs are there",
    ),
    Statement(
        "3",
        "If the teacher is consistent, either satisfaction model leads to the same behaviour.",
        "faithful",
        "Captures as a share of the ideal's:",
        _main(_both(SHARE, ("with the first teacher", "alone after him"), (0, 1))),
    ),
    Statement(
        "3",
        "The agent is a Pioneer 2 with a ring of sonars, all computation in a laptop on top of it.",
        "adapted",
        f"Simulated, in PyBullet and by a kinematic twin: `{SIM}/pioneer.py`, `kinematic.py`, `sonar.py`",
    ),
    Statement(
        "3",
        "The robot begins in the centre, the object in an area around it.",
        "faithful",
        f"`draw_placement` in `{SIM}/arena.py`; the distances are ours",
    ),
    Statement(
        "3",
        "The teacher, external to the MDB, makes the robot reach the object frontally.",
        "faithful",
        f"`{SIM}/teacher.py`; what “frontally” means is ours: within 20°",
    ),
    Statement(
        "3",
        "Seven commands; seven actions: no turn, small, medium and large turns to either side.",
        "faithful",
        "`turns_deg`; 20°, 45° and 90° and the advance of 0.2 m are ours",
    ),
    Statement(
        "3",
        "The commands are musical notes, heard by a microphone.",
        "adapted",
        "`services/mdb_services/ear.py`, section “Sound” of `README.md`. In the runs of this report the notes are "
        "named, not sounded.",
    ),
    Statement(
        "3",
        "Which note stands for which command is not established before: any correspondence will do.",
        "faithful",
        "A permutation drawn for each teacher and seed; the note is one-hot, so no order is supposed.",
    ),
    Statement(
        "3",
        "The teacher rewards or punishes by the degree of fulfilment, by a number from a keyboard.",
        "faithful",
        f"`graded` in `{SIM}/teacher.py`; `mdb teach` has the keyboard. The steps of the degree are ours.",
    ),
    Statement(
        "3",
        "Communication model: command and action to human feedback. Its satisfaction model is trivial.",
        "adapted",
        "Two variables in, one out, as there; but the note is one-hot and the action in the actuators' order. What "
        "one number each would do is in section 2.",
    ),
    Statement(
        "3",
        "While the teacher is there, the other models learn in the background.",
        "faithful",
        "Every pair goes to all models whose inputs and outputs it holds.",
    ),
    Statement(
        "3",
        "Object model: distance, angle, continuity bit and action to the next three.",
        "faithful",
        '`[[model]] name = "object"`',
    ),
    Statement(
        "3",
        "Induced satisfaction model: relative distance covered and angle after the action to satisfaction.",
        "faithful",
        '`[[model]] name = "induced"`',
    ),
    Statement(
        "3",
        "Models are multilayer perceptrons evolved by a promoter-based genetic algorithm.",
        "adapted",
        f"`{MECHANISM}/operators.py`. After its reference 14; the operators in detail are ours.",
    ),
    Statement(
        "3",
        "All actions are tested, the one with the best satisfaction is taken.",
        "adapted",
        f"`{MECHANISM}/choice.py`. But while nothing promises enough the robot sometimes explores, which is ours.",
    ),
    Statement(
        "3",
        "Figure 4: without a teacher there are no data, and the communication model does not evolve.",
        "faithful",
        "A pair without note and feedback does not enter its memory.",
    ),
    Statement(
        "3",
        "Figure 4: in the first 500 iterations the error falls fast to below 10 %.",
        "faithful",
        "",
        _main(_of(TO_ERROR, 0)),
    ),
    Statement(
        "3",
        "Consequently the robot follows the commands.",
        "faithful",
        "It does; but not as a consequence: see section 2, where the error falls and the robot does not obey.",
        _main(_of(OBEDIENCE, 0)),
    ),
    Statement(
        "3",
        "Figure 4: the second teacher is learnt as fast as the first, in about the time that it takes to empty the "
        "memory of the first one's pairs.",
        "adapted",
        f"A detector of changes (`{MECHANISM}/context.py`) drops the old pairs at once.",
        _main(_relearning),
    ),
    Statement(
        "3",
        "The robot follows the second teacher's commands.",
        "faithful",
        "",
        _main(lambda seeds: f"obedience {_of(OBEDIENCE, 2)(seeds)}; to 90 %: {_of(TO_OBEDIENCE, 2)(seeds)}"),
    ),
    Statement(
        "3",
        "World and internal models are learnt in the same way with both teachers.",
        "faithful",
        "Their data hold no language. Captures alone as a share of the ideal's:",
        _main(_both(SHARE, AFTER, (1, 3))),
    ),
    Statement(
        "3",
        "Figure 5: alone, the robot goes on capturing the object.",
        "faithful",
        "Each seed in section 7.",
        _main(_of(SHARE, 1)),
    ),
    Statement(
        "3",
        "Figure 5: alone the slope is less, since the robot has learnt to approach, not the fastest way.",
        "missing",
        "Not seen here: the induced model reads the angle too, and facing the object is what is rewarded.",
        _slopes,
    ),
    Statement(
        "3",
        "Figure 5: when the second teacher appears, there is a brief gap without captures.",
        "faithful",
        "",
        _main(_gap),
    ),
    Statement(
        "3",
        "Figure 5: no captures in the first 200 iterations, because exploration is forced to be random.",
        "faithful",
        "`random_iterations = 200`; some captures happen by chance",
        _main(_random_part),
    ),
    Statement(
        "3",
        "Figure 6: alone the behaviour is basically the same, a little less efficient.",
        "faithful",
        "",
        _main(_movements),
    ),
    Statement(
        "3",
        "Any teacher can teach any machine any behaviour that it can carry out.",
        "adapted",
        "The brain knows no machine; body and scripted teacher here are of one robot and one task. Teachers who err: "
        "section 3.",
    ),
)
