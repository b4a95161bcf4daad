"""Where the robot was, on disk: written after each action and before anybody sees what it led to.

So an action is never done twice: either the file has it, or nobody knows of it and it comes again. A state is added
to those before it, which takes a hundredth of the time of a new file. Now and then the file begins anew with it.
"""

from __future__ import annotations

import errno
from io import FileIO
from pathlib import Path

import msgpack
import structlog

from mdb_protocol import codec, files, messages
from mdb_protocol.errors import DamageError, DecodeError
from mdb_services.shell.place import LOOKED_S, Place
from mdb_services.shell.whole_file import write_whole

ADDED_BYTES = 2**18
"""A state is added as long as the file has no more than this with it."""

log = structlog.get_logger()


class StateFile:
    """The states of a robot, of which the last counts."""

    def __init__(self, path: Path, *, power_safe: bool = False) -> None:
        """Keep the state at `path`; `power_safe`: also through a loss of power, which costs a disk's round trip."""
        self._path, self._power_safe = path, power_safe
        self._open: tuple[FileIO, Place] | None = None

    def read(self) -> messages.RobotState | None:
        """Return the state, or None when there is none; a damaged file is set aside, and said so.

        Who dies while writing leaves a part of a state: then the one before counts, and nobody knows of another.
        """
        try:
            content = files.content(self._path, codec.MAX_BYTES)
            begin, end = _last(content)
            state = codec.decode(messages.RobotState, content[begin:end], codec.encoding_of(messages.RobotState))
        except FileNotFoundError:
            return None
        except (OSError, DamageError, DecodeError) as error:
            aside = self._path.with_suffix(".damaged")
            log.warning("the robot begins anew: its state cannot be read", reason=str(error), kept_as=str(aside))
            self._path.replace(aside)
            return None
        if end < len(content):
            log.warning("the robot's last state was not written whole; the one before counts", path=str(self._path))
        return state

    def write(self, state: messages.RobotState) -> None:
        """Write a state; OSError when the disk does not take it."""
        payload = codec.encode(state)
        if self._open is None or self._open[0].tell() + len(payload) > ADDED_BYTES:
            self.close()
            write_whole(self._path, payload, power_safe=self._power_safe)
            if not self._power_safe:
                self._open = FileIO(self._path, "ab"), Place(self._path, LOOKED_S)
            return
        file, place = self._open
        try:
            place.check()
            if file.write(payload) < len(payload):
                raise OSError(errno.ENOSPC, "the disk took a part of the robot's state only", str(self._path))
        except OSError:
            self.close()  # whatever is in it now, the next state begins a new file
            raise

    def close(self) -> None:
        """Let go of the file; the next state begins a new one."""
        if self._open is not None:
            self._open[0].close()
            self._open = None


def _last(content: bytes) -> tuple[int, int]:
    """Return where the last state begins and ends; DamageError when there is none."""
    states, begin, end = msgpack.Unpacker(max_buffer_size=len(content)), 0, 0
    states.feed(content)
    try:
        while True:
            states.skip()
            begin, end = end, states.tell()
    except msgpack.OutOfData:
        if not end:
            raise DamageError(f"it ends within the first state, after {len(content)} bytes") from None
    except (msgpack.UnpackException, ValueError) as error:
        raise DamageError(f"after {end} bytes it is no MessagePack: {error}") from error
    return begin, end
