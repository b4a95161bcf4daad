"""Record the golden logs again, after a change of behaviour that is wanted: `python -m tests.replay.record`.

Each is a short run in a folder as any other (`mdb replay tests/replay/golden/late`), without what differs from run to
run: if nothing has changed, the files come out the same byte for byte. They are in MessagePack, as logs were before
they told of themselves: smaller by a third when they are packed, and a test that the runs of before are read.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.writer import Writer

from mdb_deploy.experiments import experiment_path
from mdb_protocol import codec, keys
from mdb_protocol.messages import Message
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_services.recorder import read_log
from mdb_sim.runs.compare import timeless
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from tests.integration.brain import SHORT
from tests.integration.test_experiment import RESTLESS

GOLDEN = Path(__file__).parent / "golden"
PROCESSOR_FILE = "processor"
SMALL = (
    *SHORT,
    "experiment.pace=lockstep",
    "model.object.hidden=[8]",
    "model.communication.hidden=[6]",
    "model.object.members=2",
    "model.induced.members=2",
)
RUNS = {
    "paper": SMALL,
    # Contexts change, models are stored and recalled, the word goes from one teacher to the next while feedback of
    # the first is still to come.
    "late": (
        *SMALL,
        *RESTLESS,
        "experiment.seed=3",
        "model.object.learner.name=adam",
        "model.induced.learner.name=de",
        "teacher.phase.first teacher.delay=3",
        "teacher.phase.first teacher.wrong_notes=0.1",
        "teacher.phase.first teacher.wrong_feedback=0.1",
        "teacher.phase.alone.teacher=three",
        "teacher.phase.alone.language=random",
    ),
    # The teachers' notes are sound.
    "sound": (
        *SMALL,
        "experiment.iterations=14",
        "model.object.learner.name=ridge",
        "model.induced.learner.name=ga",
        "teacher.phase.alone.start=9",
        "ear.detector=template",
        "teacher.sound.rate_hz=8000",
        "teacher.sound.duration_s=0.2",
    ),
}


def processor() -> str:
    """Return what the compiled kernels are made for: another one adds floats in another order."""
    from llvmlite import binding

    return str(binding.get_host_cpu_name())


def record(name: str, folder: Path) -> None:
    """Run an experiment of `RUNS` and keep in a folder what a replay needs."""
    with TemporaryDirectory() as scratch:
        run = Path(scratch)
        run_experiment(Experiment.read(experiment_path("paper"), RUNS[name]), run)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        shutil.copy(run / EXPERIMENT_FILE, folder)
        _write(run, folder / "run.mcap")
    (folder / PROCESSOR_FILE).write_text(processor() + "\n")


def _write(run: Path, path: Path) -> None:
    """Write what is repeatable of a run's log in one compressed chunk, with numbers for times."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2**30)
        writer.start(profile="mdb", library="")
        channels: dict[str, int] = {}
        for number, (key, message) in enumerate(_repeatable(run)):
            if key not in channels:
                schema = writer.register_schema(type(message).__name__, "mdb", b"")
                encoding = {"encoding": codec.encoding_of(type(message))}
                channels[key] = writer.register_channel(key, "msgpack", schema, encoding)
            writer.add_message(channels[key], number, codec.encode(message), number, number)
        writer.finish()


def _repeatable(run: Path) -> Iterator[tuple[str, Message]]:
    """Yield what each run of a seed has in its log: no times, and nothing that was shown again to somebody slow."""
    known: set[tuple[str, bytes]] = set()
    for recorded in read_log(run):
        message = timeless(recorded.message)
        mark = recorded.key, codec.encode(message)
        if recorded.row.repeatable and (recorded.row is keys.AUDIO or mark not in known):
            known.add(mark)
            yield recorded.key, message


def main(names: list[str]) -> None:
    """Record the named runs, or all."""
    for name in names or RUNS:
        record(name, GOLDEN / name)
        size = (GOLDEN / name / "run.mcap").stat().st_size
        sys.stdout.write(f"{GOLDEN / name}: {size / 1000:.0f} kB\n")


if __name__ == "__main__":
    main(sys.argv[1:])
