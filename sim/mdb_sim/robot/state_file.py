"""Where the robot was, on disk: written after each action and before anybody sees what it led to.

So an action is never done twice: either the file has it, or nobody knows of it and it comes again.
"""

from __future__ import annotations

from pathlib import Path

import structlog

from mdb_protocol import codec, files, messages
from mdb_protocol.errors import DamageError, DecodeError
from mdb_services.shell.whole_file import write_whole

log = structlog.get_logger()


class StateFile:
    """The last state of a robot, replaced as a whole."""

    def __init__(self, path: Path, *, power_safe: bool = False) -> None:
        """Keep the state at `path`; `power_safe`: also through a loss of power, which costs a disk's round trip."""
        self._path, self._power_safe = path, power_safe

    def read(self) -> messages.RobotState | None:
        """Return the state, or None when there is none; a damaged file is set aside, and said so."""
        try:
            payload = files.content(self._path, codec.MAX_BYTES)
            return codec.decode(messages.RobotState, payload, codec.encoding_of(messages.RobotState))
        except FileNotFoundError:
            return None
        except (OSError, DamageError, DecodeError) as error:
            aside = self._path.with_suffix(".damaged")
            log.warning("the robot begins anew: its state cannot be read", reason=str(error), kept_as=str(aside))
            self._path.replace(aside)
            return None

    def write(self, state: messages.RobotState) -> None:
        """Replace the state; OSError when the disk does not take it."""
        write_whole(self._path, codec.encode(state), power_safe=self._power_safe)
