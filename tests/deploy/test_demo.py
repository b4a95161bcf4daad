"""The demonstration shows what the README's first sentence says, with the paper's robot and models."""

from pathlib import Path
from typing import Any

from mdb_deploy.experiments import default_experiment, experiment_path
from mdb_services.experiment.reading import read_file
from mdb_sim.runs import measures
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from mdb_sim.runs.record import read_record
from mdb_sim.studies.ideal import ideal_successes

SECONDS = 120
"""So long it takes, without its start."""


def without_its_own(content: dict[str, Any]) -> dict[str, Any]:
    """An experiment without what makes a demonstration of it."""
    for section, name in (("experiment", "name"), ("experiment", "iterations"), ("optimizer", "random_iterations")):
        del content[section][name]
    content["robot"].pop("action_s", None)
    del content["teacher"]["phase"]
    return content


def test_it_is_the_papers_experiment_in_two_minutes(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    demo, paper = read_file(experiment_path(default_experiment())), read_file(experiment_path("paper"))
    assert demo["experiment"]["iterations"] * demo["robot"]["action_s"] == SECONDS
    assert without_its_own(demo) == without_its_own(paper)


def test_teachers_come_and_leave_and_the_robot_goes_on_alone(tmp_path: Path) -> None:
    settings = ["robot.body=kinematic", "experiment.pace=lockstep", "experiment.seed=21"]
    run_experiment(Experiment.read(experiment_path("demo"), settings), tmp_path)
    record = read_record(tmp_path)
    assert [span.teacher for span in record.spans] == ["teacher-1", None, "teacher-2", None]
    languages = [span.language.notes for span in record.taught if span.language]
    assert len({*languages}) == 2, "each has a language of his own"
    for span in record.spans:
        if span.teacher is not None:
            assert measures.obedience(record, measures.obedience_window(span)) >= 0.9, span.name
        else:
            window = measures.success_window(record, span)
            assert measures.successes(record, window) >= 0.85 * ideal_successes(record, window), span.name
