"""Notes as they sound: instruments, noise, and the scripted teacher who plays them.

Owns the `[teacher.sound]` section. Every sample is a function of its arguments and a generator; nothing is heard
here: that is the ear's, which knows none of this.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from mdb_protocol.messages import AudioFrame
from mdb_services.experiment.sections import Section
from mdb_services.mechanism.networks import streams

InstrumentName = Literal["sine", "flute", "string", "clarinet", "piano", "voice"]
NoiseName = Literal["white", "pink", "babble"]
Samples = NDArray[np.float64]
INSTRUMENTS: tuple[InstrumentName, ...] = get_args(InstrumentName)
NOISES: tuple[NoiseName, ...] = get_args(NoiseName)

HIGHEST = 0.45
"""Of the sampling rate: no partial sounds above."""
PEAK = 0.5
"""Of full scale: the loudest sample of a note; leaves room for the noise."""
SPEAKERS = 10
"""Voices that make a babble: enough that none stands out."""
SYLLABLE_S = 0.15
"""A speaker changes pitch and loudness about this often."""
SPEECH_HZ = (90.0, 260.0)
"""Pitches of speaking voices, from men's to women's."""
VOWELS_HZ = (
    (730.0, 1090.0, 2440.0),
    (530.0, 1840.0, 2480.0),
    (270.0, 2290.0, 3010.0),
    (570.0, 840.0, 2410.0),
    (300.0, 870.0, 2240.0),
)
"""First three formants of five vowels (Peterson and Barney 1952, men)."""
FORMANT_WIDTHS_HZ = (90.0, 110.0, 170.0)
LEAD_S = 0.02
TAIL_S = 0.05
"""Before a note and after it only the noise is there."""


@dataclass(frozen=True)
class Instrument:
    """How an instrument sounds, in a note's partials and in time. All ours, after the usual descriptions.

    `amplitudes(partials, frequency_hz, rng)`: relative amplitude of each partial (n,), numbered from 1. A partial
    fades with the time constant `fade_s` over its number (0: it does not); `stretch` is a string's inharmonicity B,
    by which partial k sounds at k * sqrt(1 + B k²); vibrato goes that many cents up and down.
    """

    amplitudes: Callable[[Samples, float, np.random.Generator], Samples]
    attack_s: float
    fade_s: float = 0.0
    stretch: float = 0.0
    vibrato_cents: float = 0.0


def _sung(partials: Samples, frequency_hz: float, rng: np.random.Generator) -> Samples:
    """A glottal source falling by 12 dB an octave, 6 dB of which the lips give back, through a vowel's formants."""
    at_hz = (partials * frequency_hz)[:, None]
    formants, widths = np.array(VOWELS_HZ[rng.integers(len(VOWELS_HZ))]), np.array(FORMANT_WIDTHS_HZ)
    gains = 1.0 / np.sqrt(1.0 + np.square((at_hz - formants) / widths))
    return np.asarray(gains.max(axis=1) / partials)


VIBRATO_HZ = 5.5
PLAYED: dict[InstrumentName, Instrument] = {
    "sine": Instrument(lambda k, _f, _rng: np.where(k == 1, 1.0, 0.0), attack_s=0.01),
    "flute": Instrument(lambda k, _f, rng: rng.uniform(0.7, 1.0) * 0.25 ** (k - 1), 0.04, vibrato_cents=8.0),
    "string": Instrument(lambda k, _f, rng: rng.uniform(0.6, 1.0, len(k)) / k, attack_s=0.03, fade_s=4.0),
    "clarinet": Instrument(lambda k, _f, _rng: np.where(k % 2 == 1, 1.0, 0.05) / k, attack_s=0.02),
    "piano": Instrument(lambda k, _f, rng: rng.uniform(0.6, 1.0, len(k)) / k**1.2, 0.003, 0.6, stretch=4e-4),
    "voice": Instrument(_sung, attack_s=0.04, vibrato_cents=30.0),
}


def play(
    instrument: InstrumentName, frequency_hz: float, duration_s: float, rate_hz: int, rng: np.random.Generator
) -> Samples:
    """Return a note as samples (n,) within ±1 whose loudest is 1; it has died away at its end."""
    played = PLAYED[instrument]
    partials = np.arange(1.0, max(2.0, min(20.0, HIGHEST * rate_hz / frequency_hz)))
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    deviation = played.vibrato_cents * np.sin(2 * np.pi * (VIBRATO_HZ * time_s + rng.random()))
    turns = np.cumsum(frequency_hz * 2.0 ** (deviation / 1200.0)) / rate_hz
    sum_of = np.zeros_like(time_s)
    for k, amplitude in zip(partials, played.amplitudes(partials, frequency_hz, rng), strict=True):
        ratio = k * np.sqrt(1.0 + played.stretch * k * k)
        fade = np.exp(-time_s * k / played.fade_s) if played.fade_s else 1.0
        sum_of += amplitude * fade * np.sin(2 * np.pi * (ratio * turns + rng.random()))
    return _loudest(sum_of * _envelope(len(time_s), played.attack_s, rate_hz))


def _envelope(length: int, attack_s: float, rate_hz: int, release_s: float = 0.03) -> Samples:
    """A raised cosine up at the beginning and down at the end, (n,)."""
    up = np.clip(np.arange(length) / (attack_s * rate_hz), 0.0, 1.0)
    down = np.clip(np.arange(length)[::-1] / (release_s * rate_hz), 0.0, 1.0)
    return np.asarray(0.5 * (1.0 - np.cos(np.pi * np.minimum(up, down))))


def noise(name: NoiseName, length: int, rate_hz: int, rng: np.random.Generator) -> Samples:
    """Return noise (length,) of mean square 1: white; pink, 3 dB less an octave; or many people who talk."""
    if name == "babble":
        made = np.sum([_speaker(length, rate_hz, rng) for _ in range(SPEAKERS)], axis=0)
    else:
        made = rng.standard_normal(length)
        if name == "pink":
            spectrum = np.fft.rfft(made)
            spectrum[0] = 0.0
            spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
            made = np.fft.irfft(spectrum, length)
    return np.asarray(made / max(float(np.sqrt(np.mean(np.square(made)))), 1e-12))


def _speaker(length: int, rate_hz: int, rng: np.random.Generator) -> Samples:
    """One who talks: vowels of a pitch and a loudness that go from syllable to syllable."""
    syllables = 2 + int(length / (SYLLABLE_S * rate_hz))
    at = np.linspace(0.0, length, syllables) + rng.uniform(0.0, SYLLABLE_S * rate_hz)
    usual_hz = rng.uniform(*SPEECH_HZ)
    pitch_hz = np.interp(np.arange(length), at, usual_hz * 2.0 ** rng.normal(0.0, 0.2, syllables))
    loudness = np.interp(np.arange(length), at, rng.uniform(0.0, 1.0, syllables))
    partials = np.arange(1.0, HIGHEST * min(rate_hz, 8000) / usual_hz)
    turns = np.cumsum(pitch_hz) / rate_hz
    sum_of = np.zeros(length)
    for k, amplitude in zip(partials, _sung(partials, usual_hz, rng), strict=True):
        sum_of += amplitude * np.sin(2 * np.pi * (k * turns + rng.random()))
    return loudness * sum_of


def _loudest(samples: Samples) -> Samples:
    return np.asarray(samples / max(float(np.abs(samples).max(initial=0.0)), 1e-12))


def mix(note: Samples, around: Samples, snr_db: float) -> Samples:
    """Return noise (m,) with the note (n <= m,) in its middle, louder by `snr_db` in mean square over the note.

    `around` has mean square 1; the note keeps its loudness.
    """
    level = np.sqrt(np.mean(np.square(note))) * 10.0 ** (-snr_db / 20.0)
    return np.asarray(_placed(note, len(around), (len(around) - len(note)) // 2) + level * around)


def _placed(note: Samples, length: int, start: int) -> Samples:
    return np.pad(note, (start, length - start - len(note)))


def to_int16(samples: Samples, peak: float = PEAK) -> NDArray[np.int16]:
    """Return samples (n,) as 16 bits with the loudest at `peak` of full scale."""
    return np.asarray(np.round(_loudest(samples) * peak * 32767.0), dtype=np.int16)


class SoundSection(Section, frozen=True, kw_only=True):
    """`[teacher.sound]`: the scripted teacher plays its notes, in the scale of `[ear]`, instead of naming them."""

    instrument: InstrumentName = "flute"
    duration_s: Annotated[float, Meta(ge=0.2, le=10)] = 0.35
    noise: NoiseName = "white"
    snr_db: Annotated[float, Meta(ge=-60, le=120)] | None = None
    """The note's mean square over the noise's; None: there is no noise."""
    detune_cents: Annotated[float, Meta(ge=0, le=100)] = 0.0
    """How far a note may be from its place in the scale, up or down; drawn anew for each."""
    rate_hz: Annotated[int, Meta(ge=8000, le=48000)] = 16000
    frame_s: Annotated[float, Meta(ge=0.005, le=1)] = 0.1


class Player:
    """A teacher's instrument; what is played depends on seed, teacher, iteration and note alone."""

    def __init__(self, section: SoundSection, notes_hz: Sequence[float], seed: int) -> None:
        self._section, self._notes_hz, self._seed = section, tuple(notes_hz), seed

    def samples(self, teacher: str, iteration: int, note: int) -> NDArray[np.int16]:
        """Return a note with what is around it, (n,)."""
        own, rate_hz = self._section, self._section.rate_hz
        rng = streams.generator(self._seed, f"sound/{teacher}", iteration)
        cents = rng.uniform(-own.detune_cents, own.detune_cents)
        played = play(own.instrument, self._notes_hz[note] * 2.0 ** (cents / 1200.0), own.duration_s, rate_hz, rng)
        lead, tail = round(LEAD_S * rate_hz), round(TAIL_S * rate_hz)
        length = lead + len(played) + tail
        if own.snr_db is None:
            return to_int16(_placed(played, length, lead))
        return to_int16(mix(played, noise(own.noise, length, rate_hz, rng), own.snr_db))

    def frames(self, teacher: str, iteration: int, note: int | None) -> list[AudioFrame]:
        """Return the note as frames, the last of which ends the utterance; None, silence, is one empty frame."""
        samples = np.zeros(0, np.int16) if note is None else self.samples(teacher, iteration, note)
        size = round(self._section.frame_s * self._section.rate_hz)
        starts = range(0, max(len(samples), 1), size)
        return [
            AudioFrame(
                teacher=teacher,
                iteration=iteration,
                rate_hz=self._section.rate_hz,
                samples=samples[start : start + size],
                begin=start == 0,
                end=start == starts[-1],
            )
            for start in starts
        ]
