"""What is told of beliefs is what the models say, and after lessons it is what the teacher means."""

from pathlib import Path

import numpy as np
import pytest

from mdb_deploy.experiments import experiment_path
from mdb_deploy.web.telling.beliefs import MOST_POINTS, SIDE
from mdb_deploy.web.telling.plan import Plan
from mdb_deploy.web.telling.story import Story
from mdb_protocol import messages as m
from mdb_services.mechanism.memories.stm import Change, MemoryMirror
from mdb_services.mechanism.networks.network import Network
from mdb_sim.runs.experiment import Experiment
from tests.web.telling.conftest import Made
from tests.web.telling.told import checked, experiment_of, log_of, story_of


def test_after_lessons_it_believes_what_the_teacher_means(run_of: Made) -> None:
    run = run_of("paper", "robot.body=kinematic", "experiment.iterations=170", "optimizer.random_iterations=100")
    story = story_of(run)
    told, language = checked(story.part("beliefs")), story.plan.languages["one"]
    assert told["actions"] == ["right 90", "right 45", "right 20", "ahead", "left 20", "left 45", "left 90"]
    assert told["notes"] == [0, 1, 2, 3, 4, 5, 6]
    believed = [told["choices"][int(np.argmax(row))] for row in told["feedback"]]
    meant = [language.command(note) for note in range(7)]  # a command of the paper's is a choice
    assert sum(a == b for a, b in zip(believed, meant, strict=True)) >= 6
    tried = np.array(told["support"])
    assert tried.shape == (7, 7)
    assert (tried > 0.99).sum() >= 30


def test_each_belief_is_the_networks_own(pioneer: Path) -> None:
    story, plan = story_of(pioneer), Plan(experiment_of(pioneer))
    told = story.part("beliefs")
    newest = [
        each.message
        for each in log_of(pioneer)
        if isinstance(each.message, m.CurrentModel) and each.message.model == "communication"
    ][-1]
    network, book = Network.from_arrays(newest.layers, newest.weights), plan.books["communication"]
    for note, row in enumerate(told["feedback"]):
        for choice, feedback in zip(told["choices"], row, strict=True):
            inputs = book.input_rows({"note": np.array([float(note)]), "action": np.array([float(choice)])})
            assert inputs is not None
            assert feedback == pytest.approx(float(network.predict(inputs)[0, 0]), abs=1e-3)


def test_the_picture_of_the_satisfaction_model_is_the_networks_own(pioneer: Path) -> None:
    story, plan = story_of(pioneer), Plan(experiment_of(pioneer))
    told = checked(story.part("induced"))
    assert (told["model"], told["x"]["name"], told["y"]["name"]) == ("induced", "covered.distance", "next.angle")
    assert told["fixed"] == {}
    newest = [
        each.message
        for each in log_of(pioneer)
        if isinstance(each.message, m.CurrentModel) and each.message.model == "induced"
    ][-1]
    network, book = Network.from_arrays(newest.layers, newest.weights), plan.books["induced"]
    x, y = np.meshgrid(told["x"]["values"], told["y"]["values"])
    rows = book.input_rows({"covered.distance": x.ravel(), "next.angle": y.ravel()})
    assert rows is not None
    assert np.array(told["z"]).shape == (SIDE, SIDE)
    assert np.array(told["z"]).ravel() == pytest.approx(network.predict(rows)[:, 0], abs=5e-3)


def test_the_points_are_the_pairs_that_it_has_learnt(pioneer: Path) -> None:
    """In their own units, as they were when they came."""
    told = story_of(pioneer).part("induced")
    pairs = [e.message for e in log_of(pioneer) if isinstance(e.message, m.Pair) and e.message.feedback is not None]
    covered = [
        p.before["distance"] - p.after["distance"] for p in pairs if {"distance"} <= set(p.before) & set(p.after)
    ]
    assert 30 <= len(told["points"]) <= MOST_POINTS
    for x, _, feedback in told["points"]:
        assert -1 <= feedback <= 1
        assert min(abs(np.clip(each, -0.375, 0.375) - x) for each in covered) < 1e-3


def test_memories_are_told_as_the_evolvers_have_them(pioneer: Path) -> None:
    story, plan = story_of(pioneer), Plan(experiment_of(pioneer))
    for section in plan.brain.model:
        book = plan.books[section.name]
        mirror = MemoryMirror(section.capacity, book.width, book.output_width)
        for each in log_of(pioneer):
            if isinstance(each.message, m.MemoryChange) and each.message.model == section.name:
                c = each.message
                of = (tuple(array.tolist()) for array in (c.slots, c.pairs, c.evicted, c.freed))
                slots, ids, evicted, freed = of
                mirror.apply(Change(c.version, slots, ids, evicted, freed), c.inputs, c.targets)
        told = checked(story.part(f"memory/{section.name}"))
        assert (told["version"], told["used"], told["capacity"]) == (mirror.version, len(mirror), section.capacity)
        inputs, targets, ids_held = mirror.arrays()
        held = {pair["pair"]: pair for pair in told["pairs"]}
        assert set(held) == set(ids_held.tolist())
        for place, pair in enumerate(ids_held.tolist()):
            assert held[pair]["slot"] == mirror.slots[place]
            assert held[pair]["inputs"] == pytest.approx(inputs[place], abs=1e-3)
            assert held[pair]["targets"] == pytest.approx(targets[place], abs=1e-3)
            assert held[pair]["age"] == 79 - pair


def test_networks_are_told_with_their_silent_units(pioneer: Path) -> None:
    story = story_of(pioneer)
    told = checked(story.part("models/communication"))
    inputs, hidden, outputs = told["layers"]
    assert (inputs, outputs, told["expressed"], told["expressed"] + told["silent"]) == (8, 1, hidden, 16)
    assert [np.array(layer).shape for layer in told["weights"]] == [(hidden, 9), (1, hidden + 1)]


def test_without_notes_there_are_no_beliefs_and_no_commands() -> None:
    content = Experiment.read(experiment_path("paper"), ["robot.body=kinematic"]).content
    del content["teacher"], content["channels"]["note"]
    content["model"] = [model for model in content["model"] if "note" not in model["inputs"]]
    content["mode"] = [mode for mode in content["mode"] if mode["world"] != "communication"]
    story = Story(Experiment(content, "test"), clock=None)
    assert story.part("beliefs") is None
    assert story.part("thought") is None
    assert story.parts({}) == {}
