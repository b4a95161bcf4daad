"""The duties of a robot over the wire, numbered: in the protocol's page and in what `mdb check-robot` says.

Owns their words. How a duty is tried is in `mdb_deploy.trials`.
"""

from __future__ import annotations

from typing import NamedTuple

SHOWN_AGAIN_S = 0.25
"""What is perceived is shown again after this, as long as no action comes."""
INSISTS_S = 1.0
"""So long must the brain say another count before a robot that has acted believes it."""


class Duty(NamedTuple):
    """What a robot owes: in a few words, in full, and why."""

    title: str
    text: str
    why: str


DUTIES = {
    1: Duty(
        "be there, and alone",
        "At your start declare the liveliness token `claim/robot/body/NAME`, NAME being letters and digits that "
        "you draw at random; then ask who else holds `claim/robot/body/*` or `alive/robot/*`. When nobody does, the "
        "place is yours. While somebody does, do not start: end at once when one of those keys sorts before your "
        "claim, else ask again, for 3 s at the most. Keep the claim, and declare `alive/robot/body` when you are "
        "ready, after all else.",
        "The brain begins when `alive/robot/body` is there. Two robots of one brain would mix: of two that start in "
        "the same moment each sees the other's claim, and the names say which of them ends.",
    ),
    2: Duty(
        "speak the protocol",
        "Send MessagePack with the encoding `application/msgpack;mdb=2;NAME`, NAME being the message, which fits its "
        "schema. Every number is finite and within ±1e6.",
        "What is anything else is counted, dropped, and never read: the robot would look dead.",
    ),
    3: Duty(
        "sense what the experiment file names",
        "Each `[channels.NAME]` that is neither note, action, feedback nor an actuator is a reading of that name: a "
        "number, or a list of as many as the file says. What is not perceived is left out. Before each perception "
        "put the scene of the same iteration, with the numbers that the teacher's policy looks at.",
        "Models learn from these names alone. A scripted teacher sees nothing but the scene.",
    ),
    4: Duty(
        "show again",
        "While no action comes, put scene and perception again every 0.25 s.",
        "A plain publisher has no history: a brain or teacher that comes late, or anew, sees you only so. Showing "
        "again is also the question for an action that got lost.",
    ),
    5: Duty(
        "with a new stamp each time",
        "`stamp` is the time of showing in seconds of a clock of your own that only goes forward.",
        "An action answers the stamp of what was shown last, so that you can tell how old it is by your own clock.",
    ),
    6: Duty(
        "do the action, then show",
        "Do the action whose `iteration` is the one that you show; then show `iteration` + 1, with the event, the "
        "`outcome` that it led to, and the `reading` from which the next starts (the same, unless an episode ended).",
        "This is one step of learning. The brain waits for it, and sends the action again every half second.",
    ),
    7: Duty(
        "give back what was done",
        "`done` is the action that led here, all of it: `intention` too, unread and unchanged.",
        "A brain that died meanwhile forms the pair from it; nothing is lost.",
    ),
    8: Duty(
        "do an iteration once",
        "An action of an iteration that you have done is not done again, whatever its stamp: show again instead.",
        "Actions come twice when an answer was lost. Done twice, the outcome is that of two.",
    ),
    9: Duty(
        "do nothing too old",
        "An action is void when your clock says more than its `stamp` + `valid_for_s`, or less than its `stamp`: "
        "show again instead.",
        "After a frozen process or a slow network, nothing from before moves the robot.",
    ),
    10: Duty(
        "refuse what is no action",
        "Drop, and live on after, bytes that are no message, another major version, actuators that you lack or are "
        "not told, values beyond their range.",
        "On an open router anybody can put anything.",
    ),
    11: Duty(
        "take the brain's count",
        "An action of a later iteration is done, and counted from, if you have not acted yet. Later only when no "
        "other count was said for a second: a single one may be junk.",
        "The brain has stored what was done; a robot that was started again has not.",
    ),
    12: Duty(
        "halt when nobody commands",
        "Come to rest, and do not count on, when no action comes: after each action, or, if yours are held, after "
        "`hold_s` of the experiment file. Halt at your end, too.",
        "When brain or network is gone, nobody else stops the robot.",
    ),
}


def table() -> str:
    """Return the duties as Markdown, as they stand in the protocol's page."""
    lines = [f"{number}. **{duty.title}.** {duty.text} *Why:* {duty.why}" for number, duty in DUTIES.items()]
    return "\n".join(lines)
