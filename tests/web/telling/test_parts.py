"""Pictures as a browser takes them, and the greeting of every experiment that is shipped."""

import base64
import struct
import zlib

import numpy as np
import pytest

from mdb_deploy.experiments import EXPERIMENTS
from mdb_deploy.web.telling.hello import hello, scale_hz
from mdb_deploy.web.telling.parts import percentile_ms, picture_part, png_url
from mdb_deploy.web.telling.plan import MOST_SHOWN, Plan
from mdb_protocol import messages as m
from mdb_sim.runs.experiment import Experiment
from tests.web.telling.told import checked


def test_an_image_becomes_the_same_image_in_png() -> None:
    image = np.random.default_rng(3).integers(0, 256, (5, 7, 3), np.uint8)
    kind, _, text = png_url(image).partition(",")
    data = base64.b64decode(text)
    assert kind == "data:image/png;base64"
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", data[16:24]) == (7, 5)
    start = data.index(b"IDAT")
    length = int.from_bytes(data[start - 4 : start], "big")
    lines = np.frombuffer(zlib.decompress(data[start + 4 : start + 4 + length]), np.uint8).reshape(5, 22)
    assert (lines[:, 0] == 0).all()
    assert (lines[:, 1:].reshape(5, 7, 3) == image).all()


def test_a_picture_is_told_as_drawing_or_image() -> None:
    shape = m.Shape(kind="line", points=[(0.0, 0.0), (1.0, 1.0)], what="wall")
    drawn = m.Picture(iteration=3, drawing=m.Drawing(shapes=[shape], box=(0.0, 0.0, 1.0, 1.0)))
    told = checked(picture_part(drawn))
    assert told["image"] is None
    assert told["drawing"]["shapes"][0]["points"] == [[0.0, 0.0], [1.0, 1.0]]
    seen = picture_part(m.Picture(iteration=3, image=np.zeros((2, 2, 3), np.uint8)))
    assert seen["drawing"] is None
    assert seen["image"].startswith("data:image/png;base64,")


@pytest.mark.parametrize("file", sorted(EXPERIMENTS.glob("*.toml")), ids=lambda file: file.stem)
def test_every_shipped_experiment_is_greeted(file) -> None:  # type: ignore[no-untyped-def]
    experiment = Experiment.read(file)
    told, plan = checked(hello(experiment, "a-run", live=True, teach=True)), Plan(experiment)
    assert told["experiment"]["name"] == experiment.brain.experiment.name
    assert told["experiment"]["words"].endswith((".", ":"))
    assert told["rights"] == {"teach": True, "operate": False}
    assert len(told["commands"]) == told["notes"] == len(told["scale_hz"])
    assert told["scale_hz"] == sorted(told["scale_hz"])
    assert all(sorted(notes) == list(range(told["notes"])) for notes in told["languages"].values())
    assert told["phases"][0]["start"] == 0
    actions = plan.choices() if told["choices"] else plan.grid()
    assert 2 <= len(next(iter(actions.values()))) <= max(MOST_SHOWN, len(told["choices"]))


def test_the_ears_scale_is_the_scale() -> None:
    experiment = Experiment.read(EXPERIMENTS / "paper.toml", ["ear.detector=template"])
    assert scale_hz(experiment.brain, 7) == [261.63, 293.66, 329.63, 349.23, 392.0, 440.0, 493.88]
    assert scale_hz(experiment.brain, 9)[7] == pytest.approx(523.26)


def test_percentiles_are_of_what_was_measured() -> None:
    assert percentile_ms([], 0.5) is None
    assert percentile_ms([0.003, 0.001, 0.002], 0.5) == 2.0
    assert percentile_ms([0.001 * place for place in range(1, 101)], 0.99) == 99.0
