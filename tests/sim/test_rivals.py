"""Machines learnt by others: a TAMER-like learner from the same teacher, Stable-Baselines3 from the reward."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mdb_deploy.experiments import experiment_path
from mdb_protocol.errors import ConfigError, MdbError
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.record import RunRecord
from mdb_sim.studies import machines, results
from mdb_sim.studies.machines import BY_FILE, BY_REWARD, MACHINES, PLAYERS, settings_of
from mdb_sim.studies.players import baselines, rewarded
from mdb_sim.studies.players.rewarded import Budget
from mdb_sim.studies.players.tamer import TamerPlayer
from mdb_sim.studies.rows import PhaseRow, rows_of
from mdb_sim.verdicts.machines import curve
from mdb_sim.verdicts.rivals import rivals_table, without_reward
from tests.sim.phases import label, phase

pytest.importorskip("gymnasium")
CARTPOLE, PENDULUM = BY_FILE["cartpole"], BY_FILE["pendulum"]
SHORT = (
    "experiment.seed=5212",
    "experiment.pace=lockstep",
    "experiment.iterations=60",
    "optimizer.random_iterations=20",
    'teacher.phase=[{start=0, name="taught", teacher="one", language="ordered"}, {start=50, name="alone"}]',
)


def machine(name: str, *overrides: str) -> Experiment:
    return Experiment.read(experiment_path(name), (*SHORT, *overrides))


def tamer(run: Path, name: str, *overrides: str) -> RunRecord:
    pytest.importorskip("sklearn", reason="needs the bench extra")
    return baselines.play(machine(name, *overrides), "tamer", run)


# ---- by a teacher's feedback ----


def test_a_pole_is_balanced_alone_after_200_judgements(tmp_path: Path) -> None:
    phases = 'teacher.phase=[{start=0, name="taught", teacher="one", language="random"}, {start=200, name="alone"}]'
    rows = rows_of(tamer(tmp_path / "run", "cartpole", "experiment.iterations=1200", phases))
    assert (rows[0].judgements, rows[1].judgements) == (200.0, 0.0)
    assert len(rows[1].scores) > 0
    assert curve(CARTPOLE, rows).needed(CARTPOLE.target) == 200.0


def test_what_the_notes_are_is_nothing_to_it(tmp_path: Path) -> None:
    other = tuple(each.replace("ordered", "reversed") for each in SHORT)
    one, another = tamer(tmp_path / "one", "cartpole"), tamer(tmp_path / "other", "cartpole", *other)
    assert (one.note[:50] != another.note[:50]).any()
    np.testing.assert_array_equal(one.choice, another.choice)


def test_in_a_range_it_searches_and_one_seed_is_one_run(tmp_path: Path) -> None:
    one, same = (tamer(tmp_path / name, "pendulum") for name in ("one", "same"))
    torques = [one.reports[i].action["torque"] for i in range(60)]
    assert torques == [same.reports[i].action["torque"] for i in range(60)]
    assert min(torques) >= -2.0
    assert max(torques) <= 2.0
    assert len(set(torques[20:])) > 5, "beside those of the forced exploration"
    assert (one.choice == -1).all()


def test_feedback_that_comes_late_is_learnt_of_its_own_action() -> None:
    pytest.importorskip("sklearn", reason="needs the bench extra")
    experiment = machine("cartpole")
    player = TamerPlayer(experiment, experiment.schedule())
    upright = {"x": 0.0, "x_speed": 0.0, "angle": 0.0, "angle_speed": 0.0}
    left, right = ({"motor": value} for value in (0.0, 1.0))
    alone = 55
    for iteration in range(40):
        # Of each two actions the second is judged first.
        player.did(iteration, upright, None, left if iteration % 2 else right)
        if iteration % 2:
            player.learn(iteration, -1.0)
            player.learn(iteration - 1, 1.0)
    assert player.act(alone, upright, 0, {}) == right
    player.learn(7, 1.0)  # nothing is known of it any more
    player.did(41, {}, None, left)
    player.learn(41, 1.0)  # nothing was sensed
    assert player.act(alone, upright, None, {}) == right


def test_without_scikit_learn_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "sklearn.neural_network", None)
    with pytest.raises(MdbError, match=r"needs scikit-learn; run pip install 'multilevel-darwinist-brain\[bench\]'"):
        baselines.play(machine("cartpole"), "tamer", tmp_path / "run")


def test_who_chooses_among_choices_says_so_where_there_are_none(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"'ideal' chooses among \[\[choice\]\] entries; .* one of random, tamer"):
        baselines.play(machine("pendulum"), "ideal", tmp_path / "run")


# ---- by a reward ----


def test_it_is_trained_and_tried_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("stable_baselines3", reason="needs the bench extra")
    for name, player, aim in (
        ("cartpole", "dqn-or-sac", 1e9),
        ("pendulum", "dqn-or-sac", 1e9),
        ("cartpole", "ppo", 0),
    ):
        monkeypatch.setitem(BY_FILE, name, replace(BY_FILE[name], target=aim))
        rows = rewarded.trained(machine(name), player, Budget(steps=400, checkpoints=4, episodes=2, kept=2))
        trials = 2 if aim == 0 else 4  # who is competent twice running is trained no longer
        assert [(row.start, row.stop) for row in rows if not row.alone] == [
            (n * 100, n * 100 + 100) for n in range(trials)
        ]
        assert [len(row.scores) for row in rows] == [0, 2] * trials
        assert all(row.scores.max() < 0 if name == "pendulum" else row.scores.min() >= 1 for row in rows if row.alone)
        made = results.decode(results.encode(label(), rows)).rows
        assert curve(BY_FILE[name], made).taught == tuple(range(100, 100 * trials + 1, 100))


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(MdbError, match=r"extra `bench` .* PyTorch's CPU build first, then pip install"):
        rewarded.trained(machine("cartpole"))


def test_what_has_no_reward_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"car has no reward of its own; .* cartpole, mountaincar"):
        rewarded.trained(machine("car"))


# ---- the study ----


def test_who_learns_by_reward_is_tried_where_there_is_one() -> None:
    files = {each.file: Experiment.read(experiment_path(each.file), settings_of(each)) for each in MACHINES}
    assert {name for name, file in files.items() if file.robot.body == "gymnasium"} == {
        each.file for each in MACHINES if each.rewarded
    }
    found = machines.rivals(files["paper"])
    assert len(found) == len(MACHINES) * len(PLAYERS)
    left_out = [variant for variant in found if not variant.applies]
    assert len(left_out) == len(BY_REWARD) * sum(not each.rewarded for each in MACHINES)
    known = {*baselines.PLAYERS, *rewarded.PLAYERS, "brain"}
    assert {variant.player for variant in found} <= known


def test_the_table_says_what_was_needed_and_what_was_not_reached() -> None:
    def run(seed: int, *scores: float, judgements: float, repeat: int = 1) -> tuple[PhaseRow, ...]:
        rows = []
        for place, score in enumerate(scores):
            taught = phase(seed, 0, start=place * 100, stop=place * 100 + 100, judgements=judgements, repeat=repeat)
            rows += [taught, phase(seed, 1, scores=np.array([score], np.float32), judgements=0.0, repeat=repeat)]
        return tuple(rows)

    by_reward = next(iter(BY_REWARD))
    table = rivals_table(
        {
            "CartPole-v1: ours": {1: run(1, 100, 500, 490, judgements=90), 2: run(2, 500, 100, 480, judgements=90)},
            f"CartPole-v1: {by_reward}": {1: run(1, 500, 400, 450, judgements=0)},
            "Pendulum-v1, a torque in a range: TAMER-like": {1: run(1, -200, -100, judgements=100, repeat=2)},
        }
    )
    ours, reward, held = (line.split(" | ") for line in table.splitlines()[2:])
    assert ours[3:] == ["485 (480)", "2 of 2", "250 (300)", "225", "150 |"]
    assert reward[3:] == ["450 (450)", "0 of 1", "not within 300", "none", "100 |"]
    assert held[3:] == ["-100 (-100)", "1 of 1", "100, 200 steps (100, 200 steps)", "100", "100, 200 steps |"]
    assert without_reward({"CartPole-v1: ours": {}, "Pioneer 2 avoids it: ours": {}}) == ["Pioneer 2 avoids it"]
