"""A person's part in a brain: hears what the teacher hears, says what the teacher says. No screen, no keyboard.

Owns the teacher's map from notes to meanings, which the brain never learns: from it alone come obedience and
suggestions. A service like the others: its thread owns the bus; whoever has the keys and the screen calls
`command`, `feedback`, `pause`, `wait_for_me`, `speak` and `microphone`, which never wait, and reads `view`, which is
renewed as a whole: no scene without what was said to it at once.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_deploy.teach.presence import Presence
from mdb_deploy.teach.record import Record
from mdb_deploy.teach.turns import Patience, Turns
from mdb_deploy.teach.view import View
from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus
from mdb_sim.teaching.languages import Language
from mdb_sim.teaching.policies.pioneer import Reach
from mdb_sim.teaching.policies.plain import Named
from mdb_sim.teaching.policy import Policy, done, judgement, likest, shows
from mdb_sim.teaching.service import ROLE
from mdb_sim.teaching.sound import Player

MOST_ORDERS, MOST_SOUND = 1000, 64
"""Orders that wait, and of sound pieces at most so many of them: while a router hangs, more are dropped."""


class TeachingSession:
    """See the module's docstring.

    `auto`: it plays the scripted teacher with the person's language. `player`: notes are not named but played;
    `listens`: sound comes through `microphone`.
    """

    role = ROLE

    def __init__(
        self,
        bus: Bus,
        name: str,
        language: Language,
        policy: Policy | None = None,
        *,
        auto: bool = False,
        player: Player | None = None,
        listens: bool = False,
        patience_s: tuple[float, float] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Listen; presence begins with the token that `service.announce` declares.

        `policy`: what can be wanted, and what of it is right; the paper's, if it is None. `patience_s`: how long the
        brain waits for a note and for feedback, as the experiment file says; None: that is not known.
        """
        self.bus, self.instance, self.policy = bus, name, policy or Reach()
        self._view = self.view = View(language, auto=auto)
        self._auto, self._player, self._clock = auto, player, clock
        self._orders: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._record = Record(name)
        self._turns = Turns(name, None if patience_s is None else Patience(*patience_s))
        self._presence = Presence(bus, name, sounds=listens or player is not None)
        self._scenes = bus.subscriber(keys.SCENE)
        self._pictures = bus.subscriber(keys.PICTURE)
        self._perceptions = bus.subscriber(keys.PERCEPTION)
        self._reports = bus.subscriber(keys.ITERATION)
        self._timings = bus.subscriber(keys.TIMING)
        self._finished = bus.subscriber(keys.FINISHED)
        self._controls = bus.subscriber(keys.CONTROL)
        self._heard = bus.subscriber(keys.HEARD, teacher=name)
        self._commands = bus.publisher(keys.COMMAND, teacher=name)
        self._feedback = bus.publisher(keys.FEEDBACK, teacher=name)
        self._audio = bus.publisher(keys.AUDIO, teacher=name)
        self._lessons = bus.publisher(keys.LESSON, teacher=name)
        self._announced: Language | None = None
        """What was said of the notes to those who watch."""

    def command(self, note: int | None) -> None:
        """Say a note for the action that comes next, or silence; from any thread."""
        self._order(partial(self._command, note))

    def feedback(self, value: float, iteration: int) -> None:
        """Reward or punish in [-1, 1] the action of this iteration; from any thread."""
        self._order(partial(self._judge, iteration, value))

    def pause(self) -> None:
        """Be there but silent, so that the brain need not wait; or end that. From any thread."""
        self._order(self._pause)

    def wait_for_me(self, on: bool) -> None:
        """Ask the brain to wait for what this teacher has to say, from now on or no longer; from any thread.

        The brain waits for each note and each feedback, but no longer than `turns.MOST_S` for one scene.
        """
        self._order(partial(self._wait, on))

    def play_by_itself(self, on: bool) -> None:
        """Play the scripted teacher with the person's language from now on, or no longer; from any thread."""
        self._order(partial(self._play_by_itself, on))

    def speak(self, language: Language) -> None:
        """Mean something else by the notes from now on; from any thread."""
        self._order(partial(self._speak, language))

    def microphone(self, samples: NDArray[np.int16], rate_hz: int) -> None:
        """Pass on what a microphone hears, samples (n,); from any thread."""
        self._order(partial(self._sound, samples, rate_hz), keys.AUDIO, MOST_SOUND)

    def _order(self, order: Callable[[], None], row: keys.Key = keys.COMMAND, most: int = MOST_ORDERS) -> None:
        if self._orders.qsize() < most:
            self._orders.put(order)
        else:
            self.bus.refusals.drop(row.path, f"{most} orders of the teacher wait; one more is not taken")
        self.bus.poke()

    def step(self) -> bool:
        """Take what has come, say what was ordered, renew the view."""
        moved = self._receive()
        for _ in range(self._orders.qsize()):
            self._orders.get_nowait()()
            moved = True
        if moved:
            self._show(**self._record.measures())
            self._take_turn()
        self._ask_to_wait()
        self.view = self._view  # before the router is asked, which may take its time
        alive = self.bus.alive()
        trouble = self._presence.trouble(self._view, alive, self._record.without_effect)
        self._show(others=self._presence.others(alive), trouble=trouble)
        self.view = self._view
        return moved

    def _show(self, **changes: Any) -> None:
        """Replace the view in the making, if anything in it is another now."""
        if any(getattr(self._view, name) != value for name, value in changes.items()):
            self._view = replace(self._view, **changes)

    def _receive(self) -> bool:
        moved = False
        if (perception := self._perceptions.take()) is not None:
            self._show(perception=perception)
            moved = True
        if (scene := self._scenes.take()) is not None:
            self._see(scene)
            moved = True
        if (picture := self._pictures.take()) is not None:
            self._show(picture=picture)
            moved = True
        while (heard := self._heard.take()) is not None:
            self._be_heard(heard)
            moved = True
        while (report := self._reports.take()) is not None:
            self._record.read(report, self._clock())
            self._show(report=report)
            moved = True
        while (timing := self._timings.take()) is not None:
            self._record.time(timing)
            moved = True
        while (control := self._controls.take()) is not None:
            self._show(control=control)
            moved = True
        if self._finished.take() is not None:
            self._show(finished=True)
            moved = True
        return moved

    def _take_turn(self) -> None:
        """Find out what this teacher can do now."""
        at = self._view.scene.iteration if self._view.scene is not None else 0
        last, this = self._record.exchange(at - 1), self._record.exchange(at)
        self._show(turn=self._turns.turn(self._view, last, this))

    def _ask_to_wait(self) -> None:
        """Say "wait for me", if it is wanted, something is due, and it is time to say it again."""
        if not self._turns.asks(self._view, self._clock()):
            return
        turn = self._view.turn
        if turn.kind == "both":
            self._feedback.put(
                messages.Feedback(teacher=self.instance, iteration=turn.iteration - 1, value=None, later=True)
            )
        self._commands.put(messages.Command(teacher=self.instance, iteration=turn.iteration, note=None, later=True))

    def _wait(self, on: bool) -> None:
        self._show(waits=on)

    def _see(self, scene: messages.Scene) -> None:
        """Take in a new scene; in a pause and with `auto` it is answered here."""
        last = self._view.scene
        if last is not None and scene.iteration == last.iteration:
            return  # a robot that waits shows it again
        if last is not None and scene.iteration < last.iteration:  # another run, which counts anew
            self._record = Record(self.instance)
            self._show(report=None)
        self._turns.see(self._clock())
        did, obeyed = self._seen(scene)
        self._record.see(scene, self._clock(), did=did, obeyed=obeyed)
        wanted = self.policy.want(scene.now) if set(self.policy.needs) <= set(scene.now) else None
        self._show(scene=scene, wanted=wanted, finished=False)
        self._announce(scene.iteration)
        if self._view.paused:
            self._command(None)
        elif self._auto:
            self._teach(scene, wanted)

    def _play_by_itself(self, on: bool) -> None:
        self._auto = on
        self._show(auto=on)
        scene = self._view.scene
        if on and scene is not None and not self._view.paused and not self._record.exchange(scene.iteration).spoke:
            self._teach(scene, self._view.wanted)

    def _speak(self, language: Language) -> None:
        """Change the language; the note of this scene, if it is not said yet, has the new meaning already."""
        self._show(language=language)
        if (scene := self._view.scene) is not None:
            self._announce(scene.iteration + self._record.exchange(scene.iteration).spoke)

    def _announce(self, iteration: int) -> None:
        """Say to those who watch, and to the log, what the notes mean from now on."""
        language = self._view.language
        if language is not self._announced:
            commands, notes = list(self.policy.commands), list(language.notes)
            self._lessons.put(
                messages.Lesson(teacher=self.instance, iteration=iteration, commands=commands, notes=notes)
            )
            self._announced = language

    def _seen(self, scene: messages.Scene) -> tuple[int | None, bool | None]:
        """Return the command that what happened is most like, and whether what was meant happened; None: unknown."""
        if scene.before is None or isinstance(self.policy, Named) or not shows(self.policy, scene):
            return None, None
        did = likest(self.policy, scene.before, scene.reached, scene.event)
        meant = self._record.exchange(scene.iteration - 1).command
        return did, None if meant is None else done(self.policy, meant, scene)

    def _teach(self, scene: messages.Scene, wanted: int | None) -> None:
        """Do as the scripted teacher does: judge the last action, command the next."""
        last = self._record.exchange(scene.iteration - 1)
        if last.command is not None and last.feedback is None:
            found = judgement(self.policy, scene)
            if found is not None:
                self._judge(last.iteration, found)
        self._command(None if wanted is None else self._view.language.note(wanted))

    def _command(self, note: int | None) -> None:
        scene = self._view.scene
        if scene is None:
            self._notice("there is no scene yet to say anything about")
        elif self._record.exchange(scene.iteration).spoke:
            self._notice(f"iteration {scene.iteration} has its command; the next one is for the next scene")
        else:
            self._say(scene.iteration, note)

    def _say(self, iteration: int, note: int | None) -> None:
        self._remember(iteration, note)
        if note is None or self._player is None:
            self._commands.put(messages.Command(teacher=self.instance, iteration=iteration, note=note))
            return
        for frame in self._player.frames(self.instance, iteration, note):
            self._audio.put(frame)

    def _remember(self, iteration: int, note: int | None) -> None:
        self._defer(iteration - 1)
        command = None if note is None else self._view.language.command(note)
        self._record.said(iteration, note, command, self._clock())

    def _defer(self, iteration: int) -> None:
        """The next command without feedback says: do not wait for it; it may come later."""
        exchange = self._record.exchange(iteration)
        if exchange.note is not None and exchange.feedback is None:
            self._feedback.put(messages.Feedback(teacher=self.instance, iteration=iteration, value=None))

    def _sound(self, samples: NDArray[np.int16], rate_hz: int) -> None:
        scene = self._view.scene
        if scene is not None and not self._view.paused:
            self._audio.put(
                messages.AudioFrame(
                    teacher=self.instance, iteration=scene.iteration, rate_hz=rate_hz, samples=samples
                )
            )

    def _be_heard(self, heard: messages.Command) -> None:
        """Learn what the ear made of the sound: of a microphone's, that is all that is known of the note."""
        said = self._record.exchange(heard.iteration)
        self._show(heard=heard)
        if not said.spoke and heard.note is not None and heard.note < len(self._view.language.notes):
            self._remember(heard.iteration, heard.note)
        elif said.spoke and said.note not in (None, heard.note):
            self._notice(
                f"the ear heard {'nothing' if heard.note is None else f'note {heard.note}'} of note {said.note}"
            )

    def _judge(self, iteration: int, value: float) -> None:
        if iteration < 0:
            self._notice("there is no action yet to judge")
        elif self._record.exchange(iteration).feedback is not None:
            self._notice(f"the action of iteration {iteration} is judged already")
        else:
            self._feedback.put(messages.Feedback(teacher=self.instance, iteration=iteration, value=value))
            self._record.judged(iteration, value)
            if self._view.scene is not None and iteration == self._view.scene.iteration - 1:
                self._turns.judge(self._clock())

    def _pause(self) -> None:
        self._show(paused=not self._view.paused)
        scene = self._view.scene
        if self._view.paused and scene is not None and not self._record.exchange(scene.iteration).spoke:
            self._say(scene.iteration, None)

    def _notice(self, text: str) -> None:
        self._show(notice=text, noticed_s=self._clock())

    def values(self) -> dict[str, float]:
        """Last iteration seen, obedience (-1: nothing commanded yet) and the commands it is the share of."""
        view = self._view
        return {
            "iteration": float(view.scene.iteration if view.scene else -1),
            "commands": float(view.judged),
            "obedience": -1.0 if view.obedience is None else view.obedience,
        }

    def close(self) -> None:
        """Say that the lesson is over; presence ends when the bus is closed."""
        scene = self._view.scene
        if self._announced is not None and scene is not None:
            at = scene.iteration
            self._lessons.put(messages.Lesson(teacher=self.instance, iteration=at, commands=[], notes=[], over=True))
