"""What a run log says of how well the robot learnt: errors told apart, obedience, successes, durations.

Owns the definitions of all measures; pure functions of a `record.RunRecord`. Errors are mean squared errors
in the models' scaled units, where feedback lies in [-1, 1]; 0.1 is what "10 %" means (sim/README.md,
"Errors, told apart"). A measure is nan where the log has no data for it, and inf where what is measured never
happened.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mdb_services.mechanism.networks.encoding import Codebook, Facts
from mdb_services.mechanism.networks.network import Network
from mdb_sim.runs.record import Doubles, RunRecord, Span
from mdb_sim.teaching import policy as policies
from mdb_sim.teaching.languages import Language
from mdb_sim.teaching.schedule import graded

AVERAGED = 40
"""Commanded iterations in a running mean (sim/README.md, "Errors, told apart")."""
THRESHOLD = 0.1
"""The error below which the paper calls the rewards very accurately predicted (section 3: 10 %)."""
SETTLED = 0.4
"""Share of a phase, at its end, in which obedience is judged: 300-500 and 1300-1500 in the paper."""
EVERY = 5
"""Iterations from one evaluation on all command-action pairs to the next."""
RECENT, OBEDIENT = 20, 0.9
"""Commands in the sliding window of obedience, and the share of them that is called obedience."""

Window = tuple[int, int]
"""Iterations from the first to the second, which is not included."""


def prequential_error(record: RunRecord) -> Doubles:
    """Return the communication model's error on each pair before it was learnt (iterations,)."""
    nothing = np.full(record.iterations, np.nan)
    if record.communication is None:
        return nothing
    errors = record.prequential.get(record.communication, nothing)
    return np.where(record.commanded, errors, np.nan)


def running_mean(record: RunRecord, values: Doubles, *, full: bool = False) -> Doubles:
    """Return the mean of the last `AVERAGED` values that are not nan (iterations,), anew in each phase.

    `full`: nan until there are that many; otherwise the mean of those that there are.
    """
    means = np.full(record.iterations, np.nan)
    for span in record.taught:
        phase = slice(span.start, span.stop)
        means[phase] = mean_of_last(values[phase], AVERAGED, full=full)
    return means


def mean_of_last(values: Doubles, count: int, *, full: bool = False) -> Doubles:
    """Return, where a value is not nan, the mean of the last `count` such values, itself included (n,).

    `full`: nan until there are that many; otherwise the mean of those that there are.
    """
    means = np.full(len(values), np.nan)
    places = np.flatnonzero(np.isfinite(values))
    sums = np.concatenate([[0.0], np.cumsum(values[places])])
    last = np.arange(1, len(places) + 1)
    first = np.maximum(last - count, 0)
    found = (sums[last] - sums[first]) / (last - first)
    if full:
        found[: count - 1] = np.nan
    means[places] = found
    return means


def iterations_below(record: RunRecord, span: Span) -> float:
    """Return the iterations from a phase's beginning until the prequential error is below `THRESHOLD`.

    Only the mean of `AVERAGED` counts, so this is at least `AVERAGED`. inf: not in the whole phase; nan: not
    yet, in a run that ended before the phase.
    """
    means = running_mean(record, prequential_error(record), full=True)[span.start : span.stop]
    below = np.flatnonzero(means < THRESHOLD)
    if len(below):
        return float(below[0] + 1)
    return np.inf if record.iterations >= span.stop else np.nan


def memory_error(record: RunRecord) -> Doubles:
    """Return the error over the short-term memory of the communication model in use (iterations,).

    What the paper plots in figure 4, we think. Only where a command came: without a teacher the memory stands
    still.
    """
    errors = np.full(record.iterations, np.nan)
    if record.communication is None or record.communication not in record.versions:
        return errors
    for i in np.flatnonzero(record.commanded):
        version = int(record.versions[record.communication][i])
        model = record.models.get((record.communication, version))
        if model is not None:
            errors[i] = model.error
    return errors


class PairJudge:
    """The error of communication models over every note and choice, by what the teacher would say."""

    def __init__(self, codebook: Codebook, language: Language, says: Mapping[tuple[int, int], float]) -> None:
        """`says`: the feedback after a command for a choice."""
        choices = sorted({choice for _, choice in says})
        notes = np.arange(len(language.notes))
        pairs: Facts = {
            "note": np.repeat(notes, len(choices)).astype(np.float64),
            "action": np.tile(choices, len(notes)).astype(np.float64),
        }
        pairs["feedback"] = np.array([says[language.command(n), c] for n in notes.tolist() for c in choices])
        inputs, targets = codebook.input_rows(pairs), codebook.target_rows(pairs)
        if inputs is None or targets is None:
            raise ValueError(
                f"model of {codebook.inputs} to {codebook.outputs}: expected note and action to feedback"
            )
        self._inputs, self._targets = inputs, targets

    def error(self, network: Network) -> float:
        """Return the mean squared error over all pairs, in scaled units."""
        return float(np.square(network.predict(self._inputs) - self._targets).mean())


def pair_error(record: RunRecord, every: int = EVERY) -> Doubles:
    """Return the error of the communication model in use over all command-action pairs (iterations,).

    Of the language that is present, every so many iterations and in the last of each phase; elsewhere nan,
    and also without a teacher or with one whose language the experiment does not tell.
    """
    errors = np.full(record.iterations, np.nan)
    for span in record.taught:
        judge = _judge(record, span)
        stop = min(span.stop, record.iterations)
        if judge is None or stop <= span.start:
            continue
        for i in sorted({*range(span.start, stop, every), stop - 1}):
            network = _network_in_use(record, i)
            if network is not None:
                errors[i] = judge.error(network)
    return errors


def _judge(record: RunRecord, span: Span) -> PairJudge | None:
    brain, teacher = record.experiment.brain, record.experiment.teacher
    if span.language is None or teacher is None or record.communication is None:
        return None
    model = brain.model_named(record.communication)
    if set(model.inputs) != {"note", "action"} or model.outputs != ("feedback",):
        return None
    policy, says = record.experiment.schedule().policy, {}
    for command in range(len(policy.commands)):
        for place, choice in enumerate(brain.choice):
            judgement = policy.expected(command, choice.values)
            if judgement is None:
                return None
            says[command, place] = graded(judgement, binary=teacher.feedback == "binary")
    codebook = Codebook(brain.variables(), model.inputs, model.outputs)
    return PairJudge(codebook, span.language, says)


def _network_in_use(record: RunRecord, iteration: int) -> Network | None:
    """Return the communication model that the optimizer had in this iteration."""
    name = record.communication
    if name is None or name not in record.versions:
        return None
    model = record.models.get((name, int(record.versions[name][iteration])))
    return None if model is None else Network.from_arrays(model.layers, model.weights)


def obeyed(record: RunRecord) -> Doubles:
    """Return 1 where what the note meant was done, 0 where it was not, nan without a command.

    The policy says so, from what was wanted and what happened. Where the language is not known, feedback says it.
    """
    found = np.full(record.iterations, np.nan)
    policy = record.experiment.schedule().policy if record.experiment.teacher is not None else None
    for span in record.spans:
        for i in span.start + np.flatnonzero(record.commanded[span.start : span.stop]):
            scene = record.scenes.get(int(i) + 1)
            if policy is not None and span.language is not None:
                done = None if scene is None else policies.obeyed(policy, span.language, int(record.note[i]), scene)
                found[i] = np.nan if done is None else done
            elif np.isfinite(record.feedback[i]):
                found[i] = record.feedback[i] >= policies.OBEYED
    return found


def obedience(record: RunRecord, window: Window) -> float:
    """Return the share of commands obeyed in a window; nan when the log ends before it does."""
    found = obeyed(record)[slice(*window)]
    if record.iterations < window[1] or not np.isfinite(found).any():
        return np.nan
    return float(np.nanmean(found))


def obedience_window(span: Span) -> Window:
    """Return the last part of a taught phase, in which the language has been learnt."""
    return span.stop - round(SETTLED * (span.stop - span.start)), span.stop


def recent_obedience(record: RunRecord, span: Span, *, full: bool = False) -> Doubles:
    """Return the share obeyed of a phase's last `RECENT` commands: (n,) for its iterations in the log.

    nan where no command came. `full`: nan until there are that many; otherwise the share of those that there are.
    """
    return mean_of_last(obeyed(record)[span.start : span.stop], RECENT, full=full)


def iterations_to_obedience(record: RunRecord, span: Span) -> float:
    """Return the iterations from a phase's beginning until `OBEDIENT` of the last `RECENT` commands were obeyed.

    Only commands of the phase count, so this is at least `RECENT`. inf: not in the whole phase; nan: not yet,
    in a run that ended before the phase.
    """
    obedient = np.flatnonzero(recent_obedience(record, span, full=True) >= OBEDIENT)
    if len(obedient):
        return float(obedient[0] + 1)
    return np.inf if record.iterations >= span.stop else np.nan


def disobeyed_at_first(record: RunRecord, span: Span) -> float:
    """Return how many of a phase's first `RECENT` commands were not obeyed; nan when fewer came."""
    commands = obeyed(record)[span.start : span.stop]
    commands = commands[np.isfinite(commands)][:RECENT]
    return float(np.sum(commands == 0)) if len(commands) == RECENT else np.nan


def successes(record: RunRecord, window: Window) -> float:
    """Return the successes in a window; nan when the log ends before it does."""
    start, stop = window
    return float(record.successes[stop] - record.successes[start]) if record.iterations >= stop else np.nan


def success_window(record: RunRecord, span: Span) -> Window:
    """Return the iterations of a phase in which successes count: not those of forced exploration."""
    return min(max(span.start, record.random_iterations), span.stop), span.stop


@dataclass(frozen=True)
class Latency:
    """Durations in seconds, over the iterations whose timing is in the log."""

    median_s: float
    p95_s: float
    p99_s: float
    max_s: float


def latency(record: RunRecord) -> Latency:
    """Return the time from a perception to its action, waits for teacher and models included."""
    known = record.perception_to_action_s[np.isfinite(record.perception_to_action_s)]
    if not len(known):
        return Latency(np.nan, np.nan, np.nan, np.nan)
    return Latency(*np.percentile(known, [50, 95, 99, 100]).tolist())
