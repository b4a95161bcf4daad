"""What nothing is known of: commands with names, of which only the person who teaches knows what they want."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mdb_sim.teaching.policy import as_listed


class Named:
    """Wants nothing by itself and judges nothing."""

    needs = ()

    def __init__(self, commands: Sequence[str]) -> None:
        self.commands = tuple(commands)
        self.order = as_listed(self.commands)

    def want(self, scene: Mapping[str, float]) -> int | None:
        """See `Policy.want`."""
        del scene
        return None

    def judge(self, before: Mapping[str, float], after: Mapping[str, float], event: str, wanted: int) -> float:
        """See `Policy.judge`."""
        del before, after, event, wanted
        return 0.0

    def expected(self, wanted: int, action: Mapping[str, float]) -> float | None:
        """See `Policy.expected`."""
        del wanted, action
        return None
