"""Figures are made from logs on disk, whole or short; looks are for eyes, contents are checked here."""

import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from msgspec import structs

from mdb_protocol import keys
from mdb_protocol.errors import MdbError
from mdb_protocol.messages import Lesson, Phase, Scene
from mdb_services.recorder import EmptyLogError
from mdb_sim.figures.four_to_six import band, draw, draw_band
from mdb_sim.figures.people import MOST_ROWS, Stay, lanes, stays
from mdb_sim.runs.record import Episode, RunRecord
from mdb_sim.runs.trajectories import captured, typical
from tests.sim.test_measures import (
    ITERATIONS,
    PHASE,
    Log,
    of_another_body,
    place,
    report,
    scene,
    small_experiment,
    with_another_body,
    write_run,
)

NAMES = ["figure4", "figure5", "figure6"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("runs") / "full").run


def text_of(svg: Path) -> str:
    return " ".join(ElementTree.parse(svg).getroot().itertext())


def check_files(paths: list[Path], folder: Path, names: list[str], least_bytes: int = 5000) -> None:
    assert paths == [folder / f"{name}.{kind}" for name in names for kind in ("png", "svg")]
    for path in paths:
        assert path.stat().st_size > least_bytes
    for path in paths[::2]:
        assert path.read_bytes().startswith(b"\x89PNG")


def test_a_whole_run_is_drawn_with_its_phases_as_text(run: Path, tmp_path: Path) -> None:
    paths = draw(run, tmp_path / "figures")
    check_files(paths, tmp_path / "figures", NAMES)
    for svg in (paths[1], paths[3]):
        assert all(name in text_of(svg) for name in ("first teacher", "alone", "second teacher", "alone again"))
    assert "16 in 20–100" in text_of(paths[3])
    assert "random" in text_of(paths[3])
    assert "median of all 36 captures: 5 steps" in text_of(paths[5])
    assert "no captures" not in text_of(paths[5])


def test_figures_go_into_the_run_folder_and_are_the_same_every_time(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", 60).run
    first = {path: path.read_bytes() for path in draw(run)}
    assert {path.parent for path in first} == {run}
    assert {path: path.read_bytes() for path in draw(run)} == first


def test_an_unfinished_run_says_where_its_log_ends(tmp_path: Path) -> None:
    paths = draw(write_run(tmp_path / "run", 150).run)
    assert "the log ends at 150" in text_of(paths[3])


def test_a_run_of_which_little_is_known_is_drawn_with_notes_and_one_without_iterations_is_not(tmp_path: Path) -> None:
    log = Log(tmp_path / "run")
    log.put(keys.ITERATION, structs.replace(report(0), prequential={}, feedback=None, note=None, event="none"))
    log.close()
    paths = draw(log.run)
    check_files(paths, log.run, NAMES, least_bytes=1000)
    assert "no data in this log" in text_of(paths[1])
    assert "no captures in this log" in text_of(paths[3])
    assert "no episode has ended in this log" in text_of(paths[5])
    log = Log(tmp_path / "other")
    log.put(keys.SCENE, scene(0))
    log.close()
    with pytest.raises(EmptyLogError, match="nothing to draw"):
        draw(log.run)


def test_of_another_machine_the_numbers_of_the_scene_are_drawn(tmp_path: Path) -> None:
    record = write_run(tmp_path / "run", 200, scenes=of_another_body, experiment=with_another_body())
    text = text_of(draw(record.run)[5])
    assert all(word in text for word in ("angle", "height", "actions", "With teacher", "Without"))
    assert "5, 5, 5, 5 steps; median of all 16 episodes: 5 steps" in text
    assert "median of all 20 episodes: 5 steps" in text


def test_numbers_of_another_machine_are_drawn_with_a_note_where_no_episode_has_ended(tmp_path: Path) -> None:
    by_chance = write_run(tmp_path / "run", 22, scenes=of_another_body, experiment=with_another_body())
    assert "no episode has ended in this log" in text_of(draw(by_chance.run)[5])
    taught = write_run(tmp_path / "taught", 60, scenes=of_another_body, experiment=with_another_body())
    assert "no episodes in this log" in text_of(draw(taught.run)[5])


def test_of_many_numbers_the_first_four_are_drawn(tmp_path: Path) -> None:
    def many(count: int) -> Scene:
        shown = scene(count)
        numbers = {f"number_{place}": float(place + count) for place in range(6)}
        before = numbers if shown.before else None
        return structs.replace(shown, before=before, reached=numbers, now=numbers)

    text = text_of(draw(write_run(tmp_path / "run", 60, scenes=many, experiment=with_another_body()).run)[5])
    assert [f"number_{place}" in text for place in range(6)] == [True] * 4 + [False] * 2


@pytest.mark.parametrize("iterations", [1, 3])
def test_a_run_of_a_few_iterations_is_drawn_with_a_note(tmp_path: Path, iterations: int) -> None:
    log = Log(tmp_path / "run")
    for i in range(iterations):
        log.put(keys.SCENE, scene(i))
        log.put(keys.ITERATION, report(i))
    log.close()
    paths = draw(log.run)
    check_files(paths, log.run, NAMES)
    assert "no data in this log" in text_of(paths[1])
    assert "no captures in this log" in text_of(paths[3])
    assert text_of(paths[5]).count("no captures in this log") == 2


SAID = {"commands": ["go", "stop"], "notes": [0, 1]}


def with_people(run: Path, *, scripted: bool = True) -> RunRecord:
    """A run in which, beside the script, ann teaches twice, bob goes without a word, and nobody hears carl."""
    log = Log(run, small_experiment(scripted=scripted))
    there = {"ann": (range(120, 180), range(310, 330)), "bob": (range(150, 190),), "carl": (range(110, 390),)}
    for i in range(ITERATIONS):
        if scripted and i % PHASE == 0:
            teacher = ("one", None, "two", None)[i // PHASE]
            log.put(keys.PHASE, Phase(iteration=i, name=f"phase {i // PHASE}", teacher=teacher))
        for name, spans in there.items():
            for span in spans:
                if i == span.start:
                    log.put(keys.LESSON, Lesson(teacher=name, iteration=i, **SAID), teacher=name)
                elif i == span.stop and name != "bob":
                    over = Lesson(teacher=name, iteration=i, commands=[], notes=[], over=True)
                    log.put(keys.LESSON, over, teacher=name)
        heard = [name for name in ("ann", "bob") if any(i in span for span in there[name])]
        said = report(i)
        if heard:
            said = structs.replace(said, teacher=heard[0], note=0, judges=heard)
        log.put(keys.SCENE, scene(i))
        log.put(keys.ITERATION, said)
    return log.close()


def test_whoever_taught_is_marked_beside_the_scripted_phases(tmp_path: Path) -> None:
    record = with_people(tmp_path / "run")
    assert stays(record) == (Stay("ann", 120, 180), Stay("bob", 150, 190), Stay("ann", 310, 330))
    assert [[stay.name for stay in row] for row in lanes(stays(record))] == [["ann", "ann"], ["bob"]]
    text = text_of(draw(record.run)[3])
    assert text.count("ann teaches") == 2
    assert text.count("bob teaches") == 1
    assert "carl" not in text
    assert "phase 2" in text


def test_without_a_script_a_person_alone_is_the_phase_and_has_no_strip(tmp_path: Path) -> None:
    record = with_people(tmp_path / "run", scripted=False)
    assert "ann" in [span.teacher for span in record.spans]
    assert stays(record) == (Stay("ann", 120, 180),), "of two at once a phase shows the one who came last"


def test_of_many_people_the_rows_are_bounded() -> None:
    rows = lanes(tuple(Stay(f"t{i}", i, 100) for i in range(50)))
    assert len(rows) == MOST_ROWS
    assert sum(map(len, rows)) == 50


def test_several_runs_are_drawn_with_a_band(run: Path, tmp_path: Path) -> None:
    shorter = write_run(tmp_path / "shorter", 250).run
    paths = draw_band([run, shorter], tmp_path / "band")
    check_files(paths, tmp_path / "band", ["figure4-seeds", "figure5-seeds"])
    assert "mean of 2 runs" in text_of(paths[3])
    assert "only" in text_of(draw_band([run], tmp_path / "one")[3])
    with pytest.raises(MdbError, match="no runs"):
        draw_band([], tmp_path)


def test_the_band_holds_the_mean_and_ends_where_a_curve_is_missing() -> None:
    curves = [np.array([1.0, 2.0, np.nan, 4.0]), np.array([3.0, 2.0, 1.0])]
    mean, low, high = band(curves)
    assert mean[:2].tolist() == [2.0, 2.0]
    assert (low[0], high[0]) == (1.0, 3.0)
    assert (low[1], high[1]) == (2.0, 2.0)
    assert np.isnan([mean[2:], low[2:], high[2:]]).all()


def test_the_band_is_as_wide_as_the_standard_error_asks() -> None:
    curves = [np.array([value]) for value in np.random.default_rng(3).normal(size=100)]
    _, low, high = band(curves)
    assert high[0] - low[0] == pytest.approx(2 * 1.96 * np.std(curves) / 10, rel=0.1)


def test_shown_episodes_are_typical_in_length_one_a_side_and_the_earliest_of_equals() -> None:
    def episode(start: int, steps: int, direction_rad: float) -> Episode:
        return Episode(start, "capture", True, tuple(place(step, direction_rad) for step in range(steps + 1)))

    episodes = [episode(0, 2, 0.3), episode(10, 5, 0.4), episode(20, 5, 0.2), episode(30, 9, 2.0)]
    assert [shown.start for _, shown in typical(episodes)] == [10, 30]
    assert typical([]) == []


def test_episodes_of_forced_exploration_are_not_shown(tmp_path: Path) -> None:
    record = write_run(tmp_path / "run", 200)
    assert [episode.start for episode in captured(record, taught=True)] == list(range(20, 100, 5))
    assert [episode.start for episode in captured(record, taught=False)] == list(range(100, 200, 5))


def test_without_matplotlib_the_error_names_the_extra(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MdbError, match=r"pip install 'multilevel-darwinist-brain\[plot\]'"):
        draw(run)
