"""Hearing a note: when one begins in a stream of samples, and which of a scale it is. Pure numpy.

Each window of sound gets one pitch and its tonality, how much the window is that pitch. A note counts when several
windows in a row agree on it and it is louder than it was of late; so it counts once however long it sounds or dies
away, and again when it is played again. What was heard is a function of the samples alone, not of how they were cut
into frames. Method and constants are ours; matching spectra with a comb of harmonics is an old way (say, Camacho and
Harris 2008, "A sawtooth waveform inspired pitch estimator"; their kernel is another).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdb_protocol.errors import ConfigError
from mdb_services.experiment.sections import EarSection

Samples = NDArray[np.float64]

PARTIALS = 8
"""Harmonics of a pitch that a template has; the higher ones are weak, and out of tune on strings."""
_K = np.arange(1.0, PARTIALS + 1)
TIMBRES = np.array(
    [
        1.0 / _K,
        1.0 / (1.0 + np.square((_K - 2.0) / 1.5)),
        1.0 / (1.0 + np.square((_K - 4.0) / 1.5)),
        np.where(_K % 2 == 1, 1.0 / np.sqrt(_K), 0.1),
    ]
)
"""Amplitudes of the partials in four templates of each pitch: falling, loudest at the second or at the fourth, odd.
With the first alone voices and reeds whose fundamental is weak are heard an octave too high, or not at all."""
LOBE_BINS = 2
"""On each side of a partial: within them lies nearly all of a Hann window's spectrum."""
LOWEST_BINS = 4.0
"""Below so many bins of the spectrum the partials of a pitch cannot be told apart."""
CANDIDATE_CENTS = 10.0
BELOW, ABOVE = 4.0, 2.0
"""Pitches are looked for this many times below and above the scale: who speaks there is not taken for a note."""
HIGHEST = 0.45
"""Of the sampling rate: what lies above was filtered away by the microphone."""
SPREAD_CENTS = 30.0
"""Windows that agree on a note agree on its pitch too; a voice that talks glides."""
FALL = 0.8
"""Of the way to a lower level that the floor of a note goes in one window."""
CLIMB_S = 2.0
"""Time constant with which the floor of a note comes up to a higher level."""
SWELL_S = 0.16
"""A note may become louder for so long after it was heard without being another one."""
NEVER = -1
"""In place of the sample at which a note has risen over its floor."""
SWIFT_RATE_HZ = 16_000


class Pitch(NamedTuple):
    """What a window sounds like: its pitch, and how much it is that pitch alone, from 0 to 1."""

    hz: float
    tonality: float


class Heard(NamedTuple):
    """A note of the scale, and the sample, counted from the first one, at which it began."""

    note: int
    began: int


Estimator = Callable[[Samples], Pitch]
"""From a window of samples (n,) to its pitch."""


class Template:
    """Spectra of all pitches that could be, at one sampling rate, and of the notes of a scale."""

    def __init__(self, notes_hz: tuple[float, ...], window_s: float, rate_hz: int) -> None:
        self.size, self._rate_hz = round(window_s * rate_hz), rate_hz
        bin_hz = rate_hz / self.size
        lowest_hz = max(notes_hz[0] / BELOW, LOWEST_BINS * bin_hz)
        highest_hz = min((PARTIALS + 0.5) * notes_hz[-1], HIGHEST * rate_hz)
        octaves = np.log2(min(ABOVE * notes_hz[-1], highest_hz) / lowest_hz)
        self._pitches_hz = lowest_hz * 2.0 ** np.arange(0.0, octaves, CANDIDATE_CENTS / 1200.0)
        self._band = slice(int(0.7 * lowest_hz / bin_hz), int(highest_hz / bin_hz) + 2)
        rows = np.concatenate([_combs(self._pitches_hz, weights, self.size, rate_hz) for weights in TIMBRES])
        rows = rows[:, self._band]
        rows -= rows.mean(axis=1, keepdims=True)
        self._rows = (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)
        self._notes = _combs(np.array(notes_hz), np.ones(PARTIALS), self.size // 2, rate_hz)

    def pitch(self, window: Samples) -> Pitch:
        """Return the pitch whose template is most like the spectrum; the tonality is their correlation.

        Measured: of the instruments in the tests it is 0.8 or more, 0.57 in noise as loud as they; of white and pink
        noise 0.3 at the most; of ten people who talk up to 0.8 for a moment.
        """
        spectrum = _spectrum(window)[self._band]
        deviation = spectrum - spectrum.mean()
        likeness = self._rows @ deviation.astype(np.float32)
        best = int(likeness.argmax())
        return Pitch(
            float(self._pitches_hz[best % len(self._pitches_hz)]),
            float(likeness[best] / max(np.linalg.norm(deviation), 1e-12)),
        )

    def levels_db(self, window: Samples, note: int | None, hz: float) -> Samples:
        """Return how loud each note (n,) is in the newer half of a window, in decibels below a sine of full scale.

        While a note sounds, at `hz`, its partials do not count for the others: C5 has every second one of C4.
        """
        power = np.square(_spectrum(window[-(self.size // 2) :]))
        levels = self._notes @ power
        if note is not None:
            bins_per_partial = hz * (self.size // 2) / self._rate_hz
            offset = np.arange(len(power)) / bins_per_partial
            power[np.abs(offset - np.round(offset)) * bins_per_partial < 2.0] = 0.0
            levels = np.where(np.arange(len(levels)) == note, levels, self._notes @ power)
        return np.asarray(10.0 * np.log10(np.maximum(levels, 1e-20)))


def _spectrum(samples: Samples) -> Samples:
    """Return the magnitudes (n // 2 + 1,) of samples (n,) within ±1; 1 for a sine of full scale."""
    taper = np.hanning(len(samples) + 2)[1:-1]
    return np.asarray(np.abs(np.fft.rfft(samples * taper)) * (2.0 / taper.sum()))


def _combs(pitches_hz: Samples, weights: Samples, size: int, rate_hz: int) -> Samples:
    """Return the spectra (p, size // 2 + 1) of tones at these pitches (p,) with partials of these weights."""
    combs = np.zeros((len(pitches_hz), size // 2 + 1))
    for k, weight in enumerate(weights, 1):
        centres = k * pitches_hz[:, None] * size / rate_hz
        bins = np.ceil(centres - LOBE_BINS).astype(np.int64) + np.arange(2 * LOBE_BINS + 1)
        rows, places = np.nonzero((bins >= 0) & (bins < combs.shape[1]))
        near = bins[rows, places]
        combs[rows, near] += weight * _main_lobe(near - centres[rows, 0])
    return combs


def _main_lobe(offset_bins: Samples) -> Samples:
    """The spectrum of a Hann window, within `LOBE_BINS`."""
    inside = np.where(np.abs(np.abs(offset_bins) - 1.0) < 1e-6, 1.0 + 1e-5, offset_bins)
    return np.asarray(np.where(np.abs(inside) < LOBE_BINS, np.sinc(inside) / (1.0 - np.square(inside)), 0.0))


@lru_cache(maxsize=8)
def _template(notes_hz: tuple[float, ...], window_s: float, rate_hz: int) -> Template:
    """All teachers with one sampling rate share a template: it is some megabytes large."""
    return Template(notes_hz, window_s, rate_hz)


@lru_cache(maxsize=1)
def _swift_f0() -> Any:
    try:
        from swift_f0 import SwiftF0
    except ImportError as error:
        raise ConfigError(
            "ear.detector is 'swift-f0', which is not installed; pip install '.[sound]', or take 'template'"
        ) from error
    return SwiftF0(threads=1, spin=False)


def _by_swift_f0(rate_hz: int) -> Estimator:
    """Return the network of the swift-f0 package, whose answer for a window is the median of its voiced frames."""
    network = _swift_f0()

    def estimate(window: Samples) -> Pitch:
        size = round(len(window) * SWIFT_RATE_HZ / rate_hz)
        resampled = np.fft.irfft(np.fft.rfft(window), size) * (size / len(window))
        found = network.detect(resampled, SWIFT_RATE_HZ)
        voiced = found.pitch_hz[found.confidence >= 0.5]
        return Pitch(float(np.median(voiced)) if len(voiced) else 0.0, float(np.median(found.confidence)))

    return estimate


class NoteDetector:
    """Finds the notes of a scale in a stream of samples of one teacher; see the module's docstring."""

    def __init__(self, config: EarSection, rate_hz: int) -> None:
        """Raise ConfigError when the detector that the configuration names is not installed."""
        self.rate_hz = rate_hz
        self.windows = self.rejected = 0
        """Windows heard, and those of them in which something else than a note of the scale sounded."""
        self._config = config
        self._template = _template(config.notes_hz, config.window_s, rate_hz)
        self._estimate = self._template.pitch if config.detector == "template" else _by_swift_f0(rate_hz)
        self._notes_hz = np.array(config.notes_hz)
        self._hop = round(config.hop_s * rate_hz)
        self._climb = config.hop_s / CLIMB_S
        self._swell = round(SWELL_S / config.hop_s)
        self._waiting: Samples = np.zeros(0)
        self._start = 0
        self._rose = np.full(len(config.notes_hz), NEVER)
        self._floors_db = np.full(len(config.notes_hz), config.quiet_db)
        self._agreeing: deque[float] = deque(maxlen=config.stable_windows)
        self._certainty = 0.0
        self._note: int | None = None
        self._since = 0
        self._swelling = np.zeros(len(config.notes_hz), dtype=np.int64)

    def hear(self, samples: NDArray[np.int16]) -> list[Heard]:
        """Take the next samples (n,), n of any size, and return the notes that are certain by now."""
        self._waiting = np.concatenate([self._waiting, samples / 32768.0])
        heard = []
        while len(self._waiting) >= self._template.size:
            note = self._window(self._waiting[: self._template.size])
            if note is not None:
                heard.append(note)
            self._waiting = self._waiting[self._hop :]
            self._start += self._hop
        return heard

    def finish(self) -> list[Heard]:
        """Return what is in the samples that did not fill a window: nothing follows them."""
        return self.hear(np.zeros(self._template.size, dtype=np.int16))

    def _window(self, window: Samples) -> Heard | None:
        """Take one window; return the note that it makes certain."""
        self.windows += 1
        note, pitch = self._note_in(window)
        levels_db = self._template.levels_db(window, note, pitch.hz)
        risen = levels_db >= self._floors_db + self._config.rise_db
        rising = risen & (self._rose == NEVER)
        self._rose[rising] = self._start + self._template.size - self._hop
        self._rose[~risen] = NEVER
        if note is None or note != self._note or rising[note]:
            self._note, self._since, self._certainty = note, self._start, 0.0
            self._agreeing.clear()
        heard = None
        if note is not None:
            self._agreeing.append(pitch.hz)
            self._certainty += pitch.tonality - self._config.tonality
            if self._rose[note] != NEVER and self._is_certain():
                heard = Heard(note, max(int(self._rose[note]), self._since + self._template.size // 2))
                self._swelling[note] = self._swell
        self._follow(levels_db)
        return heard

    def _note_in(self, window: Samples) -> tuple[int | None, Pitch]:
        """Return which note a window is, None for silence, noise, and a pitch between the notes; and its pitch."""
        if np.sqrt(np.mean(np.square(window))) < 10.0 ** (self._config.quiet_db / 20.0):
            return None, Pitch(0.0, 0.0)
        pitch = self._estimate(window)
        if pitch.tonality >= self._config.tonality:
            cents = np.abs(1200.0 * np.log2(pitch.hz / self._notes_hz))
            note = int(cents.argmin())
            if cents[note] <= self._config.tolerance_cents:
                return note, pitch
        self.rejected += 1
        return None, pitch

    def _is_certain(self) -> bool:
        if len(self._agreeing) < self._config.stable_windows or self._certainty < self._config.certainty:
            return False
        return 1200.0 * math.log2(max(self._agreeing) / min(self._agreeing)) <= SPREAD_CENTS

    def _follow(self, levels_db: Samples) -> None:
        """Let the floor of each note follow its level: down soon, up slowly, but at once after it was heard."""
        above_db = levels_db - self._floors_db
        swells = (self._swelling > 0) & (above_db > -self._config.rise_db)
        self._swelling = np.where(swells, self._swelling - 1, 0)
        self._floors_db += np.where(above_db < 0.0, FALL, np.where(swells, 1.0, self._climb)) * above_db
