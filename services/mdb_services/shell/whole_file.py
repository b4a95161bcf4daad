"""Files that are there whole or not at all, whenever the writer dies."""

from __future__ import annotations

import os
from pathlib import Path


def write_whole(path: Path, content: bytes, *, power_safe: bool = False, private: bool = False) -> None:
    """Replace a file; OSError when the disk does not take it, and then all is as it was.

    power_safe: also through a loss of power, which costs a disk's round trip. private: for its owner only.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
        with os.fdopen(os.open(partial, flags, 0o600 if private else 0o666), "wb") as file:
            file.write(content)
            if power_safe:
                file.flush()
                os.fsync(file.fileno())
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
