"""What `mdb chaos` says: its table, and when it fails; what its helpers take for granted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mdb_deploy.experiments import experiment_path
from mdb_deploy.supervision.compose import read
from mdb_deploy.trials.chaos import Commander, Pending
from mdb_deploy.trials.chaos_report import BY_A_LOT, HANG_MEDIAN_S, P99_S, Kill, Report, Row
from mdb_deploy.trials.evidence import Findings
from mdb_deploy.trials.soak import FIGURES, Soak
from mdb_deploy.trials.under_test import Member, long_experiment

CLEAN = Findings(acknowledged=900, stored=900, lost=[], altered=[], doubled=[], missing=[])


def kills(role: str, *recovered_s: float | None) -> list[Kill]:
    return [Kill(role, 1.0, 10, token_s=s, recovered_s=s) for s in recovered_s]


def report(*recovered_s: float | None, findings: Findings = CLEAN) -> Report:
    all_kills = kills("memory", *recovered_s)
    return Report(
        run=Path("run"),
        kills=all_kills,
        rows=[Row.of("memory", all_kills)],
        total=Row.of("all", all_kills),
        findings=findings,
        iterations=900,
        took_s=60.0,
        status=130,
        moved_alone=0,
        logged=890,
        loads=(1.0, 2.0),
        cores=2,
    )


def test_a_row_has_median_and_worst_of_the_recoveries_there_were() -> None:
    row = Row.of("memory", kills("memory", 1.0, 2.0, 3.0, None))
    assert (row.kills, row.median_s, row.worst_s) == (4, 2.0, 3.0)
    assert 2.9 < row.p99_s < 3.0
    assert np.isnan(Row.of("memory", kills("memory", None)).median_s)


def test_it_fails_when_something_is_lost_or_recovery_is_far_too_slow() -> None:
    assert report(0.5, 1.0).holds
    assert not report(0.5, 1.0, findings=replace(CLEAN, lost=[3])).holds
    assert not report(0.5, 1.0, findings=replace(CLEAN, doubled=[3])).holds
    assert not replace(report(0.5), moved_alone=1).holds
    assert not replace(report(0.5), status=2).holds
    assert not report(0.5, BY_A_LOT * P99_S + 1.0).holds


def test_a_recovery_somewhat_too_slow_is_said_and_fails_nothing() -> None:
    slow = report(0.5, 0.5, P99_S + 0.5)
    assert slow.holds
    assert not slow.within_bounds
    assert f"| recovery, p99 < {P99_S:g} s | 4.42 s | **no** |" in slow.markdown()
    assert "| acknowledged pairs lost: 0 | 0 of 900 | yes |" in slow.markdown()


ALL = frozenset({"router", "optimizer/action", "memory/store"})


def test_a_kill_is_recovered_when_token_and_then_iterations_are_back() -> None:
    pending = Pending(Kill("memory", 1.0, 10), "memory/store", killed_s=100.0)
    seen = [(100.1, ALL, 10), (100.2, ALL - {"memory/store"}, 15), (100.5, ALL, 16), (100.6, ALL, 17)]
    assert not any(pending.look(now_s, alive, ALL, iteration) for now_s, alive, iteration in seen)
    assert pending.look(100.7, ALL, ALL, 18)
    assert (pending.kill.token_s, pending.kill.recovered_s) == (pytest.approx(0.5), pytest.approx(0.7))


def test_a_successor_that_came_between_two_looks_is_seen_though_the_token_was_never_missed() -> None:
    pending = Pending(Kill("memory", 1.0, 10), "memory/store", killed_s=100.0)
    assert not pending.look(100.1, ALL, ALL, 15)
    assert not pending.look(100.2, ALL, ALL, 16, replaced=True)
    assert not pending.look(100.3, ALL, ALL, 16)
    assert pending.look(100.4, ALL, ALL, 18)
    assert (pending.kill.token_s, pending.kill.recovered_s) == (pytest.approx(0.3), pytest.approx(0.4))


def test_the_router_is_back_when_everybody_is() -> None:
    pending = Pending(Kill("router", 1.0, 10), "router", killed_s=100.0)
    for now_s, alive in ((100.1, frozenset[str]()), (100.4, ALL - {"memory/store"}), (100.6, ALL)):
        pending.look(now_s, alive, ALL, 12)
    assert pending.kill.token_s == pytest.approx(0.6)


def test_what_the_robot_does_without_a_commander_is_counted_but_for_the_action_under_way() -> None:
    commander, gone = Commander(), ALL - {"optimizer/action"}
    for now_s, alive, acted in (
        (0.0, ALL, 5),
        (0.1, gone, 5),
        (0.2, gone, 6),
        (0.4, gone, 6),
        (0.5, ALL, 6),
        (0.6, ALL, 9),
    ):
        commander.look(now_s, alive, "optimizer/action", acted)
    assert commander.moved == 0
    for now_s, acted in ((1.0, 9), (1.3, 10), (1.4, 11), (1.5, 12)):
        commander.look(now_s, gone, "optimizer/action", acted)
    assert commander.moved == 2


def test_growth_is_the_last_fifth_over_the_second() -> None:
    filling = np.array([1.0, 5.0, 10.0, 10.0, 10.0, 10.0, 10.0, 10.0, 11.0, 11.0])
    flat = dict.fromkeys(FIGURES, np.ones(10))
    times = np.arange(10.0)
    soak = Soak(times, times, {"memory": flat | {"memory": filling}, "robot": flat}, CLEAN, (0.0, 0.0))
    assert soak.growth("memory", "memory") == pytest.approx(0.1)
    assert soak.worst == pytest.approx(0.1)
    assert not soak.holds
    assert Soak(times, times, {"robot": flat}, CLEAN, (0.0, 0.0)).holds


def test_the_phases_of_a_long_experiment_come_again_in_order() -> None:
    long = long_experiment(experiment_path("paper"), ["experiment.iterations=1200"], 3000)
    assert long.brain.experiment.iterations == 3600
    assert long.teacher is not None
    assert [(phase.start, phase.name) for phase in long.teacher.phase][2:5] == [
        (1000, "second teacher"), (1200, "first teacher"), (1700, "alone"),
    ]  # fmt: skip


def test_a_long_experiment_finds_the_body_that_lies_beside_its_file(tmp_path: Path) -> None:
    for name in ("paper.toml", "own_body.py"):
        (tmp_path / name).write_text(experiment_path("paper").read_text() if name.endswith(".toml") else "")
    long = long_experiment(tmp_path / "paper.toml", ['robot.body="own_body:Body"'], 3000)
    assert long.brain.experiment.folder == str(tmp_path)


def test_a_process_is_known_by_its_command_line() -> None:
    members = {spec.name: Member.of(spec) for spec in read().values()}
    command = ["python", "-m", "mdb_deploy.cli", "run", "evolver", "--model", "object", "--run", "/run"]
    assert [name for name, member in members.items() if member.is_it(command)] == ["evolver-object"]
    assert not any(member.is_it(["python", "-c", "pass"]) for member in members.values())


def test_hangs_have_a_table_and_bounds_of_their_own() -> None:
    hung = [replace(kill, hang=True) for kill in kills("robot", HANG_MEDIAN_S - 1.0, HANG_MEDIAN_S - 0.5)]
    both = replace(
        report(0.5), kills=[*kills("memory", 0.5), *hung], hung=Row.by_role(hung), hung_total=Row.of("all", hung)
    )
    assert both.holds
    assert both.within_bounds
    assert "| recovery from a hang, median < 4 s | 3.25 s | yes |" in both.markdown()
    assert "| robot | 2 | 3.25 |" in both.markdown()
    assert "1 kills (SIGKILL) and 2 hangs (SIGSTOP, for good)" in both.markdown()
    slow = kills("robot", BY_A_LOT * HANG_MEDIAN_S + 1.0)
    assert not replace(both, hung_total=Row.of("all", slow)).holds


def test_of_hangs_alone_only_their_bounds_count() -> None:
    hung = [replace(kill, hang=True) for kill in kills("robot", 2.5)]
    alone = replace(report(), kills=hung, rows=[], hung=Row.by_role(hung), hung_total=Row.of("all", hung))
    assert alone.holds
    assert "killed" not in alone.markdown()
