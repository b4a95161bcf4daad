"""What is shown of each study: its tables and figures.

Owns the choice and the words around it. How numbers are compared is in `quantities`, how they look in `drawings`
and `curves`. A new study gets a function here and a line in `SECTIONS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from mdb_sim.figures import curves, drawings
from mdb_sim.figures.learning import Learning, draw_learning
from mdb_sim.figures.machines import draw_machines
from mdb_sim.studies import tables
from mdb_sim.studies.catalogue import Study
from mdb_sim.studies.players import rewarded
from mdb_sim.studies.rows import PhaseRow
from mdb_sim.verdicts.acceptance import criteria_table, error_without_obedience, failures, seeds_table
from mdb_sim.verdicts.aims import aims_table
from mdb_sim.verdicts.comings import comings_of, comings_table
from mdb_sim.verdicts.machines import OF, machines_table
from mdb_sim.verdicts.quantities import (
    SHARE,
    Runs,
    all_quantities,
    capture_rate,
    figure_quantities,
    main_quantities,
    phase_name,
    phases_of,
    quantity,
    quantity_table,
    summary,
)
from mdb_sim.verdicts.rivals import rivals_table, without_reward
from mdb_sim.verdicts.statistics import estimate, interval, markdown, number, percent, seeds_text, text, wilson


@dataclass(frozen=True)
class Section:
    """What a section is made from, and the files that it makes."""

    study: Study
    runs: Runs
    """All variants with the seeds that all of them have."""
    own: Runs
    """Each variant with all its own seeds: what is not compared seed by seed."""
    stem: Path
    """Beginning of its figures' paths, without ending."""
    link: str
    """The figures' folder as the text names it."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """What a run took, by variant: the median."""
    files: list[Path] = field(default_factory=list)

    def figure(self, drawn: Sequence[Path], caption: str) -> str:
        """Keep a figure's files; return the lines that show it."""
        self.files.extend(drawn)
        title = caption.partition(".")[0].partition(":")[0]
        return f"![{title}]({self.link}/{drawn[0].name})\n\n*{caption}*"

    def named(self, name: str) -> Path:
        """Return the path of one of several figures, without ending."""
        return self.stem.with_name(f"{self.stem.name}-{name}")


def reproduction(section: Section) -> str:
    """Figures 4 to 6, what was captured, and the slopes."""
    runs = {f"{variant} ({len(seeds)} seeds)": seeds for variant, seeds in section.own.items()}
    common = next(iter(section.runs.values()))
    return _paragraphs(
        section.figure(
            curves.draw_errors(runs, section.named("figure4")),
            "Figure 4: error of the communication model. Mean of the seeds with its 95 % band; nothing is drawn "
            "where nobody teaches.",
        ),
        section.figure(
            curves.draw_captures(runs, section.named("figure5")),
            "Figure 5: captures of the object. Each seed thin, mean with its 95 % band; dashed: mean of the ideals.",
        ),
        section.figure(
            curves.draw_paths(runs, section.named("figure6")),
            "Figure 6: typical episodes of the first seed, those of the most ordinary length.",
        ),
        f"Side by side, on {seeds_text(list(common))}:" if common else "",
        summary(all_quantities(section.runs)) if common else "",
        "**The slope.** Captures in 100 iterations, and movements to a capture (mean of the seeds):",
        slopes_table(runs),
        *(f"{variant}: {error_without_obedience(seeds)}" for variant, seeds in runs.items()),
    )


def slopes_table(runs: Runs) -> str:
    """Return how fast objects are captured with a teacher and in the phase alone that follows."""
    head = ["reward", "phases", "per 100, taught [95 %]", "per 100, alone [95 %]", "change [95 %]"]
    head += ["movements to a capture, taught", "alone"]
    rows = []
    for variant, seeds in runs.items():
        phases = next(iter(seeds.values()))
        for taught, alone in pairwise(phases):
            if taught.alone or not alone.alone:
                continue
            before = [100 * capture_rate(rows_[taught.phase]) for rows_ in seeds.values()]
            after = [100 * capture_rate(rows_[alone.phase]) for rows_ in seeds.values()]
            change = [b / a - 1 if a > 0 else math.nan for a, b in zip(before, after, strict=True)]
            cells = [interval(estimate(values, "mean"), number) for values in (before, after)]
            cells.append(interval(estimate(change, "mean"), percent))
            steps = [number(mean_steps(rows_[p.phase] for rows_ in seeds.values())) for p in (taught, alone)]
            rows.append([variant, f"{taught.name}, {alone.name}", *cells, *steps])
    return markdown(head, rows)


def mean_steps(rows: Iterable[PhaseRow]) -> float:
    """Return the mean number of movements to a capture."""
    steps = [float(step) for row in rows for step in row.capture_steps]
    return sum(steps) / len(steps) if steps else math.nan


def paper(section: Section) -> str:
    """The paper as written against what is shipped, and each addition on and off."""
    runs = section.runs
    written = runs.get(tables.AS_WRITTEN)
    return _paragraphs(
        "“Written”: note and action each one number, the action in the paper's listing; memories first in first out; "
        "models believed everywhere, one learner a model, praise as it is given, no exploration by aspiration, no "
        "detector of changes, no long-term memory. The penalties on great weights stay. Then each addition alone, "
        "and everything without it.",
        summary(main_quantities(runs)),
        "As written: " + error_without_obedience(written) if written else "",
        _variants_figure(section, "What each addition brings, alone and all but it."),
        _failures(runs),
    )


def teachers(section: Section) -> str:
    """Teachers as they are."""
    return _paragraphs(
        "The settings hold for both teachers. A note counts as obeyed when it is obeyed as it sounds, also a wrong "
        "one. “knows the language” is a player that obeys each note as it sounds and does anything when alone: what "
        "wrong notes leave to be captured at all.",
        summary(main_quantities(section.runs), "teachers"),
        aims_table(section.runs),
        _variants_figure(section, "Teachers as they are."),
        _failures(section.runs),
    )


def learners(section: Section) -> str:
    """Learners in the closed loop, and players without our mechanism."""
    return _paragraphs(
        "“as shipped” has committees for two of its models, the other learners are one a model; what committees and "
        "promoters are worth by themselves is in the ablation. "
        "Gaussian processes: a bandit with the upper confidence bound for each note, which forgets when it is "
        "surprised, and when alone a Gaussian process from reading and action to feedback. It sees what the brain "
        "sees. “knows the language” obeys each note as it sounds and does anything when alone. No player but the "
        "brain has errors of a communication model.",
        summary(main_quantities(section.runs), "who"),
        _variants_figure(section, "Learners and players."),
        _failures(section.runs),
        "What a run took, on the machines that did these, as busy as they were:",
        markdown(["who", "seconds, median"], [[who, number(took)] for who, took in section.seconds.items()]),
    )


def memory(section: Section) -> str:
    """Teachers who return: obedience at each coming."""
    comings = comings_of(section.runs)
    return _paragraphs(
        comings_table(comings),
        section.figure(
            drawings.draw_comings(comings, section.stem),
            "Obedience at each coming of a teacher. Each seed thin, mean with its 95 % band.",
        ),
    )


def life(section: Section) -> str:
    """Phase by phase, what is captured of the ideal."""
    runs = section.runs
    phases = phases_of(runs)
    shares = [quantity(runs, SHARE, row.phase, phase_name(runs, row.phase)) for row in phases]
    variant = next(iter(runs))
    head = ["phase", "captures, share of ideal [95 %]", "median [95 %]", "worst (seed)", "below 90 % [95 %]"]
    rows = []
    for row, share in zip(phases, shares, strict=True):
        values = share.values[variant]
        below = sum(not value >= 0.9 for value in values)
        value, seed = share.worst(variant)
        cells = [interval(estimate(values, "mean"), percent), interval(estimate(values, "median"), percent)]
        failed = f"{below} of {len(values)}, {interval(wilson(below, len(values)), percent)}" if row.alone else ""
        rows.append([share.name, *cells, f"{text(value, percent)} ({seed})", failed])
    return _paragraphs(
        markdown(head, rows),
        section.figure(
            curves.draw_life(runs, section.stem),
            "A long life: captures as a share of the ideal, phase by phase. Each seed a dot; bar: 95 % interval of "
            "the mean; phases below 90 % of the ideal by their seed's number.",
        ),
        _failures(runs),
    )


def alone(section: Section) -> str:
    """The goal table, the failure rate, and all seeds."""
    seeds = next(iter(section.runs.values()))
    return _paragraphs(
        criteria_table(seeds),
        section.figure(
            curves.draw_seeds(section.runs, section.stem),
            "Every seed: captures as a share of its own ideal, those alone below 90 % by number. Band: 95 % interval "
            "of the mean.",
        ),
        "<details><summary>Every seed in numbers</summary>",
        seeds_table(seeds),
        "</details>",
    )


def ablation(section: Section) -> str:
    """Every measure under every variant."""
    quantities = all_quantities(section.runs)
    details = [part for q in quantities for part in (f"### {q.name}", quantity_table([q], "variant"))]
    return _paragraphs(
        summary(quantities),
        section.figure(
            drawings.draw_quantities(quantities, section.stem, "What each ingredient brings"),
            "What each ingredient brings. Each seed a dot; bar: 95 % interval.",
        ),
        *details,
    )


def readapt(section: Section) -> str:
    """Before, at and after a change of the body, as shares of what that body's ideal captures."""
    runs = section.runs
    shares = [quantity(runs, SHARE, row.phase, row.name) for row in phases_of(runs)[1:]]
    head = ["variant", *(f"{share.name}, median [95 %]" for share in shares), "after, worst (seed)"]
    rows = []
    for variant in runs:
        value, seed = shares[-1].worst(variant)
        cells = [interval(share.estimate(variant, "median"), percent) for share in shares]
        rows.append([variant, *cells, f"{text(value, percent)} ({seed})"])
    return _paragraphs(
        "Captures as a share of the ideal of the body as it then is. “Before”: the 100 iterations before the change, "
        "“at”: the 150 from it on, “after”: the 150 that follow. The ideal foresees each choice on the changed body, "
        "one action ahead.",
        markdown(head, rows),
        section.figure(
            curves.draw_readapt(section.own, section.stem),
            "A body that changes: captures in 50 iterations, mean of the seeds with its 95 % band; dashed: mean of "
            "the changed body's ideals; the lines mark the change and 150 iterations after it.",
        ),
    )


def machines(section: Section) -> str:
    """What each machine reached, its learning curve, and how it learnt."""
    return _paragraphs(
        "Each machine is taught by one scripted teacher and tried alone in turn. Competence is what it does alone, "
        "with learning on; the aim is for the median of the seeds.",
        machines_table(section.own),
        section.figure(
            draw_machines(section.own, section.stem),
            "Machines: competence alone over the iterations taught. Seeds thin, median thick; dashed: the aim.",
        ),
        *(
            section.figure(
                draw_learning(learning_of(what, seeds), section.named(OF[what].file)),
                f"{what}: what each episode brought, where it ended; the error of every model; episodes alone "
                "as they looked.",
            )
            for what, seeds in section.own.items()
        ),
    )


def learning_of(what: str, seeds: Mapping[int, Sequence[PhaseRow]]) -> Learning:
    """Return what is drawn of how a machine learnt."""
    machine = OF[what]
    scored = machine.score is not None
    return Learning(what, machine.measure, scored, list(seeds.values()), machine.target if scored else None)


def rivals(section: Section) -> str:
    """The same machines by others, to the same competence."""
    plain = without_reward(section.own)
    return _paragraphs(
        "“Ours” hears notes and feedback. The TAMER-like learner hears the feedback of the same teacher on the same "
        "schedule, and never a note: in TAMER nobody commands. It regresses feedback on what is sensed and done "
        "(scikit-learn's MLPRegressor), and does what promises most. Stable-Baselines3 has no teacher: it learns by "
        "the environment's reward, with its defaults, on the environment as Gymnasium makes it. It is DQN where "
        "actions are listed, else SAC; and PPO. Each of its actions is a step of the environment. Its training ends "
        f"when it was competent at {rewarded.LISTED.kept} checkpoints running.",
        f"These machines have no reward of their own: {', '.join(plain)}." if plain else "",
        "“Competent to the end”: from some trial on it was so at each. Actions of trials are not counted.",
        rivals_table(section.own),
    )


def _variants_figure(section: Section, caption: str) -> str:
    runs = section.runs
    quantities = figure_quantities(runs)
    drawn = drawings.draw_quantities(quantities, section.stem, caption.rstrip("."))
    return section.figure(drawn, f"{caption} Each seed a dot; bar: 95 % interval.")


def _failures(runs: Runs) -> str:
    """Return how many phases alone failed under each variant."""
    head = ["variant", "phases alone below 90 % of the ideal", "rate [95 %, Wilson]"]
    rows = []
    for variant, seeds in runs.items():
        count, of = failures(seeds)
        rows.append([variant, f"{count} of {of}", interval(wilson(count, of), percent)])
    return markdown(head, rows)


def _paragraphs(*parts: str) -> str:
    return "\n\n".join(part.strip("\n") for part in parts if part)


SECTIONS: dict[str, Callable[[Section], str]] = {
    "reproduction": reproduction,
    "paper": paper,
    "teachers": teachers,
    "learners": learners,
    "memory": memory,
    "life": life,
    "alone": alone,
    "ablation": ablation,
    "comings": memory,
    "readapt": readapt,
    "machines": machines,
    "rivals": rivals,
}
"""What is shown of each study, by its name."""
