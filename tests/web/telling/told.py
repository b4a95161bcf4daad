"""What tests of telling share: a run's messages, told one by one."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mdb_deploy.web.telling.story import Story
from mdb_protocol import messages as m
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_services.recorder import Recorded, read_log
from mdb_sim.runs.experiment import Experiment


def experiment_of(run: Path) -> Experiment:
    """The experiment of a run folder."""
    return Experiment.read(run / EXPERIMENT_FILE)


def log_of(run: Path) -> list[Recorded]:
    """The messages of a run, in order."""
    return list(read_log(run))


def story_of(run: Path) -> Story:
    """The story of a whole run."""
    story = Story(experiment_of(run), clock=None)
    for recorded in log_of(run):
        story.take(recorded.row, recorded.message)
    return story


def thoughts_of(run: Path) -> Iterator[tuple[dict[str, Any], m.IterationReport]]:
    """Each iteration's thought as it was told live, right after its report, with that report."""
    story = Story(experiment_of(run), clock=None)
    for recorded in log_of(run):
        story.take(recorded.row, recorded.message)
        if isinstance(recorded.message, m.IterationReport):
            yield checked(story.part("thought")), recorded.message


def checked(value: Any) -> Any:
    """The same value, once through JSON, which has no NaN."""
    return json.loads(json.dumps(value, allow_nan=False))
