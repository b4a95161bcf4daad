"""What `mdb chaos` says in the end: recovery times by role, and whether anything that was acknowledged is lost.

Owns the bounds and the words, `chaos.md` and `chaos.json`. Pure but for writing these two.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from mdb_deploy.trials.evidence import Findings
from mdb_protocol import keys
from mdb_services.recorder import read_log

MEDIAN_S, P99_S = 1.5, 4.0
"""What recovery from a kill must not exceed."""
HANG_MEDIAN_S, HANG_P99_S = 4.0, 8.0
"""The same from a hang, which is noticed by silence only."""
BY_A_LOT = 2.0
"""Beyond the bounds times this the command fails: a loaded machine alone does not do it."""
BESIDE = "killed while another hung"
TOLD = 20
"""Damages that are named."""
ENDS = (0, 130)
"""Status of a brain that finished, or was interrupted by us."""


@dataclass
class Kill:
    """One kill and what came of it; times in seconds, `at_s` since the first iteration, the others since the kill."""

    role: str
    at_s: float
    iteration: int
    hang: bool = False
    """Whether it was stopped for good, not killed."""
    together: bool = False
    """Whether another was killed before this one had recovered."""
    beside_hang: bool = False
    """Whether another hung before this one had recovered, which then waits for that one, too."""
    token_s: float | None = None
    recovered_s: float | None = None


@dataclass(frozen=True)
class Row:
    """Recoveries of one role, in seconds; nan when there was none."""

    role: str
    kills: int
    median_s: float
    p99_s: float
    worst_s: float
    token_s: float
    """Median until its liveliness token was back."""

    @classmethod
    def by_role(cls, kills: Sequence[Kill]) -> list[Row]:
        """Return a row for each role."""
        return [cls.of(role, [k for k in kills if k.role == role]) for role in sorted({k.role for k in kills})]

    @classmethod
    def of(cls, role: str, kills: Sequence[Kill]) -> Row:
        """Return the row of these kills; one during which the experiment ended has no recovery."""
        took = [k.recovered_s for k in kills if k.recovered_s is not None] or [np.nan]
        token = [k.token_s for k in kills if k.token_s is not None] or [np.nan]
        median, p99, worst = np.percentile(took, [50, 99, 100])
        return cls(role, len(kills), float(median), float(p99), float(worst), float(np.median(token)))

    def quicker_than(self, median_s: float, p99_s: float) -> bool:
        """Whether recovery kept these bounds; where nobody died there was nothing to keep."""
        return not self.kills or (self.median_s < median_s and self.p99_s < p99_s)

    def line(self) -> str:
        """Return the row of a table in Markdown."""
        times = (self.median_s, self.p99_s, self.worst_s, self.token_s)
        return f"| {self.role} | {self.kills} | {' | '.join(f'{time_s:.2f}' for time_s in times)} |"


@dataclass(frozen=True)
class Report:
    """All that came of a run with kills."""

    run: Path
    kills: list[Kill]
    rows: list[Row]
    """Of those who were killed while nobody hung, by role."""
    total: Row
    findings: Findings
    iterations: int
    took_s: float
    status: int
    moved_alone: int
    """Actions of the robot while it had no commander, beyond the one under way."""
    logged: int
    """Iterations whose report is in the run's log, which can be read in spite of the kills."""
    loads: tuple[float, float]
    """Load average of the machine (1 min) before and after."""
    cores: int
    hung: list[Row] = field(default_factory=list)
    """Of those who hung, by role, and of those who were killed meanwhile."""
    hung_total: Row | None = None

    @classmethod
    def of(
        cls,
        kills: list[Kill],
        findings: Findings,
        *,
        run: Path,
        took_s: float,
        status: int,
        moved_alone: int,
        loads: tuple[float, float],
    ) -> Report:
        """Return the report; reads the run's log. MdbError when there is none that can be read."""
        logged = {r.message.iteration for r in read_log(run) if r.row is keys.ITERATION}  # type: ignore[attr-defined]
        hung = [kill for kill in kills if kill.hang]
        beside = [kill for kill in kills if kill.beside_hang and not kill.hang]
        killed = [kill for kill in kills if not kill.beside_hang and not kill.hang]
        return cls(
            run=run,
            kills=kills,
            rows=Row.by_role(killed),
            total=Row.of("all", killed),
            hung=[*Row.by_role(hung), *([Row.of(BESIDE, beside)] if beside else [])],
            hung_total=Row.of("all", [*hung, *beside]) if hung else None,
            findings=findings,
            iterations=findings.stored,
            took_s=took_s,
            status=status,
            moved_alone=moved_alone,
            logged=len(logged),
            loads=loads,
            cores=os.cpu_count() or 1,
        )

    @property
    def within_bounds(self) -> bool:
        """Whether recovery was as quick as promised."""
        return self._quicker_than(1.0)

    def _quicker_than(self, factor: float) -> bool:
        killed = self.total.quicker_than(MEDIAN_S * factor, P99_S * factor)
        hung = self.hung_total is None or self.hung_total.quicker_than(HANG_MEDIAN_S * factor, HANG_P99_S * factor)
        return killed and hung

    @property
    def holds(self) -> bool:
        """Whether nothing was lost, and recovery did not miss its bounds by a lot."""
        return self.findings.holds and not self.moved_alone and self.status in ENDS and self._quicker_than(BY_A_LOT)

    def markdown(self) -> str:
        """Return the report as it stands in `chaos.md`."""
        told, together = self.findings, sum(kill.together for kill in self.kills)
        hangs = sum(kill.hang for kill in self.kills)
        tables = table("killed", self.rows, self.total) if self.total.kills else []
        promised = recovery("recovery", self.total, MEDIAN_S, P99_S) if self.total.kills else []
        if self.hung_total is not None:
            tables += table("hung", self.hung, self.hung_total)
            promised += recovery("recovery from a hang", self.hung_total, HANG_MEDIAN_S, HANG_P99_S)
        return "\n".join(
            [
                f"{len(self.kills) - hangs} kills (SIGKILL)"
                + (f" and {hangs} hangs (SIGSTOP, for good)" if hangs else "")
                + f" in {self.took_s:.0f} s, {told.stored} iterations; {together} of "
                f"them while another process was down. Load of the machine: {self.loads[0]:.1f} before, "
                f"{self.loads[1]:.1f} after, on {self.cores} cores.",
                "",
                *tables,
                "| promise | found | |",
                "|---|--:|---|",
                f"| acknowledged pairs lost: 0 | {len(told.lost)} of {told.acknowledged} | "
                f"{yes(told.acknowledged > 0 and not told.lost)} |",
                f"| altered: 0 | {len(told.altered)} | {yes(not told.altered)} |",
                f"| counted twice: 0 | {len(told.doubled)} | {yes(not told.doubled)} |",
                f"| else damaged: 0 | {len(told.damaged)} | {yes(not told.damaged)} |",
                f"| actions without a commander: 0 | {self.moved_alone} | {yes(not self.moved_alone)} |",
                *promised,
                "",
                *([f"Damaged: {'; '.join(told.damaged[:TOLD])}.", ""] if told.damaged else []),
                f"Checked: {', '.join(f'{count} {what}' for what, count in told.checked.items()) or 'nothing'}. "
                f"Iterations that were never stored: {len(told.missing)}. Acknowledgements that the witness missed: "
                f"{told.stored - told.acknowledged + len(told.lost)}. Iterations whose report is in the run's log: "
                f"{self.logged} of {told.stored}; the rest happened while nobody recorded.",
            ]
        )


def table(what: str, rows: Sequence[Row], total: Row) -> list[str]:
    """Return the lines of a table of recoveries, with an empty one after it."""
    head = f"| {what} | times | recovery, s: median | p99 | worst | its token back: median |"
    return [head, "|---|--:|--:|--:|--:|--:|", *(row.line() for row in [*rows, total]), ""]


def recovery(what: str, total: Row, median_s: float, p99_s: float) -> list[str]:
    """Return what was promised of recoveries, and what was found."""
    return [
        f"| {what}, median < {median_s:g} s | {total.median_s:.2f} s | {yes(total.median_s < median_s)} |",
        f"| {what}, p99 < {p99_s:g} s | {total.p99_s:.2f} s | {yes(total.p99_s < p99_s)} |",
    ]


def yes(met: bool) -> str:
    """Return the word for a promise that was kept, or not."""
    return "yes" if met else "**no**"


def write_report(report: Report, out: Path) -> str:
    """Write `chaos.md` and `chaos.json` into a folder; return the text with their place."""
    text = report.markdown()
    (out / "chaos.md").write_text(text + "\n", encoding="utf-8")
    plain = asdict(report) | {"run": str(report.run), "holds": report.holds}
    (out / "chaos.json").write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
    return f"{text}\n\nresults: {out}"
