"""`mdb chaos`: kills or stops random processes of a brain at work, at random times, and measures what comes of it.

Owns who is killed (SIGKILL) or made to hang (SIGSTOP, for good) when, and how a recovery is timed: from then until
the process's successor has its liveliness token (the router's: until everybody's token is back) and after that
`ITERATIONS` more iterations have been reported. What is said of it is in `chaos_report`.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import structlog

from mdb_deploy.supervision.compose import OPTIMIZER, ROUTER, for_experiment, read
from mdb_deploy.supervision.runner import QUICK_DEATHS, QUICK_S
from mdb_deploy.trials.chaos_report import Kill, Report, write_report
from mdb_deploy.trials.evidence import compare
from mdb_deploy.trials.under_test import POLL_S, BrainError, BrainUnderTest, long_experiment, stop_on_sigterm
from mdb_protocol.errors import ConfigError
from mdb_services.experiment.run_folder import MEMORY_FILE
from mdb_sim.runs.experiment import Experiment

ITERATIONS = 2
"""So many new iterations say that the brain is at work again; the first may have been under way at the kill."""
TOGETHER = 0.2
"""How often a second process is killed before the first has recovered ..."""
TOGETHER_S = 0.5
"""... at most this much later."""
ITERATIONS_A_KILL = 500
"""More of an experiment than a kill and a slow recovery take at full speed: it is interrupted after the last one."""
ITERATIONS_A_HANG = 2500
"""So many more for one that hangs: some of them hold up nobody until they are replaced."""
ALONE_S = 0.2
"""What the robot shows for so long after its commander's token is gone may have been under way."""
GROWN_S = QUICK_S + 1.0
"""A process of this age does not die quickly, by its runner's clock either."""
YOUNG_KILLS = 2
"""So many times in a row one may be killed at a younger age; its runner gives up at `QUICK_DEATHS`."""
END_S = 120.0
assert YOUNG_KILLS < QUICK_DEATHS - 1


@dataclass(frozen=True)
class ChaosOptions:
    """What the command line says of `mdb chaos`."""

    experiment: Path
    overrides: tuple[str, ...]
    out: Path
    kills: int = 300
    seed: int = 1
    roles: tuple[str, ...] = ()
    """Names of the process table; none: all."""
    bound_s: float = 20.0
    """A kill from which the brain has not recovered after this ends the run."""
    pause_s: float = 1.0
    """Between a recovery and the next kill, at most."""
    to_the_end: bool = False
    """Whether the experiment is as long as its file says, and is run to its end."""
    hangs: float = 0.0
    """The share of kills that are hangs instead."""


@dataclass
class Pending:
    """A kill that is being watched."""

    kill: Kill
    token: str
    killed_s: float
    pid: int = 0
    gone: bool = False
    iteration: int = 0

    def look(
        self,
        now_s: float,
        alive: frozenset[str],
        everybody: frozenset[str],
        iteration: int,
        *,
        replaced: bool = False,
    ) -> bool:
        """Follow what is seen now; return whether the brain has recovered from this kill.

        `replaced`: there is a successor already. A token that was away for a moment only may not have been missed.
        """
        back = alive >= everybody if self.token == ROUTER else self.token in alive
        if not self.gone:
            self.gone = replaced or not back
        elif self.kill.token_s is None and back:
            self.kill.token_s, self.iteration = now_s - self.killed_s, iteration
        elif self.kill.token_s is not None and iteration >= self.iteration + ITERATIONS:
            self.kill.recovered_s = now_s - self.killed_s
        return self.kill.recovered_s is not None


@dataclass
class Commander:
    """Watches that the robot does nothing while nobody commands it; the action that was under way is not counted."""

    moved: int = 0
    _gone_s: float | None = None
    _acted: int | None = None

    def look(self, now_s: float, alive: frozenset[str], token: str, acted: int) -> None:
        """Follow what is seen now; without the router nobody can tell."""
        if token in alive or ROUTER not in alive:
            self._gone_s = self._acted = None
        elif self._gone_s is None:
            self._gone_s = now_s
        elif now_s - self._gone_s > ALONE_S:
            self.moved += max(0, acted - self._acted) if self._acted is not None else 0
            self._acted = acted


@dataclass
class Chaos:
    """Kills processes of one brain; `rng` says whom and when."""

    brain: BrainUnderTest
    options: ChaosOptions
    rng: np.random.Generator
    began_s: float = field(default_factory=time.monotonic)
    kills: list[Kill] = field(default_factory=list)
    commander: Commander = field(default_factory=Commander)
    _pending: list[Pending] = field(default_factory=list)
    _young: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        members = self.brain.members
        self._roles = self.options.roles or tuple(members)
        self._everybody = frozenset(member.token for member in members.values())

    def go(self, say: Callable[[str], None]) -> None:
        """Do all kills, each after the recovery from the one before; BrainError when there is none in time."""
        while len(self.kills) < self.options.kills and not self.brain.finished:
            self._watch(until_s=time.monotonic() + float(self.rng.uniform(0.0, self.options.pause_s)))
            before = len(self.kills)
            self._round()
            for number, kill in enumerate(self.kills[before:], before + 1):
                took = "the experiment ended" if kill.recovered_s is None else f"{kill.recovered_s:.2f} s"
                say(f"{number:4d}  {kill.role:22s} {'hung    ' if kill.hang else ''}{took}")

    def _round(self) -> None:
        """Kill one process, or two in a row, and wait until the brain has recovered from that."""
        left = self.options.kills - len(self.kills)
        if not self._kill():
            return
        if left > 1 and self.rng.random() < TOGETHER:
            self._watch(until_s=time.monotonic() + float(self.rng.uniform(0.0, TOGETHER_S)))
            self._kill()
        deadline = time.monotonic() + self.options.bound_s
        while self._pending and not self.brain.finished:
            if time.monotonic() > deadline:
                roles = ", ".join(pending.kill.role for pending in self._pending)
                raise BrainError(
                    f"not recovered from the death or hang of {roles} within {self.options.bound_s:g} s. "
                    f"{self.brain.last_words()}"
                )
            self._look()
        self._pending.clear()

    def _watch(self, until_s: float) -> None:
        while time.monotonic() < until_s and not self.brain.finished:
            self._look()

    def _look(self) -> None:
        alive = self.brain.look()
        self.brain.check_alive()
        now_s, iteration = time.monotonic(), self.brain.iteration
        self.commander.look(now_s, alive, self.brain.members[OPTIMIZER].token, self.brain.acted)
        waiting = [p for p in self._pending if not p.gone and p.token != ROUTER]
        processes = self.brain.processes() if waiting else {}
        replaced = [p for p in waiting if p.kill.role in processes and processes[p.kill.role].pid != p.pid]
        seen = now_s, alive, self._everybody, iteration
        self._pending = [p for p in self._pending if not p.look(*seen, replaced=p in replaced)]
        time.sleep(POLL_S)

    def _kill(self) -> bool:
        """Kill one of those who may die now, or make it hang; return whether there was one."""
        processes = self.brain.processes()
        ages_s = {name: time.time() - process.create_time() for name, process in processes.items()}
        may = [name for name in self._roles if name in ages_s and self._may_die(name, ages_s[name])]
        if not may:
            self._look()
            return False
        role = str(self.rng.choice(may))
        self._young[role] = self._young.get(role, 0) + 1 if ages_s[role] < GROWN_S else 0
        hang = self.options.hangs > 0 and self.rng.random() < self.options.hangs
        killed_s = time.monotonic()
        processes[role].send_signal(signal.SIGSTOP if hang else signal.SIGKILL)
        kill = Kill(role, killed_s - self.began_s, self.brain.iteration, hang=hang)
        self.kills.append(kill)
        self._pending.append(Pending(kill, self.brain.members[role].token, killed_s, processes[role].pid))
        for pending in self._pending:
            pending.kill.together = len(self._pending) > 1
            pending.kill.beside_hang |= any(other.kill.hang for other in self._pending if other is not pending)
        return True

    def _may_die(self, role: str, age_s: float) -> bool:
        """Whether its runner will not take a kill for one more of many quick deaths, after which it gives up."""
        watched = any(pending.kill.role == role for pending in self._pending)
        return not watched and (age_s >= GROWN_S or self._young.get(role, 0) < YOUNG_KILLS)


def experiment_of(options: ChaosOptions) -> Experiment:
    """Return the experiment that is run: long enough for the kills, or as its file says."""
    if options.to_the_end:
        return Experiment.read(options.experiment, options.overrides)
    iterations = options.kills * (ITERATIONS_A_KILL + options.hangs * ITERATIONS_A_HANG)
    return long_experiment(options.experiment, options.overrides, round(iterations))


def run(options: ChaosOptions, say: Callable[[str], None]) -> Report:
    """Run a brain with its kills; return what came of it. BrainError when it does not survive."""
    load_before, experiment = os.getloadavg()[0], experiment_of(options)
    members = for_experiment(read(), experiment)
    if unknown := sorted(set(options.roles) - set(members)):
        raise ConfigError(f"--roles names {', '.join(unknown)}; this experiment has {', '.join(members)}")
    with BrainUnderTest(experiment, options.out) as brain:
        say(f"killing {options.kills} processes of {brain.run}, of which {options.hangs:.0%} are to hang")
        chaos = Chaos(brain, options, np.random.default_rng(options.seed))
        chaos.go(say)
        if not brain.finished and not options.to_the_end:
            brain.wait_for_iterations(ITERATIONS, options.bound_s)
        took_s = time.monotonic() - chaos.began_s
        status = brain.finish(interrupt=not options.to_the_end, bound_s=END_S)
        return Report.of(
            chaos.kills,
            compare(brain.witness_file, brain.run / MEMORY_FILE),
            run=brain.run,
            took_s=took_s,
            status=status,
            moved_alone=chaos.commander.moved,
            loads=(load_before, os.getloadavg()[0]),
        )


def command(options: ChaosOptions) -> int:
    """Do as `mdb chaos` says: kill, compare, write the report; status 1 when a promise was broken."""

    def say(text: str) -> None:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()

    stop_on_sigterm()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger("warning"))  # every cut log would be told
    report = run(options, say)
    say("")
    say(write_report(report, options.out))
    return 0 if report.holds else 1
