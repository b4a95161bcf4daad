"""Episodes as they looked: done again from the log, in another body, and drawn at a few moments.

Owns `Film`. Nobody need have watched the run: a simulated body, begun with the same seed and episode, does the same
actions with the same effect, which is checked against the log. What is no simulation is never moved. Why there are no
pictures is said in their place.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import msgspec
import numpy as np

from mdb_protocol import codec
from mdb_protocol.errors import MdbError
from mdb_protocol.messages import Picture
from mdb_sim.bodies.finding import is_simulated
from mdb_sim.body import Body, BodyError, Numbers, picture_of
from mdb_sim.runs.record import Episode, RunRecord

MOMENTS = 5
"""Pictures of an episode: its beginning, its end, and between."""
ALIKE = 1e-6
"""Numbers of a scene that differ by no more, as a share of 1 or of themselves, are the same."""


class Film(msgspec.Struct, frozen=True, kw_only=True):
    """An episode in pictures."""

    what: str
    """Why this one."""
    start: int
    """The iteration in which it began."""
    steps: int
    event: str
    """With which it ended."""
    score: float | None
    moments: tuple[int, ...] = ()
    """Actions done before each picture."""
    pictures: tuple[bytes, ...] = ()
    """Messages `Picture`, encoded."""
    missing: str = ""
    """Why there are no pictures."""

    def shown(self) -> Iterator[tuple[int, Picture]]:
        """Yield each moment with its picture."""
        encoding = codec.encoding_of(Picture)
        for moment, data in zip(self.moments, self.pictures, strict=True):
            yield moment, codec.decode(Picture, data, encoding)


def films_of(record: RunRecord, chosen: Iterable[tuple[str, Episode, float | None]]) -> tuple[Film, ...]:
    """Return films of episodes of a run; each with why it is shown, and its score."""
    plain = [
        Film(what=what, start=episode.start, steps=episode.steps, event=episode.event, score=score)
        for what, episode, score in chosen
    ]
    if not plain:
        return ()
    try:
        body = _another_body(record)
    except MdbError as error:
        return tuple(msgspec.structs.replace(film, missing=str(error)) for film in plain)
    try:
        return tuple(_filmed(film, record, body) for film in plain)
    finally:
        body.close()


def _another_body(record: RunRecord) -> Body:
    """Make the run's body anew; MdbError tells why there is none."""
    experiment = record.experiment
    name = experiment.robot.body
    try:
        simulated = is_simulated(name, experiment.folder)
    except BodyError as error:
        raise MdbError(str(error)) from error
    if not simulated:
        raise MdbError(f"the body {name!r} does not say that it is simulated, so it is not moved for a picture")
    return experiment.body()


def _filmed(film: Film, record: RunRecord, body: Body) -> Film:
    moments = tuple(np.unique(np.linspace(0, film.steps, MOMENTS).round().astype(int)).tolist())
    try:
        pictures = tuple(_pictures(film, moments, record, body))
    except BodyError as error:
        return msgspec.structs.replace(film, missing=str(error))
    return msgspec.structs.replace(film, moments=moments, pictures=pictures)


def _pictures(film: Film, moments: tuple[int, ...], record: RunRecord, body: Body) -> Iterator[bytes]:
    """Do an episode again and yield its pictures; BodyError when it goes another way, or cannot be drawn."""
    reading = body.reset(record.seed, record.scenes[film.start].episode)
    for done in range(film.steps + 1):
        now = record.scenes[film.start + done]
        if done:
            assert now.action is not None  # those of an episode have one
            reading = body.act(now.action).reading
        _check_same(body.scene(), now.reached if done else now.now, done)
        if done in moments:
            picture = picture_of(body, reading, film.start + done)
            if picture.drawing is None and picture.image is None:
                raise BodyError("this body has neither a drawing nor an image")
            yield codec.encode(picture)


def _check_same(found: Numbers, logged: Numbers, done: int) -> None:
    for name, value in logged.items():
        if name in found and not math.isclose(found[name], value, rel_tol=ALIKE, abs_tol=ALIKE):
            raise BodyError(
                f"done again, the episode goes another way: after {done} actions {name} is {found[name]:g}, in the "
                f"log {value:g}"
            )
