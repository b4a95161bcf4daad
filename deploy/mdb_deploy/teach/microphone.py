"""A microphone as a source of frames of 16-bit samples, by the sounddevice package (extra `sound`) and PortAudio."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_protocol.errors import MdbError

OnFrame = Callable[[NDArray[np.int16], int], None]
"""Gets samples (n,) and their rate in hertz, in a thread of PortAudio: it must be quick, and not fail."""

FRAME_S = 0.05
RATES_HZ = (8000, 48000)
"""What an `AudioFrame` may have."""
USUAL_RATE_HZ = 16_000


class MicrophoneError(MdbError):
    """There is no microphone to be had; the message says why, and what to do."""


class Microphone:
    """Hands over what a microphone hears, from `start` to `stop`."""

    def __init__(
        self, rate_hz: int = USUAL_RATE_HZ, frame_s: float = FRAME_S, device: int | str | None = None
    ) -> None:
        """`device`: a number or a part of a name as `python -m sounddevice` lists them; None: the system's choice.

        A device that cannot do `rate_hz` is used at its own rate.
        """
        self._rate_hz, self._frame_s, self._device = rate_hz, frame_s, device
        self._stream: Any = None

    def start(self, on_frame: OnFrame) -> None:
        """Begin to listen; MicrophoneError when that cannot be. A microphone that listens begins anew."""
        self.stop()
        sound = _sounddevice()
        try:
            rate_hz = self._usable_rate_hz(sound)

            def hand_over(samples: NDArray[np.int16], _count: int, _time: object, _status: object) -> None:
                on_frame(samples[:, 0].copy(), rate_hz)

            self._stream = sound.InputStream(
                samplerate=rate_hz,
                blocksize=round(self._frame_s * rate_hz),
                device=self._device,
                channels=1,
                dtype="int16",
                callback=hand_over,
            )
            self._stream.start()
        except (sound.PortAudioError, ValueError) as error:
            self.stop()
            wanted = "a microphone" if self._device is None else f"the microphone {self._device!r}"
            raise MicrophoneError(
                f"cannot open {wanted}: {error}; 'python -m sounddevice' lists those that are there"
            ) from error

    def _usable_rate_hz(self, sound: Any) -> int:
        """Return the rate that is wanted if the device has it, or else the device's own within the bounds."""
        try:
            sound.check_input_settings(device=self._device, channels=1, dtype="int16", samplerate=self._rate_hz)
        except sound.PortAudioError:
            own_hz = round(sound.query_devices(self._device, "input")["default_samplerate"])
            return int(np.clip(own_hz, *RATES_HZ))
        return self._rate_hz

    def stop(self) -> None:
        """Listen no more; may be called twice."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None


def _sounddevice() -> Any:
    try:
        import sounddevice
    except ImportError as error:
        raise MicrophoneError("the microphone needs the sounddevice package: pip install '.[sound]'") from error
    except OSError as error:  # what sounddevice raises when it finds no PortAudio
        raise MicrophoneError(f"{error}: install PortAudio (Debian: apt-get install libportaudio2)") from error
    return sounddevice
