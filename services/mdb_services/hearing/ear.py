"""The ear: listens to the sound of all teachers and says which notes are in it, as commands (paper, section 3).

Owns what turns sound into notes of the `[ear]` section's scale; never what a note means. Each utterance stands alone:
what is heard in it does not depend on those before, so an ear that is started again hears the next one the same.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus, Publisher
from mdb_protocol.errors import ConfigError
from mdb_services.experiment.brain import BrainConfig
from mdb_services.hearing.pitch import Heard, NoteDetector

ROLE = "ear"
USUAL_RATE_HZ = 16_000
MAX_TEACHERS = 64
"""Of more, the one that was not heard for longest is forgotten."""
AT_ONCE = 32
"""Frames taken in one step; between steps the service answers queries."""
MARKS = 256
"""Changes of the iteration within an utterance that are kept; a note is certain after fewer."""


@dataclass
class _Utterance:
    """The sound of one teacher from its beginning, or from the end of the one before."""

    detector: NoteDetector
    marks: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=MARKS))
    """From which sample on a note is meant for which iteration."""
    samples: int = 0
    notes: int = 0
    whole: bool = False
    """Whether it was heard from its beginning; of another, silence means nothing."""

    def take(self, frame: messages.AudioFrame) -> list[Heard]:
        """Return the notes that are certain with this frame."""
        if not self.marks or self.marks[-1][1] != frame.iteration:
            self.marks.append((self.samples, frame.iteration))
        self.samples += len(frame.samples)
        heard = self.detector.hear(frame.samples)
        return heard + self.detector.finish() if frame.end else heard

    def iteration_at(self, sample: int) -> int:
        """Return the iteration of the frame in which this sample came."""
        return next((iteration for first, iteration in reversed(self.marks) if first <= sample), self.marks[0][1])


class Ear:
    """See the module's docstring."""

    role, instance = ROLE, "notes"

    def __init__(self, bus: Bus, config: BrainConfig) -> None:
        """Raise ConfigError when there is no `[ear]`, or its detector is not installed."""
        if config.ear is None:
            raise ConfigError("the experiment file has no [ear] section; --set ear.detector=template gives it one")
        self.bus = bus
        self._config = config.ear
        NoteDetector(self._config, USUAL_RATE_HZ)  # what is missing is said now, and what takes long is done now
        self._heard: dict[str, Publisher] = {}
        self._utterances: dict[str, _Utterance] = {}
        self._counts = dict.fromkeys(("frames", "notes", "silences", "rejected"), 0)
        self._sound_s = self._analysis_s = 0.0
        self._audio = bus.subscriber(keys.AUDIO)

    def step(self) -> bool:
        """Listen to the frames that have come."""
        for taken in range(AT_ONCE):
            frame = self._audio.take()
            if frame is None:
                return taken > 0
            self._listen(frame)
        return True

    def _listen(self, frame: messages.AudioFrame) -> None:
        started_s = time.perf_counter()
        self._make_room(frame.teacher)
        utterance = self._utterances.get(frame.teacher)
        if utterance is None or frame.begin or utterance.detector.rate_hz != frame.rate_hz:
            utterance = _Utterance(NoteDetector(self._config, frame.rate_hz), whole=frame.begin)
        self._utterances[frame.teacher] = utterance
        rejected = utterance.detector.rejected
        for heard in utterance.take(frame):
            utterance.notes += 1
            self._say(frame.teacher, utterance.iteration_at(heard.began), heard.note)
        if frame.end:
            if utterance.whole and not utterance.notes:
                self._say(frame.teacher, frame.iteration, None)
            del self._utterances[frame.teacher]
        self._counts["frames"] += 1
        self._counts["rejected"] += utterance.detector.rejected - rejected
        self._sound_s += len(frame.samples) / frame.rate_hz
        self._analysis_s += time.perf_counter() - started_s

    def _make_room(self, teacher: str) -> None:
        """Let this teacher be the one heard last; forget whoever is one too many."""
        known = self._heard.pop(teacher) if teacher in self._heard else None
        self._heard[teacher] = known or self.bus.publisher(keys.HEARD, teacher=teacher)
        if len(self._heard) > MAX_TEACHERS:
            longest_ago = next(iter(self._heard))
            del self._heard[longest_ago]
            self._utterances.pop(longest_ago, None)

    def _say(self, teacher: str, iteration: int, note: int | None) -> None:
        self._heard[teacher].put(messages.Command(teacher=teacher, iteration=iteration, note=note))
        self._counts["silences" if note is None else "notes"] += 1

    def values(self) -> dict[str, float]:
        """Frames; notes, and utterances without one; windows in which something else sounded; cost of a second."""
        counts = {name: float(count) for name, count in self._counts.items()}
        return counts | {"analysis_s_per_s": self._analysis_s / self._sound_s if self._sound_s else 0.0}

    def close(self) -> None:
        """Nothing to free."""
