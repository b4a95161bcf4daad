"""The teacher over the wire in protocol/README.md, run as it stands there: no scripted teacher is in the brain."""

import re
import subprocess
import sys
from pathlib import Path

import tomli_w

from mdb_deploy.experiments import experiment_path
from mdb_protocol import keys, messages
from mdb_sim.runs.experiment import Experiment
from tests.integration.brain import Brain, until

README = Path(__file__).parents[2] / "protocol" / "README.md"
SETTINGS = ("robot.body=kinematic", "experiment.iterations=100000", "optimizer.feedback_patience_s=0.05")


def example(endpoint: str) -> str:
    """Return the page's Python block that teaches, with the router of this test."""
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    (code,) = (block for block in blocks if "mdb_protocol" in block)
    assert "tcp/127.0.0.1:7447" in code
    return str(code.replace("tcp/127.0.0.1:7447", endpoint))


def test_a_client_from_the_readme_is_heard(tmp_path: Path) -> None:
    content = Experiment.read(experiment_path("paper")).content
    del content["teacher"]
    file = tmp_path / "alone.toml"
    file.write_text(tomli_w.dumps(content))
    folder = tmp_path / "runs"
    folder.mkdir()
    with Brain(folder, *SETTINGS, experiment=(str(file), ())) as brain, brain.bus() as bus:
        pairs = bus.subscriber(keys.PAIR)
        heard: set[int | None] = set()

        def take() -> bool:
            bus.wait(0.05)
            while (pair := pairs.take()) is not None:
                assert isinstance(pair, messages.Pair)
                heard.add(pair.note)
            return bool(heard)

        until(take)
        assert heard == {None}, "nobody teaches yet"
        client = subprocess.Popen([sys.executable, "-c", example((brain.run / "router.endpoint").read_text())])
        try:
            until(lambda: take() and 0 in heard)
        finally:
            client.kill()
            client.wait(5.0)
