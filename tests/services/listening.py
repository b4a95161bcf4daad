"""Clips of notes and of noise for tests of hearing, and what a detector makes of them."""

import numpy as np
from numpy.typing import NDArray

from mdb_services.experiment.sections import EarSection
from mdb_services.hearing.pitch import Heard, NoteDetector
from mdb_sim.teaching.sound import INSTRUMENTS, InstrumentName, NoiseName, mix, noise, play, to_int16

RATE_HZ = 16_000
EAR = EarSection()
Clip = NDArray[np.int16]


def clip(
    instrument: InstrumentName,
    note: int,
    around: NoiseName | None = None,
    snr_db: float = 10.0,
    seed: int = 0,
    *,
    ear: EarSection = EAR,
    rate_hz: int = RATE_HZ,
    duration_s: float = 0.35,
) -> Clip:
    """One note, up to 15 cents out of tune, with a little before it and after."""
    rng = np.random.default_rng([seed, note, INSTRUMENTS.index(instrument)])
    hz = ear.notes_hz[note] * 2.0 ** (rng.uniform(-15.0, 15.0) / 1200.0)
    played = play(instrument, hz, duration_s, rate_hz, rng)
    if around is None:
        return to_int16(np.pad(played, round(0.03 * rate_hz)))
    return to_int16(mix(played, noise(around, len(played) + round(0.07 * rate_hz), rate_hz, rng), snr_db))


def noise_clip(name: NoiseName, seed: int, duration_s: float = 1.0) -> Clip:
    return to_int16(noise(name, round(duration_s * RATE_HZ), RATE_HZ, np.random.default_rng([seed, 99])))


def melody(instrument: InstrumentName, notes: list[int], duration_s: float, gap_s: float, seed: int = 0) -> Clip:
    rng = np.random.default_rng([seed, 7])
    gap = np.zeros(round(gap_s * RATE_HZ))
    pieces = [np.concatenate([play(instrument, EAR.notes_hz[n], duration_s, RATE_HZ, rng), gap]) for n in notes]
    return to_int16(np.concatenate([np.zeros(800), *pieces, np.zeros(800)]))


def listen(samples: Clip, ear: EarSection = EAR, rate_hz: int = RATE_HZ, frame: int = 1600) -> list[Heard]:
    detector = NoteDetector(ear, rate_hz)
    heard = [
        note for start in range(0, len(samples), frame) for note in detector.hear(samples[start : start + frame])
    ]
    return heard + detector.finish()


def notes_in(samples: Clip, ear: EarSection = EAR, rate_hz: int = RATE_HZ) -> list[int]:
    return [heard.note for heard in listen(samples, ear, rate_hz)]
