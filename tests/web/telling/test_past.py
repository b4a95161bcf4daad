"""A past run is told as it was told live; what is damaged is said, and what is not there is not invented."""

import math
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from mdb_deploy.web.telling.past import PastRun
from mdb_deploy.web.telling.story import Story
from mdb_protocol import codec
from mdb_protocol import messages as m
from mdb_protocol.errors import MdbError
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_sim.runs.films import films_of
from mdb_sim.runs.record import read_record
from tests.web.telling.conftest import Made
from tests.web.telling.told import checked, experiment_of, log_of, story_of

MOMENTS = (0, 7, 33, 59, 60, 79)


@pytest.fixture
def past(pioneer: Path) -> Iterator[PastRun]:
    """The Pioneer's run, opened."""
    opened = PastRun(pioneer)
    yield opened
    opened.close()


def test_each_moment_is_told_as_it_was_told_live(past: PastRun, pioneer: Path) -> None:
    """In lockstep: when an action was chosen, the models were those of its intention."""
    live, found = Story(experiment_of(pioneer), clock=None), dict[int, dict[str, object]]()
    for recorded in log_of(pioneer):
        live.take(recorded.row, recorded.message)
        if isinstance(recorded.message, m.Action) and recorded.message.iteration not in found:
            parts = ("beliefs", "induced", "phase", "teachers", "perception", "scene", "models/object")
            found[recorded.message.iteration] = {name: checked(live.part(name)) for name in parts}
        if isinstance(recorded.message, m.IterationReport):
            found[recorded.message.iteration]["thought"] = checked(live.part("thought"))
    for moment in MOMENTS:
        told = checked(past.at(moment))
        told["models/object"] = told["models"]["object"]
        assert told["at"] == moment
        for name, value in found[moment].items():
            assert told[name] == value, (moment, name)


def test_its_rows_and_its_end_are_those_of_the_whole_story(past: PastRun, pioneer: Path) -> None:
    story = story_of(pioneer)
    assert checked(past.rows()) == checked(story.rows(0))
    assert past.iterations == 80
    last = checked(past.at(10_000))
    assert (last["at"], last["finished"], last["trouble"]) == (79, True, None)
    assert past.at(78)["finished"] is False
    assert past.at(-3)["at"] == 0
    assert past.hello()["live"] is False
    assert past.hello()["run"] == pioneer.name


def test_memories_of_any_moment_are_those_of_then(past: PastRun, pioneer: Path) -> None:
    for moment in MOMENTS[1:]:
        told = past.at(moment)
        live = Story(experiment_of(pioneer), clock=None)
        for recorded in log_of(pioneer):
            if isinstance(recorded.message, m.MemoryChange):
                name = recorded.message.model
                if recorded.message.version <= told["memory"][name]["version"]:
                    live.take(recorded.row, recorded.message)
        for name, memory in told["memory"].items():
            expected = live.part(f"memory/{name}")
            assert {pair["pair"] for pair in memory["pairs"]} == {pair["pair"] for pair in expected["pairs"]}
            assert memory["used"] == expected["used"] > 0


def test_opening_and_looking_are_fast(pioneer: Path) -> None:
    """Of a run of 2000 iterations a second, and 150 ms, with room for a busy machine: of 80, far less."""
    began_s = time.process_time()
    opened = PastRun(pioneer)
    assert time.process_time() - began_s < 1.0
    began_s = time.process_time()
    for moment in MOMENTS:
        opened.at(moment)
    assert (time.process_time() - began_s) / len(MOMENTS) < 0.15
    opened.close()


def without_sensed(drawing: dict[str, Any]) -> dict[str, Any]:
    """A drawing without what its robot perceives, which is noisy."""
    return drawing | {"shapes": [shape for shape in drawing["shapes"] if shape["what"] != "sensed"]}


def test_what_was_sensed_is_drawn_as_it_was_sensed(past: PastRun) -> None:
    told = past.at(7, picture=True)
    line = next(shape for shape in told["picture"]["drawing"]["shapes"] if shape["what"] == "sensed")
    assert math.dist(*line["points"]) == pytest.approx(told["perception"]["reading"]["distance"])


def test_pictures_are_the_episode_done_again(past: PastRun, pioneer: Path) -> None:
    """Those of the figures, which are made of all of an episode at once."""
    record = read_record(pioneer)
    episodes = [episode for episode in record.episodes() if episode.steps > 1]
    [first, *_, last] = episodes
    for film in films_of(record, [("", episode, None) for episode in (last, first, last)]):
        assert not film.missing
        for moment, picture in list(film.shown())[:-1]:  # at its end another one begins
            told = past.picture(film.start + moment)
            assert (told["missing"], told["image"]) == (None, None)
            assert told["iteration"] == film.start + moment
            assert without_sensed(told["drawing"]) == without_sensed(codec.to_plain(picture)["drawing"])
    assert checked(past.at(41, picture=True))["picture"] == checked(past.picture(41))
    assert "picture" not in past.at(41)


def test_pictures_of_a_body_that_was_changed(run_of: Made) -> None:
    change = "robot.change=[{at=10, set={swapped=true}}]"
    run = run_of("paper", "robot.body=kinematic", "experiment.iterations=30", change)
    opened = PastRun(run)
    for moment in (30, 5, 10, 12, 29):
        assert opened.picture(moment)["missing"] is None
    opened.close()


def test_why_there_is_no_picture_is_said(pioneer: Path, tmp_path: Path) -> None:
    """Another seed: the episode goes another way. Another body: it cannot be had."""
    for old, new, words in (
        ("seed = 1", "seed = 2", "goes another way"),
        ('body = "kinematic"', 'body = "nobody.knows:It"', "nobody"),
    ):
        run = shutil.copytree(pioneer, tmp_path / new.partition(" ")[0])
        text = (run / EXPERIMENT_FILE).read_text(encoding="utf-8")
        assert old in text
        (run / EXPERIMENT_FILE).write_text(text.replace(old, new), encoding="utf-8")
        opened = PastRun(run)
        told = opened.picture(12)
        assert told["drawing"] is told["image"] is None
        assert words in told["missing"]
        assert opened.at(12)["thought"]["iteration"] == 12
        opened.close()


@pytest.mark.parametrize("share", [0.2, 0.7])
def test_a_log_that_a_kill_cut_short_is_told_as_far_as_it_goes(pioneer: Path, tmp_path: Path, share: float) -> None:
    run = shutil.copytree(pioneer, tmp_path / "run")
    whole = (run / "run.mcap").read_bytes()
    (run / "run.mcap").write_bytes(whole[: int(len(whole) * share)])
    opened = PastRun(run)
    assert 5 < opened.iterations < 79
    last = checked(opened.at(79))
    assert last["at"] == opened.iterations - 1
    assert last["trouble"].startswith("The log ends early: ")
    assert last["finished"] is False
    opened.close()


def test_a_packed_log_is_told_as_well(pioneer: Path, past: PastRun, tmp_path: Path) -> None:
    """As the tools of MCAP pack it."""
    (tmp_path / EXPERIMENT_FILE).write_bytes((pioneer / EXPERIMENT_FILE).read_bytes())
    with (pioneer / "run.mcap").open("rb") as source, (tmp_path / "run.mcap").open("wb") as target:
        writer = Writer(target, compression=CompressionType.ZSTD)
        writer.start()
        channels = dict[int, int]()
        for _, channel, message in make_reader(source).iter_messages():
            if channel.id not in channels:
                of = channel.topic, channel.message_encoding, 0, dict(channel.metadata)
                channels[channel.id] = writer.register_channel(*of)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()  # type: ignore[no-untyped-call]
    packed = PastRun(tmp_path)
    assert checked(packed.rows()) == checked(past.rows())
    assert checked(packed.at(33)) == checked(past.at(33))
    packed.close()


def test_what_is_no_run_is_refused_in_words(pioneer: Path, tmp_path: Path) -> None:
    with pytest.raises(MdbError, match="experiment"):
        PastRun(tmp_path)
    (tmp_path / EXPERIMENT_FILE).write_bytes((pioneer / EXPERIMENT_FILE).read_bytes())
    with pytest.raises(MdbError, match="no run log"):
        PastRun(tmp_path)
    (tmp_path / "run.mcap").write_bytes(b"this is no log")
    with pytest.raises(MdbError, match="no MCAP file"):
        PastRun(tmp_path)
    (tmp_path / "run.mcap").unlink()
    (tmp_path / "run.mcap").mkdir()
    with pytest.raises(MdbError):
        PastRun(tmp_path)


def test_only_what_belongs_to_the_run_can_be_downloaded(pioneer: Path, tmp_path: Path) -> None:
    run = shutil.copytree(pioneer, tmp_path / "run")
    (run / "figures").mkdir()
    (run / "figures" / "figure5.png").write_bytes(b"png")
    (run / ".hidden.csv").write_text("a")
    (run / "key.pem").write_text("a secret")
    (tmp_path / "outside.csv").write_text("a")
    (run / "link.csv").symlink_to(tmp_path / "outside.csv")
    opened = PastRun(run)
    files = {file["path"]: file["bytes"] for file in opened.files()}
    assert set(files) == {EXPERIMENT_FILE, "figures/figure5.png", "run.mcap"}
    assert files["figures/figure5.png"] == 3
    opened.close()
