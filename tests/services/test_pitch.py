"""Hearing notes: right ones in noise, none in noise alone, each once, however the sound is cut into frames."""

import shutil
import subprocess
import sys
import time
import wave
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_protocol.errors import ConfigError
from mdb_services.experiment.reading import convert
from mdb_services.experiment.sections import EarSection
from mdb_services.hearing import pitch
from mdb_services.hearing.pitch import Heard, NoteDetector
from mdb_sim.teaching.sound import INSTRUMENTS, NOISES, InstrumentName, mix, noise, play, to_int16
from tests.services.listening import EAR, RATE_HZ, Clip, clip, listen, melody, noise_clip, notes_in

NOTES = range(len(EAR.notes_hz))
SOUNDFONT = Path("/usr/share/sounds/sf2/FluidR3_GM.sf2")
PROGRAMS = {
    "grand piano": 0, "electric piano": 4, "vibraphone": 11, "marimba": 12, "church organ": 19, "harmonica": 22,
    "nylon guitar": 24, "jazz guitar": 26, "violin": 40, "viola": 41, "harp": 46, "choir": 52, "trumpet": 56,
    "trombone": 57, "alto sax": 65, "oboe": 68, "clarinet": 71, "flute": 73, "recorder": 74, "pan flute": 75,
}  # fmt: skip
"""General MIDI instruments that have one pitch and do not beat: those that do are heard again at each beat."""


def right(clips: list[tuple[int, Clip]], ear: EarSection = EAR) -> float:
    """The share of clips in which just the note is heard that is in them."""
    return sum(notes_in(samples, ear) == [note] for note, samples in clips) / len(clips)


def clips(snr_db: float, seeds: range, instruments: Sequence[InstrumentName] = INSTRUMENTS) -> list[tuple[int, Clip]]:
    return [
        (note, clip(instrument, note, around, snr_db, seed))
        for instrument in instruments for around in NOISES for note in NOTES for seed in seeds
    ]  # fmt: skip


@pytest.mark.parametrize("seeds", [1, pytest.param(5, marks=pytest.mark.slow)])
def test_of_notes_at_10_db_hardly_any_is_heard_wrongly(seeds: int) -> None:
    assert right(clips(10.0, range(seeds))) >= 0.99


def test_without_noise_every_note_of_every_instrument_is_heard() -> None:
    assert right([(note, clip(instrument, note)) for instrument in INSTRUMENTS for note in NOTES]) == 1.0


@pytest.mark.parametrize("seeds", [20, pytest.param(100, marks=pytest.mark.slow)])
def test_in_noise_alone_hardly_any_note_is_heard(seeds: int) -> None:
    false = [notes_in(noise_clip(name, seed)) for name in NOISES for seed in range(seeds)]
    assert sum(map(bool, false)) / len(false) < 0.01


@pytest.mark.parametrize("level", [0, 1, 30])
def test_in_silence_no_note_is_heard(level: int) -> None:
    hiss = np.random.default_rng(1).integers(-level, level + 1, 10 * RATE_HZ).astype(np.int16)
    assert notes_in(hiss) == []


@pytest.mark.parametrize("rate_hz", [8000, 11_025, 22_050, 44_100, 48_000])
def test_any_rate_will_do(rate_hz: int) -> None:
    for instrument in INSTRUMENTS:
        samples = clip(instrument, 3, "white", rate_hz=rate_hz)
        assert notes_in(samples, rate_hz=rate_hz) == [3], instrument


def semitones(lowest_hz: float, steps: tuple[int, ...]) -> tuple[float, ...]:
    return tuple(lowest_hz * 2.0 ** (step / 12.0) for step in steps)


@pytest.mark.parametrize(
    ("notes_hz", "window_s"),
    [
        (semitones(110.0, (0, 12, 24, 36)), 0.128),
        (semitones(261.63, tuple(range(12))), 0.128),
        (semitones(130.81, tuple(range(12))), 0.2),
        (semitones(220.0, (0, 3, 5, 7, 10, 12)), 0.128),
        ((440.0,), 0.128),
    ],
)
@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_any_scale_will_do(instrument: InstrumentName, notes_hz: tuple[float, ...], window_s: float) -> None:
    ear = EarSection(notes_hz=notes_hz, window_s=window_s)
    for note in range(len(notes_hz)):
        assert notes_in(clip(instrument, note, "pink", 10.0, ear=ear, duration_s=0.45), ear) == [note]


def test_a_tone_between_two_notes_is_none_of_them() -> None:
    between = EarSection(notes_hz=(350.0, 450.0))
    for instrument in INSTRUMENTS:
        samples = clip(instrument, 0, ear=EarSection(notes_hz=(400.0,)))
        assert notes_in(samples, between) == [], instrument
        assert notes_in(samples, EarSection(notes_hz=(350.0, 400.0, 450.0))) == [1]


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_a_note_counts_once_and_again_when_it_is_played_again(instrument: InstrumentName) -> None:
    assert notes_in(melody(instrument, [4], 5.0, 0.5)) == [4]
    for gap_s in (0.05, 0.1, 0.4):
        notes = [2, 2, 0, 5, 5, 5, 1]
        assert notes_in(melody(instrument, notes, 0.35, gap_s)) == notes


def test_a_note_that_is_struck_while_it_fades_counts_again() -> None:
    struck = [play("piano", EAR.notes_hz[2], 2.0, RATE_HZ, np.random.default_rng(seed)) for seed in range(3)]
    sounding = np.zeros(4 * RATE_HZ)
    for start, samples in zip((0, 13_000, 26_000), struck, strict=True):
        sounding[start : start + len(samples)] += samples
    assert notes_in(to_int16(sounding)) == [2, 2, 2]


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_notes_that_run_into_one_another_are_told_apart_even_an_octave_apart(instrument: InstrumentName) -> None:
    ear, notes = EarSection(notes_hz=(220.0, 261.63, 440.0, 523.25)), [1, 3, 1, 0, 2, 0, 3]
    sounding = np.zeros(4 * RATE_HZ)
    for i, note in enumerate(notes):
        samples = play(instrument, ear.notes_hz[note], 0.43, RATE_HZ, np.random.default_rng(i))
        sounding[i * 6400 : i * 6400 + len(samples)] += samples
    assert notes_in(to_int16(sounding), ear) == notes


def test_a_tone_that_is_always_there_is_no_note_after_its_beginning() -> None:
    rng = np.random.default_rng(4)
    hum = 0.05 * np.sin(2 * np.pi * 392.0 * np.arange(6 * RATE_HZ) / RATE_HZ) + 0.01 * rng.standard_normal(
        6 * RATE_HZ
    )
    for i, note in enumerate((0, 4, 6)):
        samples = play("flute", EAR.notes_hz[note], 0.4, RATE_HZ, rng)
        hum[(2 * i + 1) * RATE_HZ : (2 * i + 1) * RATE_HZ + len(samples)] += 0.5 * samples
    assert notes_in(to_int16(hum)) == [4, 0, 4, 6]


@settings(derandomize=True, deadline=None, max_examples=30)
@given(st.floats(-45.0, 0.0), st.integers(-2000, 2000), st.sampled_from(INSTRUMENTS))
def test_loudness_and_an_offset_do_not_matter(level_db: float, offset: int, instrument: InstrumentName) -> None:
    samples = clip(instrument, 1) * 10.0 ** (level_db / 20.0) + offset
    assert notes_in(np.round(samples).astype(np.int16)) == [1]


SOUND = np.concatenate([melody("piano", [3, 3, 6], 0.3, 0.1), noise_clip("pink", 1), melody("voice", [0], 0.4, 0.1)])
WHOLE = NoteDetector(EAR, RATE_HZ).hear(SOUND)


def test_the_sound_for_the_frames_has_its_notes() -> None:
    assert [heard.note for heard in WHOLE] == [3, 3, 6, 0]


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.lists(st.integers(0, len(SOUND)), max_size=40))
def test_frames_do_not_matter(cuts: list[int]) -> None:
    detector = NoteDetector(EAR, RATE_HZ)
    edges = [0, *sorted(cuts), len(SOUND)]
    heard: list[Heard] = []
    for first, after in pairwise(edges):
        heard += detector.hear(SOUND[first:after])
    assert heard == WHOLE


@pytest.mark.parametrize("frame", [1, 160, 777, 1600, 16_000, 10**6])
def test_equal_frames_of_any_size_give_the_same(frame: int) -> None:
    samples = clip("string", 5, "pink")
    assert listen(samples, frame=frame) == listen(samples)


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_where_a_note_began_is_known_to_a_few_hundredths_of_a_second(instrument: InstrumentName) -> None:
    for lead_s in (0.1, 0.25, 0.613):
        lead = noise("white", round(lead_s * RATE_HZ), RATE_HZ, np.random.default_rng(2)) * 1e-3
        samples = to_int16(np.concatenate([lead, play(instrument, 392.0, 0.4, RATE_HZ, np.random.default_rng(3))]))
        (heard,) = listen(samples)
        assert abs(heard.began / RATE_HZ - lead_s) < 0.05


def sox(*words: str) -> Clip:
    command = ["sox", "-R", "-n", "-r", str(RATE_HZ), "-b", "16", "-e", "signed", "-c", "1", "-t", "raw", "-", *words]
    return np.frombuffer(subprocess.run(command, capture_output=True, check=True).stdout, dtype=np.int16)


@pytest.mark.skipif(shutil.which("sox") is None, reason="needs sox")
@pytest.mark.parametrize("wave_form", ["sine", "square", "triangle", "sawtooth", "trapezium", "exp", "pluck"])
def test_tones_of_sox_are_heard(wave_form: str) -> None:
    for note, hz in enumerate(EAR.notes_hz):
        assert notes_in(sox("synth", "0.5", wave_form, str(hz), "vol", "0.4", "fade", "0.01", "0.5", "0.05")) == [
            note
        ]


@pytest.mark.skipif(shutil.which("sox") is None, reason="needs sox")
@pytest.mark.parametrize("name", ["whitenoise", "pinknoise", "brownnoise", "tpdfnoise"])
def test_in_noise_of_sox_no_note_is_heard(name: str) -> None:
    assert notes_in(sox("synth", "30", name, "vol", "0.5")) == []


def midi(programs: list[int], keys: tuple[int, ...] = (60, 62, 64, 65, 67, 69, 71)) -> bytes:
    """A MIDI file in which each program plays the keys, half a second each, with half a second in between."""
    half_s, track, wait = b"\x83\x60", b"", b"\x00"
    for program in programs:
        track += wait + bytes([0xC0, program])
        wait = b"\x00"
        for key in keys:
            track += wait + bytes([0x90, key, 100]) + half_s + bytes([0x80, key, 0])
            wait = half_s
    track += wait + b"\xff\x2f\x00"
    header = b"MThd" + (6).to_bytes(4, "big") + b"\x00\x00\x00\x01" + (480).to_bytes(2, "big")
    return header + b"MTrk" + len(track).to_bytes(4, "big") + track


@pytest.fixture(scope="module")
def general_midi(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Clip]]:
    """A second for each note of each program, as FluidSynth plays it."""
    if shutil.which("fluidsynth") is None or not SOUNDFONT.exists():
        pytest.skip("needs fluidsynth and fluid-soundfont-gm")
    folder = tmp_path_factory.mktemp("midi")
    (folder / "notes.mid").write_bytes(midi(list(PROGRAMS.values())))
    command = ["fluidsynth", "-ni", "-q", "-R", "0", "-C", "0", "-r", str(RATE_HZ), "-F", str(folder / "notes.wav")]
    subprocess.run([*command, str(SOUNDFONT), str(folder / "notes.mid")], capture_output=True, check=True)
    with wave.open(str(folder / "notes.wav")) as file:
        both = np.frombuffer(file.readframes(file.getnframes()), dtype=np.int16).reshape(-1, file.getnchannels())
    seconds = both.mean(axis=1)[: len(PROGRAMS) * 7 * RATE_HZ].reshape(len(PROGRAMS), 7, RATE_HZ)
    return {name: [to_int16(note) for note in notes] for name, notes in zip(PROGRAMS, seconds, strict=True)}


@pytest.mark.parametrize("name", PROGRAMS)
def test_instruments_of_general_midi_are_heard(name: str, general_midi: dict[str, list[Clip]]) -> None:
    assert [notes_in(samples) for samples in general_midi[name]] == [[note] for note in NOTES]


def test_instruments_of_general_midi_are_heard_in_noise(general_midi: dict[str, list[Clip]]) -> None:
    noisy = []
    for i, notes in enumerate(general_midi.values()):
        for note, samples in enumerate(notes):
            half = samples[: RATE_HZ // 2] / 32768.0
            around = noise(NOISES[note % 3], len(half) + 1000, RATE_HZ, np.random.default_rng([i, note]))
            noisy.append((note, to_int16(mix(half, around, 10.0))))
    assert right(noisy) >= 0.97


def test_the_second_opinion_agrees() -> None:
    pytest.importorskip("swift_f0", reason="needs the sound extra")
    swift = EarSection(detector="swift-f0")
    harmonic = [instrument for instrument in INSTRUMENTS if instrument != "sine"]  # of a sine it is never sure
    assert right([(note, clip(instrument, note)) for instrument in harmonic for note in NOTES], swift) >= 0.95
    assert right(clips(10.0, range(1), harmonic), swift) >= 0.9
    false = [notes_in(noise_clip(name, seed), swift) for name in NOISES for seed in range(10)]
    assert sum(map(bool, false)) <= 1


def test_without_the_package_the_second_opinion_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "swift_f0", None)
    pitch._swift_f0.cache_clear()
    with pytest.raises(ConfigError, match=r"pip install '\.\[sound\]', or take 'template'"):
        NoteDetector(EarSection(detector="swift-f0"), RATE_HZ)


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"notes_hz": [440.0, 430.0]}, "expected rising notes"),
        ({"notes_hz": [440.0, 445.0]}, "at least 7.8 Hz apart; a longer window_s tells"),
        ({"notes_hz": [41.0, 440.0], "window_s": 0.05}, "rising notes from 80.0 Hz on"),
        ({"notes_hz": []}, "notes_hz"),
        ({"hop_s": 0.2}, "expected at most window_s, 0.128"),
        ({"detector": "swift-f0", "notes_hz": [440.0, 2500.0]}, "swift-f0 hears from 47.0 to 2093.0 Hz"),
        ({"detector": "yin"}, "detector"),
    ],
)
def test_sections_that_cannot_be_heard_are_clear_errors(section: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        convert(section, EarSection, "file")
    assert said in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(("detector", "seeds"), [("template", 5), ("swift-f0", 1)])
def test_measurements(detector: str, seeds: int) -> None:
    """Print accuracy by instrument and noise, false notes, and cost (with -s)."""
    if detector == "swift-f0":
        pytest.importorskip("swift_f0", reason="needs the sound extra")
    ear = convert({"detector": detector}, EarSection, "test")
    _table(ear, range(100, 100 + seeds))
    count = 60 * seeds
    for name in NOISES:
        false = sum(bool(notes_in(noise_clip(name, 1000 + seed), ear)) for seed in range(count))
        sys.stdout.write(f"{detector}: a note in {false} of {count} clips of {name} noise alone, 1 s each\n")
        assert detector != "template" or false / count < 0.01


def _table(ear: EarSection, seeds: range) -> None:
    sys.stdout.write(f"\n{ear.detector}: percent right of {len(seeds) * len(NOTES)} clips of each noise\n")
    analysis_s = sound_s = 0.0
    for instrument in INSTRUMENTS:
        cells = []
        for snr_db in (20.0, 10.0, 5.0, 0.0):
            for around in NOISES:
                heard = 0
                for note in NOTES:
                    for seed in seeds:
                        samples = clip(instrument, note, around, snr_db, seed)
                        started_s = time.process_time()
                        heard += notes_in(samples, ear) == [note]
                        analysis_s += time.process_time() - started_s
                        sound_s += len(samples) / RATE_HZ
                cells.append(f"{around[0]}{snr_db:.0f} {100 * heard / len(seeds) / len(NOTES):5.1f}")
        sys.stdout.write(f"{instrument:>9} {'  '.join(cells)}\n")
    sys.stdout.write(f"{ear.detector}: {1000 * analysis_s / sound_s:.1f} ms of processor time per second of sound\n")


@pytest.mark.parametrize("rate_hz", [8000, 16_000, 48_000])
def test_a_template_has_each_partial_with_its_whole_lobe_and_nothing_else(rate_hz: int) -> None:
    pitches_hz, weights = np.geomspace(60.0, 2000.0, 40), np.arange(8.0, 0.0, -1.0)
    size = round(EAR.window_s * rate_hz)
    bins = np.arange(size // 2 + 1)
    lobes = (w * pitch._main_lobe(bins - k * pitches_hz[:, None] * size / rate_hz) for k, w in enumerate(weights, 1))
    np.testing.assert_array_equal(pitch._combs(pitches_hz, weights, size, rate_hz), sum(lobes))
