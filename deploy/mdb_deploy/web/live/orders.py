"""What a page may ask for: one JSON object each, told apart by its field `do`. Pure: reads and checks."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
from msgspec import Meta

from mdb_protocol.errors import MdbError
from mdb_protocol.messages.basics import Iteration, Name

MOST_BYTES = 64 * 2**10
"""Of one order, and of one frame of sound."""
RATES_HZ = (8000, 48_000)
"""Of a microphone, at least and at most: what an `AudioFrame` may have."""

Note = Annotated[int, Meta(ge=0, le=127)]
Notes = Annotated[list[Note], Meta(min_length=1, max_length=128)]
Word = Annotated[str, Meta(min_length=1, max_length=600)]


class OrderError(MdbError):
    """An order that is not understood; the text says what was wrong with it."""


class Order(msgspec.Struct, frozen=True, kw_only=True, tag_field="do", forbid_unknown_fields=True):
    """What all orders have in common."""


class Join(Order, tag="join", frozen=True, kw_only=True):
    """Teach under this name; `language`: the note of each command, or a name as `make_language` takes it."""

    name: Name
    language: Notes | Word = "reversed"


class Leave(Order, tag="leave", frozen=True, kw_only=True):
    """End the lesson."""


class SayNote(Order, tag="note", frozen=True, kw_only=True):
    """Say a note for the coming action; None: silence."""

    note: Note | None


class Judge(Order, tag="judge", frozen=True, kw_only=True):
    """Reward or punish the action of an iteration."""

    iteration: Iteration
    value: Annotated[float, Meta(ge=-1, le=1)]


class Speak(Order, tag="speak", frozen=True, kw_only=True):
    """Mean something else by the notes from now on."""

    language: Notes | Word


class Wait(Order, tag="wait", frozen=True, kw_only=True):
    """Let the brain wait for this teacher, or no longer."""

    on: bool


class Silent(Order, tag="silent", frozen=True, kw_only=True):
    """Be there but say nothing, or speak again."""

    on: bool


class Auto(Order, tag="auto", frozen=True, kw_only=True):
    """Let the session teach by itself with this teacher's language, or no longer."""

    on: bool


class Sound(Order, tag="microphone", frozen=True, kw_only=True):
    """Sound follows in binary frames at this rate, or no longer (None)."""

    rate_hz: Annotated[int, Meta(ge=RATES_HZ[0], le=RATES_HZ[1])] | None


class ChangeRobot(Order, tag="change", frozen=True, kw_only=True):
    """Something of the robot is to be another."""

    settings: Annotated[dict[str, Any], Meta(min_length=1, max_length=64)]


class ControlRun(Order, tag="control", frozen=True, kw_only=True):
    """Pause, pace, the scripted teacher, the end of the phase; what is left out stays as it is."""

    paused: bool | msgspec.UnsetType = msgspec.UNSET
    action_s: Annotated[float, Meta(ge=0, le=60)] | msgspec.UnsetType | None = msgspec.UNSET
    script: bool | msgspec.UnsetType = msgspec.UNSET
    end_phase: bool = False


TEACHING = Join | Leave | SayNote | Judge | Speak | Wait | Silent | Auto | Sound
OPERATING = ChangeRobot | ControlRun
ALL = TEACHING | OPERATING
_DECODER = msgspec.json.Decoder(ALL)
_KNOWN = ", ".join(sorted(str(kind.__struct_config__.tag) for kind in ALL.__args__))


def read(text: str) -> ALL:
    """Return the order; OrderError says what was wrong with the text."""
    if len(text) > MOST_BYTES:
        raise OrderError(f"an order of {len(text)} letters; at most {MOST_BYTES} are read")
    try:
        order: ALL = _DECODER.decode(text)
    except msgspec.ValidationError as error:
        known = f"; there are {_KNOWN}" if "$.do" in str(error) or "`do`" in str(error) else ""
        raise OrderError(f"this order is not understood: {error}{known}") from error
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise OrderError(f"this is not JSON: {error}; expected an object as in {{'do': 'leave'}}") from error
    return order


def what_of(text: str) -> str:
    """Return what an order asks for, as far as that can be told, for the answer to it."""
    try:
        found = msgspec.json.decode(text[:MOST_BYTES])
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return ""
    do = found.get("do") if isinstance(found, dict) else None
    return do[:40] if isinstance(do, str) else ""
