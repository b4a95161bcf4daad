"""A run of before, read from its folder. INTERFACE (this is the first commit; the bodies follow)."""

from __future__ import annotations

from pathlib import Path
from typing import Any


class PastRun:
    """A run folder that is looked at. Reads only. Used by one thread at a time."""

    def __init__(self, folder: Path) -> None:
        """Read the log's index; MdbError says what is missing or damaged."""

    def hello(self) -> dict[str, Any]:
        """Return the frame `hello`; `live` is false."""
        return {}

    def rows(self) -> dict[str, Any]:
        """Return all rows (at most 100 000)."""
        return {}

    def at(self, iteration: int, *, picture: bool = False) -> dict[str, Any]:
        """Return all parts at the moment when the action of an iteration was chosen, with what came of it.

        An iteration beyond the log's end is its last one. picture: with the picture, for which the episode is done
        again in another body (`picture` then also has `missing`: words, or null).
        """
        return {}

    def picture(self, iteration: int) -> dict[str, Any]:
        """Return {iteration, drawing, image, missing: why there is none, or null}."""
        return {}

    def files(self) -> list[dict[str, Any]]:
        """Return what may be downloaded: [{path (relative, with /), bytes}]."""
        return []

    def file(self, path: str) -> Path | None:
        """Return the path of one of `files`; None when it is none of them."""
        return None

    def close(self) -> None:
        """Free the body of the pictures."""
