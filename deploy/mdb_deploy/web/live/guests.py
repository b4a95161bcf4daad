"""Teachers who come by a browser: each is a `TeachingSession` on a bus of its own, in a thread of its own.

Owns who is who. A name is given to one browser; a page that is loaded again, or whose connection was lost, goes on
with its lesson when it is back in time. Otherwise, and when the bridge ends, the lesson ends.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mdb_deploy.teach.session import TeachingSession
from mdb_deploy.teach.thread import SessionThread
from mdb_deploy.teach.view import Exchange, View
from mdb_deploy.web.live import orders
from mdb_deploy.web.live.finding import Found
from mdb_deploy.web.live.visitor import Visitor
from mdb_deploy.web.telling.hello import scale_hz
from mdb_protocol.errors import MdbError
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_sim.runs.experiment import Experiment
from mdb_sim.teaching.languages import Language, TeacherError, make_language
from mdb_sim.teaching.policy import Policy
from mdb_sim.teaching.service import ROLE

MOST_TEACHERS = 8
BACK_S = 5.0
"""A browser that is gone for longer has left."""
JOIN_S = 6.0
"""Bound on joining a router: less than a browser waits for an answer (10 s), much more than a busy machine needs."""
SAID_AGAIN_S = 0.25
"""So often a browser is told of its lesson when nothing is new: a countdown goes on."""
NOTICED_S = 6.0
"""So long a notice is shown."""
FRAME_SAMPLES = 48_000
"""Of one piece of sound."""


@dataclass
class Guest:
    """One teacher, and the browser that he sits at; None: it is gone."""

    name: str
    owner: str
    """Which browser may go on with the lesson."""
    thread: SessionThread
    visitor: Visitor | None
    ear: bool
    """Whether the brain has an ear, ..."""
    scale_hz: list[float]
    """... and the pitch of each note."""
    gone_s: float = 0.0
    rate_hz: int | None = None
    told: View | None = None
    told_s: float = 0.0

    @property
    def session(self) -> TeachingSession:
        """The session."""
        return self.thread.session


class Guests:
    """See the module's docstring. Used by the loop's thread."""

    def __init__(self, credentials: Path | None) -> None:
        self._credentials = credentials
        self._guests: dict[str, Guest] = {}
        self._coming: set[str] = set()
        self._ending: set[asyncio.Task[None]] = set()

    def of(self, visitor: Visitor) -> Guest:
        """Return the teacher who sits at a browser; MdbError when nobody does."""
        for guest in self._guests.values():
            if guest.visitor is visitor:
                return guest
        raise MdbError("you do not teach; join with a name first")

    def _is_teaching(self, visitor: Visitor) -> bool:
        return any(guest.visitor is visitor for guest in self._guests.values())

    async def join(self, visitor: Visitor, order: orders.Join, found: Found) -> str:
        """Let a browser teach under a name; return words. MdbError says why it cannot."""
        if self._is_teaching(visitor):
            raise MdbError(f"you teach as {self.of(visitor).name} already; leave first")
        experiment = found.experiment
        policy = policy_of(experiment)
        language = language_of(order.language, policy)
        if (guest := self._guests.get(order.name)) is not None and guest.owner == visitor.browser:
            self._sit(guest, visitor)
            if language.notes != guest.session.view.language.notes:
                guest.session.speak(language)
            return f"you go on as {order.name}"
        if order.name in self._guests or order.name in self._coming or order.name in _own_names(experiment):
            raise MdbError(f"somebody teaches as {order.name} already; choose another name")
        if len(self._guests) + len(self._coming) >= MOST_TEACHERS:
            raise MdbError(f"{MOST_TEACHERS} people teach here already; no more can")
        self._coming.add(order.name)
        try:
            thread = await asyncio.to_thread(self._begin, order.name, language, policy, found)
            guest = Guest(
                order.name,
                visitor.browser,
                thread,
                None,
                experiment.brain.ear is not None,
                scale_hz(experiment.brain, len(policy.commands)),
            )
            self._guests[order.name] = guest
        finally:
            self._coming.discard(order.name)
        if visitor.gone:  # while the session began
            guest.gone_s = time.monotonic()
        else:
            self._sit(guest, visitor)
        return f"you teach as {order.name}"

    def _begin(self, name: str, language: Language, policy: Policy, found: Found) -> SessionThread:
        bus = ZenohBus(found.brain, found.endpoint, credentials=self._credentials, connect_timeout_s=JOIN_S)
        try:
            if f"{ROLE}/{name}" in bus.alive():
                raise MdbError(f"somebody teaches {found.brain} as {name} already; choose another name")
            settings = found.experiment.brain.optimizer
            session = TeachingSession(
                bus,
                name,
                language,
                policy,
                listens=False,
                patience_s=(settings.command_patience_s, settings.feedback_patience_s),
            )
        except BaseException:
            bus.close()
            raise
        thread = SessionThread(session)
        thread.start()
        return thread

    def _sit(self, guest: Guest, visitor: Visitor) -> None:
        """Let a browser go on with a lesson; another one of the same person is told that it has none."""
        if guest.visitor is not None and guest.visitor is not visitor:
            guest.visitor.tell({"is": "you", "name": None})
        guest.visitor, guest.told, guest.rate_hz = visitor, None, None

    def back(self, visitor: Visitor) -> None:
        """A browser has come: if it was gone from a lesson just now, it goes on with it."""
        for guest in self._guests.values():
            if guest.visitor is None and guest.owner == visitor.browser:
                self._sit(guest, visitor)
                return
        if not self._is_teaching(visitor):
            visitor.tell({"is": "you", "name": None})

    def gone(self, visitor: Visitor) -> None:
        """A browser is gone; perhaps it comes back."""
        for guest in self._guests.values():
            if guest.visitor is visitor:
                guest.visitor, guest.gone_s = None, time.monotonic()

    async def leave(self, visitor: Visitor) -> str:
        """End the lesson of a browser; return words."""
        guest = self.of(visitor)
        await self._end(guest, "")
        return f"{guest.name} has left"

    def _end_soon(self, guest: Guest, trouble: str) -> None:
        self._guests.pop(guest.name, None)
        ending = asyncio.create_task(self._end(guest, trouble))
        self._ending.add(ending)
        ending.add_done_callback(self._ending.discard)

    async def _end(self, guest: Guest, trouble: str) -> None:
        """End a lesson, and sum it up for who sits there."""
        self._guests.pop(guest.name, None)
        await asyncio.to_thread(guest.thread.stop)
        if guest.visitor is not None:
            summary = asdict(guest.session.view.summary)
            guest.visitor.tell({"is": "you", "name": None, "trouble": trouble or None, "summary": summary})

    def obey(self, visitor: Visitor, order: orders.TEACHING) -> str:
        """Do what a teacher wants; return words. MdbError says why it cannot be."""
        guest = self.of(visitor)
        session, view = guest.session, guest.session.view
        match order:
            case orders.SayNote(note=note):
                if note is not None and note >= len(view.language.notes):
                    raise MdbError(f"there is no note {note}; there are 0 to {len(view.language.notes) - 1}")
                session.command(note)
            case orders.Judge(iteration=iteration, value=value):
                if view.scene is None or iteration >= view.scene.iteration:
                    raise MdbError(f"the action of iteration {iteration} is not done yet")
                session.feedback(value, iteration)
            case orders.Speak(language=said):
                session.speak(language_of(said, session.policy))
            case orders.Wait(on=on):
                session.wait_for_me(on)
            case orders.Silent(on=on):
                if on != view.paused:
                    session.pause()
            case orders.Auto(on=on):
                session.play_by_itself(on)
            case orders.Sound(rate_hz=rate_hz):
                if rate_hz is not None and not guest.ear:
                    raise MdbError("this brain has no ear; 'mdb up --set ear.detector=template' gives it one")
                guest.rate_hz = rate_hz
            case _:
                raise MdbError("this is no order of a teacher")
        return "done"

    def sound(self, visitor: Visitor, samples: bytes) -> None:
        """Pass on what a browser's microphone hears; MdbError when that cannot be."""
        guest = self.of(visitor)
        if guest.rate_hz is None:
            raise MdbError("sound comes, and its rate was not said: {'do': 'microphone', 'rate_hz': 16000}")
        if len(samples) % 2 or not 0 < len(samples) <= 2 * FRAME_SAMPLES:
            raise MdbError(f"{len(samples)} bytes of sound; expected 2 for each of at most {FRAME_SAMPLES} samples")
        guest.session.microphone(np.frombuffer(samples, "<i2").astype(np.int16), guest.rate_hz)

    def tick(self) -> None:
        """Tell each browser of its lesson what is new; end the lessons of those who are gone."""
        now_s = time.monotonic()
        for guest in list(self._guests.values()):
            if not guest.thread.running:
                why = guest.thread.failure
                self._end_soon(guest, f"the lesson has ended: {why}" if why else "the lesson has ended")
            elif guest.visitor is None:
                if now_s - guest.gone_s > BACK_S:
                    self._end_soon(guest, "")
            elif guest.session.view is not guest.told or now_s - guest.told_s >= SAID_AGAIN_S:
                guest.told, guest.told_s = guest.session.view, now_s
                guest.visitor.tell(you(guest.name, guest.session.view, guest.scale_hz, now_s))

    async def close(self, why: str) -> None:
        """End all lessons."""
        ending = [self._end(guest, why) for guest in list(self._guests.values())]
        await asyncio.gather(*ending, *self._ending)


def you(name: str, view: View, pitches_hz: list[float], now_s: float) -> dict[str, Any]:
    """Return the frame `you` of a teacher. `now_s`: the session's clock."""
    turn, report, heard = view.turn, view.report, view.heard
    tone = None
    if heard is not None and heard.note is not None:
        tone = {"hz": pitches_hz[heard.note] if heard.note < len(pitches_hz) else None, "note": heard.note}
    return {
        "is": "you",
        "name": name,
        "language": list(view.language.notes),
        "turn": {
            "kind": turn.kind,
            "iteration": turn.iteration,
            "left_s": None if turn.until_s is None else round(max(0.0, turn.until_s - now_s), 2),
        },
        "obedience": view.obedience,
        "judged": view.judged,
        "wanted": view.wanted,
        "paused": view.paused,
        "waits": view.waits,
        "auto": view.auto,
        "others": list(view.others),
        "obeyed": None if report is None else report.holder,
        "trouble": view.trouble,
        "notice": view.notice if now_s - view.noticed_s < NOTICED_S else None,
        "exchanges": [_exchange(exchange) for exchange in view.exchanges],
        "heard": tone,
        "summary": asdict(view.summary),
    }


def _exchange(exchange: Exchange) -> dict[str, Any]:
    said = asdict(exchange)
    del said["spoke"]
    return said


def policy_of(experiment: Experiment) -> Policy:
    """Return what can be wanted of the robot: by the file's teacher, or else one command a choice.

    MdbError when there is neither.
    """
    try:
        policy = experiment.policy()
    except ValueError as error:
        raise MdbError(f"this robot cannot be taught from here: {error}") from error
    if policy is None:
        raise MdbError("nothing is known of what this robot can be taught: its experiment file has no [teacher]")
    return policy


def language_of(said: list[int] | str, policy: Policy) -> Language:
    """Return the language that a page asked for; MdbError when there is none."""
    name = f"notes:{','.join(map(str, said))}" if isinstance(said, list) else said
    if name == "random":
        name = f"random:{secrets.randbelow(2**32)}"
    try:
        return make_language(name, policy.order)
    except TeacherError as error:
        raise MdbError(f"language: {error}") from error


def _own_names(experiment: Experiment) -> frozenset[str]:
    """Return the names under which the experiment's own teachers speak."""
    if experiment.teacher is None:
        return frozenset({"script"})
    return frozenset({"script", *(phase.teacher for phase in experiment.teacher.phase if phase.teacher)})
