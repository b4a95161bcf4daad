"""The ear as a service: whose sound, for which iteration, which note; silence, and what is bounded."""

from typing import Any

import numpy as np
import pytest

from mdb_protocol import keys, messages
from mdb_protocol.errors import ConfigError
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.hearing import ear as ear_module
from mdb_services.hearing.ear import Ear
from tests.services.listening import EAR, RATE_HZ, Clip, clip, noise_clip
from tests.services.small import BRAIN, config

SCALE = EAR.notes_hz[:3]
SECTION: dict[str, Any] = {"notes_hz": list(SCALE)}
FRAME = 1600


class Rig:
    """An ear, and teachers that a test plays by hand."""

    def __init__(self) -> None:
        self.fabric = Fabric()
        self.world = MemoryBus(self.fabric, BRAIN)
        self.heard = self.world.subscriber(keys.HEARD)
        self.ear = self.start()

    def start(self) -> Ear:
        self.ear = Ear(MemoryBus(self.fabric, BRAIN), config(ear=SECTION))
        return self.ear

    def sound(
        self, samples: Clip, iteration: int = 0, teacher: str = "anna", *, rate_hz: int = RATE_HZ, **marks: bool
    ) -> None:
        frame = messages.AudioFrame(teacher=teacher, iteration=iteration, rate_hz=rate_hz, samples=samples, **marks)
        self.world.publisher(keys.AUDIO, teacher=teacher).put(frame)
        assert self.ear.step() is True

    def utter(self, samples: Clip, iteration: int = 0, teacher: str = "anna", rate_hz: int = RATE_HZ) -> None:
        for start in range(0, len(samples), FRAME):
            end = start + FRAME >= len(samples)
            self.sound(samples[start : start + FRAME], iteration, teacher, begin=not start, end=end, rate_hz=rate_hz)

    def commands(self) -> list[tuple[str, int, int | None]]:
        return [(c.teacher, c.iteration, c.note) for c in iter(self.heard.take, None)]


def silence(seconds: float) -> Clip:
    return np.zeros(round(seconds * RATE_HZ), dtype=np.int16)


def test_a_note_becomes_a_command_before_its_utterance_ends() -> None:
    rig = Rig()
    assert rig.ear.step() is False
    samples = clip("flute", 2)
    rig.sound(samples[:4800], 7)
    assert rig.commands() == [("anna", 7, 2)]
    rig.sound(samples[4800:], 7, end=True)
    assert rig.commands() == []


def test_an_utterance_without_a_note_is_silence_and_one_with_a_note_is_not() -> None:
    rig = Rig()
    rig.utter(noise_clip("pink", 1), 3)
    rig.utter(silence(0.2), 4)
    rig.sound(silence(0.0), 5, begin=True, end=True)
    rig.utter(clip("piano", 0), 6)
    assert rig.commands() == [("anna", 3, None), ("anna", 4, None), ("anna", 5, None), ("anna", 6, 0)]


def test_a_note_is_for_the_iteration_of_the_frame_in_which_it_began() -> None:
    rig = Rig()
    lead, samples = silence(0.3), clip("string", 1)
    rig.sound(lead, 10)
    rig.sound(samples[:2000], 11)
    rig.sound(samples[2000:4000], 12)
    rig.sound(samples[4000:], 13, end=True)
    assert rig.commands() == [("anna", 11, 1)]


def test_an_open_microphone_says_each_note_once() -> None:
    rig = Rig()
    for iteration, note in enumerate((0, 0, 2)):
        rig.sound(clip("voice", note), iteration)
        rig.sound(silence(0.2), iteration)
    rig.sound(silence(0.1), 3, end=True)
    assert rig.commands() == [("anna", 0, 0), ("anna", 1, 0), ("anna", 2, 2)]


def test_teachers_are_heard_each_for_themselves_at_their_own_rates() -> None:
    rig = Rig()
    first, second = clip("clarinet", 1), clip("string", 2, rate_hz=44_100)
    for i in range(12):
        rig.sound(first[i * 600 : (i + 1) * 600], 5, "anna")
        rig.sound(second[i * 1600 : (i + 1) * 1600], 5, "bert", rate_hz=44_100)
    assert sorted(rig.commands()) == [("anna", 5, 1), ("bert", 5, 2)]


def test_an_ear_that_died_within_a_note_says_nothing_of_the_rest_and_hears_the_next() -> None:
    rig = Rig()
    note = clip("piano", 1)
    rig.utter(note, 1)
    rig.utter(note, 2)
    rig.sound(note[:1600], 3)
    heard = [("anna", 1, 1), ("anna", 2, 1)]
    assert rig.commands() == heard
    rig.ear.bus.close()
    rig.start()
    rig.sound(silence(0.3), 3, end=True)
    assert rig.commands() == [], "it does not know what was said before"
    rig.utter(note, 3)
    rig.utter(note, 4)
    assert rig.commands() == [("anna", 3, 1), ("anna", 4, 1)]


def test_another_rate_begins_another_utterance() -> None:
    rig = Rig()
    rig.sound(silence(0.1), 1)
    rig.utter(clip("sine", 0, rate_hz=48_000), 2, rate_hz=48_000)
    assert rig.commands() == [("anna", 2, 0)]


def test_of_too_many_teachers_the_one_not_heard_for_longest_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ear_module, "MAX_TEACHERS", 2)
    rig = Rig()
    samples = clip("flute", 1)
    for teacher in ("anna", "bert", "anna", "carl"):
        rig.sound(samples[:1000], 1, teacher)
    assert set(rig.ear._heard) == set(rig.ear._utterances) == {"anna", "carl"}
    rig.sound(samples[1000:], 1, "anna", end=True)
    assert rig.commands()[-1] == ("anna", 1, 1)


def test_marks_of_the_iteration_are_bounded() -> None:
    rig = Rig()
    for iteration in range(3 * ear_module.MARKS):
        rig.sound(silence(0.002), iteration)
    assert len(rig.ear._utterances["anna"].marks) == ear_module.MARKS
    rig.sound(clip("flute", 1), 10**6)
    assert rig.commands() == [("anna", 10**6, 1)]


def test_its_status_counts_what_it_heard() -> None:
    rig = Rig()
    assert rig.ear.values()["analysis_s_per_s"] == 0.0
    rig.utter(clip("flute", 1), 0)
    rig.utter(noise_clip("white", 1), 1)
    values = rig.ear.values()
    assert values["notes"] == 1
    assert values["silences"] == 1
    assert values["frames"] == 5 + 10
    assert values["rejected"] > 20, "windows with noise"
    assert 0 < values["analysis_s_per_s"] < 1


def test_sound_that_is_no_audio_frame_is_refused_and_the_rest_heard() -> None:
    rig = Rig()
    note = messages.Command(teacher="anna", iteration=0, note=1)
    row = keys.Key(keys.AUDIO.path, messages.Command, "", keys.AUDIO.delivery, "")
    rig.world.publisher(row, teacher="anna").put(note)
    rig.utter(clip("flute", 1), 0)
    assert rig.commands() == [("anna", 0, 1)]
    assert rig.ear.bus.refusals.counts[keys.AUDIO.path] == 1


def test_an_ear_needs_its_section_and_as_many_notes_as_the_channel() -> None:
    with pytest.raises(ConfigError, match=r"no \[ear\] section; --set ear\.detector=template"):
        Ear(MemoryBus(Fabric(), BRAIN), config())
    with pytest.raises(ConfigError, match=r"ear\.notes_hz has 7 notes, but channels\.note has 3"):
        config(ear={})
