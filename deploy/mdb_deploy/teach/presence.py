"""Whether a teacher is heard: who else teaches, whether the router lets him in, why nothing comes of what he says.

Owns what the router said of his admission.
"""

from __future__ import annotations

from mdb_deploy.teach.view import View
from mdb_protocol.bus import Bus
from mdb_protocol.errors import BusError
from mdb_sim.teaching.service import ROLE

BRAIN_ROLE, EAR_ROLE = "optimizer", "ear"
"""Whose liveliness token means that a brain is at work, and that somebody listens to sound."""
WITHOUT_EFFECT = 3
"""Commands in a row that no report shows before the teacher is told (ours)."""
ADMISSION_S = 3.0
"""Bound on asking whether others see this teacher."""


class Presence:
    """See the module's docstring."""

    def __init__(self, bus: Bus, name: str, *, sounds: bool) -> None:
        """`sounds`: his notes are sound, which needs an ear."""
        self._bus, self._name, self._sounds = bus, name, sounds
        self._admitted: bool | None = None

    def others(self, alive: frozenset[str]) -> tuple[str, ...]:
        """Return the other teachers who are there; `alive` as of `Bus.alive`."""
        teachers = (name.partition("/") for name in sorted(alive))
        return tuple(instance for role, _, instance in teachers if role == ROLE and instance != self._name)

    def trouble(self, view: View, alive: frozenset[str], without_effect: int) -> str | None:
        """Return why nothing that this teacher says can come through, or has; None also when all is over.

        `without_effect`: his commands in a row that no report shows. Asks the router, when it has come.
        """
        if view.finished:
            return None
        if f"{ROLE}/{self._name}" not in alive:
            self._admitted = None
            return "the router is gone; everything goes on by itself when it is back"
        if not self._is_admitted():
            return f"the router does not let you in as {self._name}: keys that were removed, or another's?"
        roles = {name.partition("/")[0] for name in alive}
        if BRAIN_ROLE not in roles:
            return f"no brain is at work as {self._bus.brain}; 'mdb up --no-teacher' starts one"
        if self._sounds and EAR_ROLE not in roles:
            return "nobody listens to sound; the brain gets an ear by 'mdb up --set ear.detector=template'"
        return self._unheard(view) if without_effect >= WITHOUT_EFFECT else None

    def _unheard(self, view: View) -> str:
        """Return why reports do not show this teacher's commands."""
        holder = view.report.holder if view.report else None
        if holder not in (None, self._name):
            return f"{holder} is being obeyed: the brain does not hear your commands until {holder} is silent or gone"
        return (
            f"your commands do not arrive: the router does not let you teach as {self._name}, "
            "or your notes come too late"
        )

    def _is_admitted(self) -> bool:
        """Ask whenever the router has come: with keys it denies without a word, and this bus sees its own token."""
        if self._admitted is None:
            try:
                self._admitted = self._bus.admitted(ROLE, self._name, ADMISSION_S)
            except BusError:
                return True  # the router is gone again, which is told once its tokens are
        return self._admitted
