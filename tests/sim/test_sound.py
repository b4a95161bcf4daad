"""Notes as they sound, noise, and the scripted teacher who plays instead of naming his notes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mdb_protocol import keys
from mdb_protocol.codec import to_plain
from mdb_protocol.errors import ConfigError
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.recorder import read_log
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from mdb_sim.teaching import sound
from mdb_sim.teaching.sound import INSTRUMENTS, NOISES, InstrumentName, NoiseName, Player, SoundSection

PAPER = Path(__file__).parents[2] / "deploy" / "experiments" / "paper.toml"
RATE_HZ = 16_000
SCALE = (261.63, 293.66, 329.63)


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def spectrum(samples: sound.Samples) -> tuple[sound.Samples, sound.Samples]:
    """Frequencies in hertz and power, both (n // 2 + 1,)."""
    power = np.square(np.abs(np.fft.rfft(samples * np.hanning(len(samples)))))
    return np.fft.rfftfreq(len(samples), 1.0 / RATE_HZ), power


@pytest.mark.parametrize("instrument", INSTRUMENTS)
@pytest.mark.parametrize("hz", [110.0, 392.0, 1500.0])
def test_a_note_has_its_power_at_its_partials(instrument: InstrumentName, hz: float) -> None:
    at_hz, power = spectrum(sound.play(instrument, hz, 1.0, RATE_HZ, rng()))
    number = np.maximum(np.round(at_hz / hz), 1.0)
    near = np.abs(at_hz - number * hz) < 5.0 + 0.03 * number * hz
    assert power[near].sum() > 0.98 * power.sum()


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_a_note_begins_and_ends_in_silence_and_is_as_long_and_loud_as_it_should(instrument: InstrumentName) -> None:
    samples = sound.play(instrument, 440.0, 0.5, RATE_HZ, rng())
    assert samples.shape == (RATE_HZ // 2,)
    assert np.abs(samples).max() == pytest.approx(1.0)
    assert np.abs(samples[[0, -1]]).max() < 1e-3
    quarter = len(samples) // 4
    assert np.square(samples[quarter : 2 * quarter]).mean() > np.square(samples[: RATE_HZ // 500]).mean()


def test_instruments_sound_differently() -> None:
    shares = {}
    for instrument in INSTRUMENTS:
        at_hz, power = spectrum(sound.play(instrument, 400.0, 0.5, RATE_HZ, rng()))
        bands = [power[np.abs(at_hz - k * 400.0) < 60.0].sum() for k in (1, 2, 3)]
        shares[instrument] = np.array(bands) / power.sum()
    assert shares["sine"][0] > 0.999
    assert shares["clarinet"][1] < 0.01 < shares["clarinet"][2]
    assert shares["flute"][1] > shares["flute"][2]
    assert shares["string"][2] > 0.02


@pytest.mark.parametrize("name", NOISES)
def test_noise_has_mean_square_one_and_its_seed_s_samples(name: NoiseName) -> None:
    made = sound.noise(name, RATE_HZ, RATE_HZ, rng())
    assert np.square(made).mean() == pytest.approx(1.0)
    assert (made == sound.noise(name, RATE_HZ, RATE_HZ, rng())).all()
    assert (made != sound.noise(name, RATE_HZ, RATE_HZ, rng(2))).any()


def test_pink_noise_has_as_much_power_in_each_octave_and_white_noise_twice_as_much_in_the_next() -> None:
    for name, ratio in (("pink", 1.0), ("white", 2.0)):
        at_hz, power = spectrum(sound.noise(name, 20 * RATE_HZ, RATE_HZ, rng()))  # type: ignore[arg-type]
        octaves = [power[(at_hz >= low) & (at_hz < 2 * low)].sum() for low in (200, 400, 800, 1600)]
        assert np.divide(octaves[1:], octaves[:-1]) == pytest.approx(ratio, rel=0.15)


@pytest.mark.parametrize("snr_db", [20.0, 0.0, -6.0])
def test_noise_is_mixed_in_as_loud_as_asked(snr_db: float) -> None:
    note, around = sound.play("string", 300.0, 0.5, RATE_HZ, rng()), sound.noise("white", RATE_HZ, RATE_HZ, rng())
    mixed = sound.mix(note, around, snr_db)
    rest = mixed.copy()
    rest[(len(rest) - len(note)) // 2 :][: len(note)] -= note
    ratio = np.square(note).mean() / np.square(rest).mean()
    assert 10 * np.log10(ratio) == pytest.approx(snr_db, abs=0.1)


def player(seed: int = 1, **section: Any) -> Player:
    return Player(SoundSection(**section), SCALE, seed)


def test_what_is_played_depends_on_seed_teacher_iteration_and_note_alone() -> None:
    noisy = {"snr_db": 10.0, "noise": "pink", "detune_cents": 20.0}
    first = player(**noisy).samples("one", 5, 2)
    assert (first == player(**noisy).samples("one", 5, 2)).all()
    for other in (player(**noisy).samples("two", 5, 2), player(**noisy).samples("one", 6, 2)):
        assert (first != other).any()
    assert (first != player(2, **noisy).samples("one", 5, 2)).any()


def test_frames_follow_one_another_and_the_last_ends_the_utterance() -> None:
    band = player(instrument="piano", duration_s=0.3, frame_s=0.1)
    frames = band.frames("one", 4, 1)
    assert (np.concatenate([frame.samples for frame in frames]) == band.samples("one", 4, 1)).all()
    assert [frame.end for frame in frames] == [False, False, False, True]
    assert {(frame.teacher, frame.iteration, frame.rate_hz) for frame in frames} == {("one", 4, RATE_HZ)}
    (silence,) = band.frames("one", 4, None)
    assert silence.end
    assert len(silence.samples) == 0


SHORT = [
    "robot.body=kinematic", "experiment.pace=lockstep", "experiment.iterations=60", "optimizer.random_iterations=12",
    "teacher.phase.alone.start=20", "teacher.phase.second teacher.start=26", "teacher.phase.alone again.start=52",
    "evolution.population=20", "evolution.generations=1",
]  # fmt: skip


def reports(folder: Path, *settings: str) -> list[dict[str, Any]]:
    run_experiment(Experiment.read(PAPER, [*SHORT, *settings]), folder)
    return [to_plain(r.message) for r in read_log(folder) if r.row is keys.ITERATION]


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """The iterations of a run in which the teachers name their notes."""
    return reports(tmp_path_factory.mktemp("named"))


@pytest.mark.parametrize(
    "settings",
    [
        ["teacher.sound.instrument=flute"],
        ["teacher.sound.instrument=piano", "teacher.sound.snr_db=15", "teacher.sound.noise=pink"],
        ["teacher.sound.instrument=voice", "teacher.sound.detune_cents=15", "teacher.sound.rate_hz=44100"],
    ],
)
def test_a_brain_taught_by_sound_does_what_it_does_when_notes_are_named(
    settings: list[str], named: list[dict[str, Any]], tmp_path: Path
) -> None:
    heard = reports(tmp_path, "ear.detector=template", *settings)
    assert [report["note"] for report in named].count(None) == 14
    assert heard == named
    said = {tuple(to_plain(r.message).values()) for r in read_log(tmp_path) if r.row is keys.HEARD}
    assert len(said) == 46 + 2, "every note, and the silence of each teacher who leaves"


def test_a_teacher_who_follows_another_at_once_is_obeyed_at_once(tmp_path: Path) -> None:
    phases = ["teacher.phase.alone.teacher=two", "teacher.phase.alone.language=random"]
    expected = reports(tmp_path / "named", *phases)
    got = reports(tmp_path / "sound", "ear.detector=template", "teacher.sound.instrument=string", *phases)
    assert got == expected
    assert [report["teacher"] for report in got[18:22]] == ["one", "one", "two", "two"]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["ear.notes_hz=[500,1000,1500,2000,2500,3000,3700]"], "<= 3500"),
        (["teacher.sound.instrument=flute"], "teacher.sound needs an [ear]; --set ear.detector=template"),
        (["ear.detector=template", "teacher.sound.instrument=gong"], "gong"),
        (["ear.detector=template", "teacher.sound.duration_s=0.1"], "duration_s"),
        (["ear.detector=template", "channels.note.size=5"], "ear.notes_hz has 7 notes, but channels.note has 5"),
    ],
)
def test_sections_that_do_not_go_together_say_so(settings: list[str], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Experiment.read(PAPER, settings)
    assert said in str(caught.value)


def test_an_experiment_without_sound_has_neither_ear_nor_player() -> None:
    experiment = Experiment.read(PAPER)
    assert experiment.brain.ear is None
    teacher = experiment.teacher_service(MemoryBus(Fabric(), "pioneer"))
    assert teacher._player is None
