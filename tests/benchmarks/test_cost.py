"""What a run, a brain, a start and a memory cost: of this checkout, and of an older one beside it, in one run.

Run by name: `MDB_BEFORE=/folder/of/the/older mdb test -m slow tests/benchmarks/test_cost.py -s`. Without `MDB_BEFORE`
only this one is measured. Both use this environment's packages, take turns, and each has compiled before it counts.
"""

import importlib.util
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import psutil
import pytest

from mdb_protocol import keys, messages
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.recorder import read_log
from tests.benchmarks.peers.contestant import ENTRIES
from tests.benchmarks.peers.match import CASES, Library
from tests.integration.brain import Brain, select_nothing, until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

HERE = Path(__file__).parents[2]
PARTS = ("protocol", "services", "sim", "deploy")
CHECKOUTS = {"before": Path(os.environ["MDB_BEFORE"])} if "MDB_BEFORE" in os.environ else {}
CHECKOUTS |= {"now": HERE}
ITERATIONS = 2000
RUNS = {
    "inline, kinematic": ("--inline", "--set", "robot.body=kinematic"),
    "lockstep, kinematic": ("--pace", "lockstep", "--set", "robot.body=kinematic"),
    "lockstep, PyBullet": ("--pace", "lockstep"),
}
OFTEN = 5
LONG = ("experiment.iterations=100000", "robot.action_s=0.125", "evolution.population=240", "evolution.generations=4")
COMPILED_S = 300.0
WATCHED_S = 10.0
BRAINS, CROWD = (4, 8, 12), ("experiment.iterations=100000", "robot.action_s=0.1")
GENERATIONS, TURNS = (6, 100), 15
"""In one call: as many as a memory version gets, and many."""
PAIRS = (400, 800, 1600, 3200)
INSERTS = """
import sys, time, numpy
from mdb_services.mechanism.memories.stm import MemoryConfig, ShortTermMemory
count, more = int(sys.argv[1]), 50
memory = ShortTermMemory(count, 6, 1, MemoryConfig(recency=0.5, distance=1.0, outcome=1.0))
rows, targets = (numpy.random.default_rng(0).uniform(-1, 1, (count + more, width)) for width in (6, 1))
times = []
for i in range(count + more):
    began = time.process_time()
    memory.insert(i, rows[i], targets[i], 0.0)
    times.append(time.process_time() - began)
print(1e3 * numpy.mean(times[-more:]))
"""

Found = dict[tuple[str, str], list[float]]
"""Numbers, by what was measured and of which checkout."""


@contextmanager
def of(checkout: str) -> Iterator[None]:
    """Processes that are started now are this checkout's."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(str(CHECKOUTS[checkout] / part) for part in PARTS)
    try:
        yield
    finally:
        os.environ.pop("PYTHONPATH")
        if before is not None:
            os.environ["PYTHONPATH"] = before


def taking_turns(times: int, measure: Callable[[], dict[str, float]]) -> Found:
    """Measure each checkout so many times, one after the other."""
    found: Found = {}
    for _ in range(times):
        for checkout in CHECKOUTS:
            with of(checkout):
                for what, number in measure().items():
                    found.setdefault((what, checkout), []).append(number)
    return found


def show(capsys: pytest.CaptureFixture[str], title: str, found: Found) -> None:
    """Print medians, and by what the older one's are multiplied."""
    lines = [f"\n{title}", f"| | {' | '.join(CHECKOUTS)} | now / before | worst now |", "|---|--:|--:|--:|--:|"]
    if len(CHECKOUTS) == 1:
        lines = [f"\n{title}", "| | now | worst now |", "|---|--:|--:|"]
    for what in dict.fromkeys(what for what, _ in found):
        medians = [float(np.median(found[what, checkout])) for checkout in CHECKOUTS]
        ratio = [f"{medians[1] / medians[0]:.2f}"] if len(medians) > 1 else []
        cells = [*(f"{median:.3g}" for median in medians), *ratio, f"{max(found[what, 'now']):.3g}"]
        lines.append(f"| {what} | {' | '.join(cells)} |")
    with capsys.disabled():
        os.write(1, ("\n".join(lines) + "\n").encode())


@pytest.mark.parametrize("name", RUNS)
def test_a_whole_run(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    def run(iterations: int = ITERATIONS) -> dict[str, float]:
        words = [
            "up",
            "paper",
            "--no-plot",
            "--iterations",
            str(iterations),
            "--seed",
            "201",
            "--runs",
            str(tmp_path),
        ]
        if "--inline" not in RUNS[name]:
            words += ["--listen", "tcp/127.0.0.1:0"]
        began_s, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-P", "-m", "mdb_deploy.cli", *words, *RUNS[name]]
        subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
        wall_s, after = time.perf_counter() - began_s, resource.getrusage(resource.RUSAGE_CHILDREN)
        busy_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return {f"{name}, wall": wall_s, f"{name}, processor": busy_s}

    taking_turns(1, lambda: run(20))
    show(capsys, f"seconds of {ITERATIONS} iterations", taking_turns(OFTEN, run))


def test_a_brain_and_its_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    number = iter(range(1000))

    def live() -> dict[str, float]:
        folder = tmp_path / str(next(number))
        folder.mkdir()
        began_s = time.perf_counter()
        with Brain(folder, *LONG) as brain, brain.bus() as bus:
            timings = bus.subscriber(keys.TIMING)
            until(lambda: _heard(bus, timings), COMPILED_S)
            start = {"start, s": time.perf_counter() - began_s, "start, s of processor": _busy_s(brain)}
            select_nothing(WATCHED_S / 2)
            before_s = _busy_s(brain)
            select_nothing(WATCHED_S)
            share = (_busy_s(brain) - before_s) / WATCHED_S
            memory = sum(process.memory_full_info().pss for process in _all_of(brain)) / 1e6
            back_s = _killed_and_back(brain, bus)
            bus.close()
        return start | {"share of a core": share, "memory (PSS), MB": memory, "evolver killed and back, s": back_s}

    taking_turns(1, live)
    show(capsys, "a brain of nine processes, 8 actions a second", taking_turns(OFTEN, live))


def _heard(bus: ZenohBus, timings: object) -> bool:
    bus.wait(0.05)
    return timings.take() is not None  # type: ignore[attr-defined]


def _all_of(brain: Brain) -> list[psutil.Process]:
    return [psutil.Process(brain.process.pid), *brain.children()]


def _busy_s(brain: Brain) -> float:
    """Return the processor time of all processes, the dead included."""
    times = [process.cpu_times() for process in _all_of(brain)]
    return sum(t.user + t.system for t in times) + times[0].children_user + times[0].children_system


def _killed_and_back(brain: Brain, bus: ZenohBus) -> float:
    status = brain.status(bus, "evolver", "communication")
    assert status is not None
    models = bus.subscriber(keys.CURRENT_MODEL, model="communication")
    os.kill(status.pid, signal.SIGKILL)
    began_s = time.perf_counter()
    until(lambda: not psutil.pid_exists(status.pid))
    while models.take() is not None:  # its last words
        pass
    until(lambda: _heard(bus, models))
    return time.perf_counter() - began_s


@pytest.mark.parametrize("brains", BRAINS)
def test_brains_beside_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str], brains: int) -> None:
    number = iter(range(10000))

    def live() -> dict[str, float]:
        with ExitStack() as stack:
            crowd = []
            for _ in range(brains):
                folder = tmp_path / str(next(number))
                folder.mkdir()
                crowd.append(stack.enter_context(Brain(folder, *CROWD)))
                until(lambda brain=crowd[-1]: "ready: optimizer" in brain.output(), COMPILED_S)
            select_nothing(2.0)
            began_s = time.time()
            select_nothing(WATCHED_S)
        times = [
            recorded.message.perception_to_action_s * 1e3
            for brain in crowd
            for recorded in read_log(brain.run)
            if isinstance(recorded.message, messages.Timing) and 0 <= recorded.time_s - began_s < WATCHED_S
        ]
        p50, p99 = np.percentile(times, [50, 99])
        return {"actions": len(times), "p50, ms": float(p50), "p99, ms": float(p99)}

    show(capsys, f"{brains} brains, 10 actions a second each, {WATCHED_S:g} s", taking_turns(1, live))


def test_a_generation(capsys: pytest.CaptureFixture[str]) -> None:
    core = [max(os.sched_getaffinity(0))]
    processes = {}
    for checkout in CHECKOUTS:
        with of(checkout):
            processes[checkout] = Library("numba", core)
    if importlib.util.find_spec("evosax"):
        processes["evosax"] = Library("evosax", core)
    lines = [f"\nms of a generation, one core; evosax is {ENTRIES['evosax+'].label}"]
    lines += [f"| | {' | '.join(processes)} |", "|---|" + "--:|" * len(processes)]
    try:
        for network, population, pairs in CASES:
            for who, process in processes.items():
                process.ask("load", name=_entry(who), network=network, population=population, pairs=pairs)
            for count in GENERATIONS:
                times: dict[str, list[float]] = {who: [] for who in processes}
                for _ in range(TURNS):
                    for who, process in processes.items():
                        spent_s = process.ask("sample", name=_entry(who), generations=count)[0]
                        times[who].append(spent_s / count * 1e3)
                medians = {who: float(np.median(found)) for who, found in times.items()}
                cells = [f"{ms:.3g} ({ms / medians['now']:.2f})" for ms in medians.values()]
                lines.append(f"| {network}, {population} x {pairs}, {count} in a call | {' | '.join(cells)} |")
    finally:
        for process in processes.values():
            process.close()
    with capsys.disabled():
        os.write(1, ("\n".join(lines) + "\nin brackets: times this checkout's\n").encode())


def _entry(who: str) -> str:
    return "evosax+" if who == "evosax" else "ours"


def test_inserts_take_linear_time(capsys: pytest.CaptureFixture[str]) -> None:
    def insert() -> dict[str, float]:
        found = {}
        for pairs in PAIRS:
            command = [sys.executable, "-P", "-c", INSERTS, str(pairs)]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            found[f"{pairs} pairs"] = float(done.stdout)
        return found

    found = taking_turns(OFTEN, insert)
    show(capsys, "ms of an insert into the short-term memory", found)
    first, last = (float(np.median(found[f"{pairs} pairs", "now"])) for pairs in (PAIRS[0], PAIRS[-1]))
    assert last / first < 2 * PAIRS[-1] / PAIRS[0]
