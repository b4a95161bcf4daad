"""The microphone: without package, PortAudio or device it says what is missing; with them it hands over frames."""

import sys
import threading
from typing import Any

import numpy as np
import pytest

from mdb_deploy.teach import microphone
from mdb_deploy.teach.microphone import FRAME_S, Microphone, MicrophoneError


def ignore(_samples: np.ndarray[Any, Any], _rate_hz: int) -> None:
    pass


def test_without_the_package_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    with pytest.raises(MicrophoneError, match=r"needs the sounddevice package: pip install '\.\[sound\]'"):
        Microphone().start(ignore)


def test_without_portaudio_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("sounddevice", reason="needs the sound extra", exc_type=(ImportError, OSError))
    monkeypatch.delitem(sys.modules, "sounddevice")
    monkeypatch.setattr("ctypes.util.find_library", lambda _name: None)
    with pytest.raises(MicrophoneError, match="PortAudio library not found: install PortAudio"):
        Microphone().start(ignore)


def usable() -> Any:
    """The sounddevice package, if it is there and finds PortAudio."""
    try:
        return microphone._sounddevice()
    except MicrophoneError as error:
        pytest.skip(str(error))


def test_a_device_that_is_not_there_is_named_with_how_to_list_those_that_are() -> None:
    usable()
    with pytest.raises(MicrophoneError, match=r"cannot open the microphone 'theremin': .*python -m sounddevice"):
        Microphone(device="theremin").start(ignore)


def test_it_can_be_stopped_before_and_after_it_was_started_in_vain() -> None:
    usable()
    ears = Microphone(device="theremin")
    ears.stop()
    with pytest.raises(MicrophoneError):
        ears.start(ignore)
    ears.stop()


def test_with_a_device_frames_come_and_after_stop_no_more() -> None:
    if not any(device["max_input_channels"] for device in usable().query_devices()):
        pytest.skip("no microphone here")
    frames: list[tuple[np.ndarray[Any, Any], int]] = []
    three = threading.Event()

    def keep(samples: np.ndarray[Any, Any], rate_hz: int) -> None:
        frames.append((samples, rate_hz))
        if len(frames) == 3:
            three.set()

    ears = Microphone()
    ears.start(keep)
    assert three.wait(5.0)
    ears.stop()
    count = len(frames)
    samples, rate_hz = frames[0]
    assert samples.dtype == np.int16
    assert samples.shape == (round(FRAME_S * rate_hz),)
    assert len(frames) == count
