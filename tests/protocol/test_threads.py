"""Classes that several threads meet for the first time at once: in processes of their own, where none is known."""

import subprocess
import sys

import pytest

THREADS = """
import sys, threading
import msgpack
{imports}
sys.setswitchinterval(1e-6)
def at_once(do):
    start = threading.Barrier(8)
    threads = [threading.Thread(target=lambda: (start.wait(), do())) for _ in range(8)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
{does}
"""

DECODE = THREADS.format(
    imports="from mdb_protocol import codec, errors, keys",
    does="""
def decode(cls):
    fields = dict.fromkeys(cls.__struct_fields__, 1)
    try:
        codec.decode(cls, msgpack.packb(fields), codec.encoding_of(cls))
    except errors.DecodeError:
        pass
for row in [row for row in vars(keys).values() if isinstance(row, keys.Key) and row.message is not None]:
    at_once(lambda: decode(row.message))
""",
)
READ = THREADS.format(
    imports="from mdb_deploy.experiments import experiment_path\nfrom mdb_sim.runs.experiment import Experiment",
    does="at_once(lambda: Experiment.read(experiment_path('paper'), ('robot.body=kinematic',)).check_machine())",
)


@pytest.mark.parametrize("code", [DECODE, READ], ids=["messages", "experiments"])
def test_several_threads_meet_a_class_at_once(code: str) -> None:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
