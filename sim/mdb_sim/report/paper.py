"""The statements of the paper's sections 2 and 3, one by one: what is kept of each, where, and what was measured.

Owns the rows; what fills their last column is in `measured`. "Faithful": as the paper says. "Adapted": its idea,
done in another way or with details that it leaves out. "Missing": not here, or not seen here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mdb_sim.report.measured import (
    Found,
    Measured,
    gap,
    in_reproduction,
    later_is_better,
    movements,
    over_seeds,
    random_part,
    relearning,
    returns,
    second_teacher,
    slopes,
    two_phases,
)
from mdb_sim.verdicts.quantities import OBEDIENCE, SHARE, TO_ERROR
from mdb_sim.verdicts.statistics import markdown

Verdict = Literal["faithful", "adapted", "missing"]
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
        f"`[[mode]]`; `{MECHANISM}/actions/choice.py`",
    ),
    Statement(
        "2.1",
        "Action: a set of commands applied to the actuators.",
        "faithful",
        f"A value for each actuator, by its name; what the motors do for it is the body's (`{SIM}/body.py`).",
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
        f"`messages.Pair`; `{MECHANISM}/networks/encoding.py`",
    ),
    Statement(
        "2.2",
        "Cycle: act, sense, store the pair, learn the models, take the best, optimise the action.",
        "faithful",
        "`services/mdb_services/acting/optimizer.py`. Processes of their own and their acknowledgements are ours.",
    ),
    Statement(
        "2.2",
        "With more iterations the models become more accurate, and the actions more appropriate.",
        "faithful",
        "",
        in_reproduction(later_is_better),
    ),
    Statement(
        "2.2",
        "Long-term memory: models that were successful and stable, used again directly or as seeds.",
        "adapted",
        f"`{MECHANISM}/memories/ltm.py`. When a model is stable, and the sample of pairs that comes back with it, "
        "are ours (the paper refers to its reference 13).",
        returns,
    ),
    Statement(
        "2.3",
        "The search for models is learning, not optimisation: the best generalisation is sought, which is not the "
        "least error at an instant.",
        "adapted",
        "Gradual learning serves it, as in the next rows. Which individual is best is still decided by its error "
        "over the short-term memory, but the object and the induced model are the mean of the best of several "
        "populations (`learners/committee.py`), which generalises better. Great weights are penalised: those of the "
        "induced model, and, the more the greater the error is, those of the communication model.",
    ),
    Statement(
        "2.3",
        "Models are artificial neural networks, the search is evolutionary.",
        "faithful",
        f"`{MECHANISM}/networks/network.py`, `learners/pbga.py`; other learners by name, see section 4",
    ),
    Statement(
        "2.3",
        "A few generations for each content of the short-term memory.",
        "faithful",
        "`generations` in the experiment file; the evolver does no more for a version of the memory",
    ),
    Statement(
        "2.3",
        "Populations are kept between iterations.",
        "faithful",
        "`services/mdb_services/evolver.py`; some models have several small ones, see above",
    ),
    Statement(
        "2.3",
        "Fitness: the error between predicted and real values of the pairs.",
        "adapted",
        f"`{MECHANISM}/evolution/compiled/kernel.py`; every individual anew on every version of the memory, "
        "and the penalties on great weights, are ours",
    ),
    Statement(
        "2.3",
        "The short-term memory has a replacement strategy that keeps the most relevant samples.",
        "adapted",
        f"`{MECHANISM}/memories/stm.py`. The paper refers to its reference 12; the label's terms in detail are ours.",
    ),
    Statement(
        "2.3",
        "The search for the action is an optimisation, for which any technique will do.",
        "faithful",
        f"All seven are tried: `{MECHANISM}/actions/choice.py`",
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
        f"`{MECHANISM}/actions/choice.py`: the first `[[mode]]` whose inputs are there",
    ),
    Statement(
        "3",
        "If the teacher is consistent, either satisfaction model leads to the same behaviour.",
        "faithful",
        "Captures as a share of the ideal:",
        in_reproduction(two_phases(SHARE, ("with the first teacher", "alone after him"), (0, 1))),
    ),
    Statement(
        "3",
        "The agent is a Pioneer 2 with a ring of sonars, all computation in a laptop on top of it.",
        "adapted",
        f"Simulated, in PyBullet and by a kinematic twin; in `{SIM}/bodies/pioneer`: `physics.py`, `twin.py`, "
        "`sonar.py`",
    ),
    Statement(
        "3",
        "The robot begins in the centre, the object in an area around it.",
        "faithful",
        f"`draw_placement` in `{SIM}/bodies/pioneer/arena.py`; the distances are ours",
    ),
    Statement(
        "3",
        "The teacher, external to the MDB, makes the robot reach the object frontally.",
        "faithful",
        f"`{SIM}/teaching/policies/pioneer.py`; what “frontally” means is ours: within 20°",
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
        "`services/mdb_services/hearing/ear.py`, section “Sound” of `services/README.md`. In the runs of this "
        "report the notes are named, not sounded.",
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
        f"`graded` in `{SIM}/teaching/schedule.py`; `mdb teach` has the keyboard. The steps of the degree are ours.",
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
        f"`{MECHANISM}/evolution/compiled/operators.py`. After its reference 14; the operators in detail are ours.",
    ),
    Statement(
        "3",
        "All actions are tested, the one with the best satisfaction is taken.",
        "adapted",
        f"`{MECHANISM}/actions/choice.py`. But a satisfaction counts as far as the memory supports it, and while "
        "nothing promises enough, what may be better is tried: both are ours.",
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
        in_reproduction(over_seeds(TO_ERROR, 0)),
    ),
    Statement(
        "3",
        "Consequently the robot follows the commands.",
        "faithful",
        "It does; but not as a consequence: see section 2, where the error falls and the robot does not obey.",
        in_reproduction(over_seeds(OBEDIENCE, 0)),
    ),
    Statement(
        "3",
        "Figure 4: the second teacher is learnt as fast as the first, in about the time that it takes to empty the "
        "memory of the first one's pairs.",
        "adapted",
        f"A detector of changes (`{MECHANISM}/memories/context.py`) drops the old pairs at once.",
        in_reproduction(relearning),
    ),
    Statement(
        "3",
        "The robot follows the second teacher's commands.",
        "faithful",
        "",
        in_reproduction(second_teacher),
    ),
    Statement(
        "3",
        "World and internal models are learnt in the same way with both teachers.",
        "faithful",
        "Their data hold no language. Captures alone as a share of the ideal:",
        in_reproduction(two_phases(SHARE, AFTER, (1, 3))),
    ),
    Statement(
        "3",
        "Figure 5: alone, the robot goes on capturing the object.",
        "faithful",
        "Each seed in section 7.",
        in_reproduction(over_seeds(SHARE, 1)),
    ),
    Statement(
        "3",
        "Figure 5: alone the slope is less, since the robot has learnt to approach, not the fastest way.",
        "missing",
        "Not seen here: the induced model reads the angle too, and facing the object is what is rewarded.",
        slopes,
    ),
    Statement(
        "3",
        "Figure 5: when the second teacher appears, there is a brief gap without captures.",
        "faithful",
        "",
        in_reproduction(gap),
    ),
    Statement(
        "3",
        "Figure 5: no captures in the first 200 iterations, because exploration is forced to be random.",
        "faithful",
        "`random_iterations = 200`; some captures happen by chance",
        in_reproduction(random_part),
    ),
    Statement(
        "3",
        "Figure 6: alone the behaviour is basically the same, a little less efficient.",
        "faithful",
        "",
        in_reproduction(movements),
    ),
    Statement(
        "3",
        "Any teacher can teach any machine any behaviour that it can carry out.",
        "adapted",
        "The brain knows no machine. This report is of one robot and one task; others are taught by an experiment "
        "file (`deploy/experiments/`). Teachers who err: section 3.",
    ),
)
