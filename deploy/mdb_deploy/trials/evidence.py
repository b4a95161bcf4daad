"""What a witness wrote down held against a memory file, and the file against itself: is all there, once, as it was?

Owns what must hold of a memory, and the words for what does not. Only reads.
"""

from __future__ import annotations

import json
import sqlite3
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from mdb_deploy.trials.witness import digest_of
from mdb_protocol import codec, files, keys, messages
from mdb_protocol.errors import DamageError, DecodeError, MdbError
from mdb_protocol.messages import Message
from mdb_services.memory.file import STEPS_KEPT
from mdb_services.memory.reading import Reader, opened

Plain = dict[str, Any]
Slots = set[tuple[int, int | None]]
M = TypeVar("M", bound=Message)

SOON = 50
"""After so many acknowledgements more, a model that was heard of is on disk."""
ENOUGH = 0.5
"""The part of all pairs that a witness has heard, at least: routers that are killed keep a few from it."""
ENTERED_TWICE = "SELECT pair FROM change WHERE pair >= 0 GROUP BY model, pair HAVING count(*) > 1"


@dataclass(frozen=True)
class Findings:
    """What the witness's file and the memory say of each other; every list but the last holds iterations."""

    acknowledged: int
    """Iterations whose acknowledgement the witness has heard."""
    stored: int
    """Pairs in the memory."""
    lost: list[int]
    """Acknowledged, but not in the memory."""
    altered: list[int]
    """Acknowledged and heard, but in the memory with another content, or without the feedback it was stored with."""
    doubled: list[int]
    """Twice in a model's short-term memory's history, or the same as the pair before: one action counted twice."""
    missing: list[int]
    """Never stored, though a later one is."""
    damaged: list[str] = field(default_factory=list)
    """What else of the memory is not as it was said, or contradicts the rest of it, in words."""
    checked: dict[str, int] = field(default_factory=dict)
    """How many of each kind were looked at."""

    @property
    def holds(self) -> bool:
        """Whether something was acknowledged, and everything that was is there, once, as it was."""
        return self.acknowledged > 0 and not (self.lost or self.altered or self.doubled or self.damaged)


@dataclass
class Heard:
    """What a witness has written down."""

    pairs: dict[int, list[Plain]] = field(default_factory=lambda: defaultdict(list))
    stored: dict[int, list[Plain]] = field(default_factory=lambda: defaultdict(list))
    changes: dict[tuple[str, int], Plain] = field(default_factory=dict)
    events: list[Plain] = field(default_factory=list)
    models: dict[str, int] = field(default_factory=dict)
    """Acknowledgements before a current model of each name was heard first."""
    digests: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    """Of the current models of each name."""
    acknowledgements: int = 0

    @classmethod
    def read(cls, witness: Path) -> Heard:
        """Read a witness's file; MdbError when there is none, or it is not a witness's."""
        heard = cls()
        try:
            for line in _lines(witness):
                heard.take(line["key"], line["says"])
        except (ValueError, KeyError, TypeError) as error:
            raise MdbError(f"{witness} is not what a witness wrote: {error!r}") from error
        return heard

    def take(self, key: str, says: Plain) -> None:
        """Take a line."""
        if key == keys.PAIR.path:
            self.pairs[says["iteration"]].append(says)
        elif key == keys.PAIR_STORED.path:
            self.stored[says["iteration"]].append(says)
            self.acknowledgements += 1
        elif key == keys.MEMORY_CHANGE.path:
            self.changes[says["model"], says["version"]] = says
        elif key == keys.CONTEXT.path:
            self.events.append(says)
        elif key == keys.CURRENT_MODEL.path:
            self.models.setdefault(says["model"], self.acknowledgements)
            self.digests[says["model"]].add(says["digest"])


def _lines(witness: Path) -> Iterator[Plain]:
    try:
        with files.opened(witness, None) as file:
            while (line := file.readline(codec.MAX_BYTES)).endswith(b"\n"):  # a killed witness may leave half of one
                yield json.loads(line)
    except OSError as error:
        raise MdbError(f"the witness has left nothing: {error}") from error


def compare(witness: Path, memory: Path) -> Findings:
    """Compare a witness's file with a memory store's; MdbError when one of them cannot be read."""
    heard = Heard.read(witness)
    try:
        with opened(memory) as file:
            return _Memory(file, heard).findings()
    except (sqlite3.Error, DamageError, DecodeError, OSError) as error:
        raise MdbError(f"cannot compare with {memory}: {error}") from error
    except (KeyError, TypeError, ValueError) as error:  # lines of the witness that are none of its kind
        raise MdbError(f"{witness} is not what a witness wrote: {error!r}") from error


class _Memory:
    """A memory file under examination: each method adds what it finds to `damaged`."""

    def __init__(self, file: Reader, heard: Heard) -> None:
        self._file, self._heard = file, heard
        self.damaged: list[str] = []
        self.checked: dict[str, int] = {}
        self._pairs: dict[int, Plain] = {}
        self._stored: dict[int, Plain] = {}
        self._recalled: set[int] = set()
        self._changes: dict[tuple[str, int], Slots] = defaultdict(set)
        self._contexts: set[tuple[str, int]] = set()

    def findings(self) -> Findings:
        """Look at all of it."""
        self._whole()
        self._read_pairs()
        self._read_changes()
        self._check_changes()
        self._check_going_on()
        self._check_contexts()
        self._check_long_term()
        self._check_models()
        pairs, heard = self._pairs, self._heard
        repeated = {i for i, pair in pairs.items() if i - 1 in pairs and _same_act(pairs[i - 1], pair)}
        twice = {row[0] for row in self._file.rows(ENTERED_TWICE)}
        return Findings(
            acknowledged=len(heard.stored),
            stored=len(pairs),
            lost=sorted(i for i in heard.stored if i not in pairs),
            altered=sorted(i for i in pairs if self._is_altered(i)),
            doubled=sorted(twice | repeated),
            missing=[i for i in range(max(pairs, default=-1)) if i not in pairs],
            damaged=self.damaged,
            checked=self.checked,
        )

    def _say(self, found: bool, what: str) -> None:
        if found:
            self.damaged.append(what)

    def _whole(self) -> None:
        (said,) = next(self._file.rows("PRAGMA quick_check(1)"))
        self._say(said != "ok", f"the file: {said}")

    def _read_pairs(self) -> None:
        rows = self._file.rows("SELECT iteration, payload, stored, note, choice FROM pair ORDER BY iteration")
        for i, payload, answer, note, choice in rows:
            pair, stored = self._decoded(messages.Pair, payload), self._decoded(messages.PairStored, answer)
            if pair is None or stored is None:
                self.damaged.append(f"pair {i} cannot be read")
                continue
            self._say(pair.iteration != i, f"what is stored as pair {i} is pair {pair.iteration}")
            self._say(stored.iteration != i, f"pair {i} was acknowledged as {stored.iteration}")
            self._say((pair.note, pair.choice) != (note, choice), f"pair {i} is filed under another note or choice")
            self._say(
                stored.judged != (pair.feedback is not None), f"pair {i} has not the feedback it is said to have"
            )
            self._pairs[i], self._stored[i] = codec.to_plain(pair), codec.to_plain(stored)
        for id, payload in self._file.rows("SELECT id, payload FROM recalled"):
            self._say(self._decoded(messages.Pair, payload) is None, f"recalled pair {id} cannot be read")
            self._recalled.add(id)
        compared = sum(i in self._heard.stored and i in self._heard.pairs for i in self._pairs)
        few = compared < ENOUGH * len(self._pairs)
        self._say(few, f"of {len(self._pairs)} pairs the witness has heard {compared}: what it wrote is not whole")
        self.checked |= {"pairs": compared, "recalled pairs": len(self._recalled)}

    def _is_altered(self, i: int) -> bool:
        pair, stored, heard = self._pairs[i], self._stored[i], self._heard
        answers = heard.stored.get(i, [])
        if not answers:
            return False
        if heard.pairs[i] and pair not in heard.pairs[i]:
            return True
        if any(answer["judged"] for answer in answers) and pair["feedback"] is None:
            return True
        alike = [answer for answer in answers if answer["judged"] == stored["judged"]]
        return bool(alike) and stored not in alike

    def _read_changes(self) -> None:
        for model, version, slot, pair in self._file.rows("SELECT model, version, slot, pair FROM change"):
            self._changes[model, version].add((slot, pair))
            known = pair is None or pair in (self._pairs if pair >= 0 else self._recalled)
            self._say(not known, f"change {version} of {model} has pair {pair}, which is not there")
        self._contexts = {
            (model, version) for model, version in self._file.rows("SELECT model, version FROM context")
        }
        self.checked |= {"changes": len(self._changes), "contexts": len(self._contexts)}

    def _versions(self) -> dict[str, set[int]]:
        """Return the versions of each model's memory of which something is on disk."""
        found: dict[str, set[int]] = defaultdict(set)
        for model, version in [*self._changes, *self._contexts]:
            found[model].add(version)
        return found

    def _check_changes(self) -> None:
        """See that each change is there that was heard or acknowledged, as it was, and all before it."""
        heard, versions = self._heard, self._versions()
        for (model, version), said in heard.changes.items():
            slots = {(slot, pair) for slot, pair in said["slots"]}
            there = self._changes.get((model, version), set())
            self._say(slots != there, f"change {version} of {model} is not as it was")
        newest: dict[str, int] = defaultdict(int)
        for answer in [*(a for answers in heard.stored.values() for a in answers), *self._stored.values()]:
            for model, version in answer["versions"].items():
                newest[model] = max(newest[model], version)
        for model in sorted({*newest, *versions}):
            expected = max(newest[model], *versions[model], 0)
            gone = [version for version in range(1, expected + 1) if version not in versions[model]]
            self._say(bool(gone), f"{len(gone)} of {expected} changes of {model} are gone, the first is {gone[:1]}")

    def _check_going_on(self) -> None:
        """See that evolvers can go on: each change since the checkpoint is there, or as many as are kept."""
        checkpoints, steps = dict[str, int](), defaultdict[str, set[int]](set)
        for model, payload in self._file.rows("SELECT model, payload FROM checkpoint"):
            checkpoint = self._decoded(messages.Checkpoint, payload)
            fits = checkpoint is not None and checkpoint.model == model
            self._say(not fits, f"the checkpoint of {model} cannot be read")
            checkpoints[model] = checkpoint.version if checkpoint is not None else 0
        for model, version, payload in self._file.rows("SELECT model, version, payload FROM step"):
            change = self._decoded(messages.MemoryChange, payload)
            fits = change is not None and (change.model, change.version) == (model, version)
            fits = fits and change is not None and _slots(change) == self._changes.get((model, version), set())
            self._say(not fits, f"what an evolver is told of change {version} of {model} is not that")
            steps[model].add(version)
        for model, versions in self._versions().items():
            newest, of = max(versions), checkpoints.get(model, 0)
            wanted = {version for version in versions if version > max(of, newest - STEPS_KEPT)}
            self._say(steps[model] != wanted, f"{model} has not the changes since its checkpoint, or not this one")
            self._say(of > newest, f"the checkpoint of {model} is of a memory that is not there")
        self.checked |= {"checkpoints": len(checkpoints), "steps": sum(map(len, steps.values()))}

    def _check_contexts(self) -> None:
        """See that each change of context that was told is on disk, with its seeds."""
        for event in self._heard.events:
            if event["kind"] not in ("changed", "recalled"):
                continue
            model, i = event["model"], event["iteration"]
            answers = [*self._heard.stored.get(i, []), *([self._stored[i]] if i in self._stored else [])]
            began = {(model, answer["versions"].get(model)) for answer in answers}
            self._say(bool(began) and not began & self._contexts, f"the context of {model} since pair {i} is gone")
        seeds: dict[str, int] = defaultdict(int)
        for model, place, payload in self._file.rows("SELECT model, place, payload FROM seed ORDER BY model, place"):
            fits = place == seeds[model] and self._decoded(messages.ModelWeights, payload) is not None
            self._say(not fits, f"seed {place} of {model} cannot be read, or is in another place")
            seeds[model] += 1
        for model in {model for model, _ in self._contexts}:
            newest = max(version for name, version in self._contexts if name == model)
            said = self._heard.changes.get((model, newest))
            there = seeds.get(model, 0)
            self._say(said is not None and said["seeds"] != there, f"{model} has {there} seeds, which are not all")
        self.checked["events"] = len(self._heard.events)

    def _check_long_term(self) -> None:
        """See that the long-term memory has what was stored in it last, and can be read."""
        there: dict[str, dict[int, int]] = defaultdict(dict)
        for model, id, payload in self._file.rows("SELECT model, id, payload FROM long_term"):
            kept = self._decoded(messages.LongTermModel, payload)
            fits = kept is not None and (kept.model, kept.id) == (model, id)
            self._say(not fits, f"{model}/{id} of the long-term memory cannot be read, or is another one")
            there[model][id] = kept.iteration if kept is not None else 0
        last = {event["model"]: event for event in self._heard.events if event["stored"] is not None}
        for model, event in last.items():
            later = any(iteration > event["iteration"] for iteration in there[model].values())
            self._say(
                event["stored"] not in there[model] and not later,
                f"{model}/{event['stored']}, {event['kind']} with pair {event['iteration']}, is not in the long-term "
                "memory",
            )
        self.checked["long-term models"] = sum(map(len, there.values()))

    def _check_models(self) -> None:
        there = set()
        for name, payload in self._file.rows("SELECT name, payload FROM model"):
            model = self._decoded(messages.CurrentModel, payload)
            self._say(model is None or model.model != name, f"the current model {name} cannot be read, or is another")
            heard = self._heard.digests.get(name)
            known = model is None or heard is None or digest_of(model) in heard
            self._say(not known, f"the current model {name} is none that was heard")
            there.add(name)
        for name, before in self._heard.models.items():
            late = self._heard.acknowledgements - before > SOON
            self._say(late and name not in there, f"the current model {name} is gone")
        self.checked["current models"] = len(there)

    def _decoded(self, cls: type[M], payload: object) -> M | None:
        try:
            return codec.decode(cls, payload, codec.encoding_of(cls)) if isinstance(payload, bytes) else None
        except DecodeError:
            return None


def _slots(change: messages.MemoryChange) -> Slots:
    pairs = zip(change.slots.tolist(), change.pairs.tolist(), strict=True)
    return {*pairs, *((slot, None) for slot in change.freed.tolist())}


def _same_act(a: Plain, b: Plain) -> bool:
    """Whether two pairs tell of one act: sensors are noisy, so two acts read the same only where nothing is seen."""
    return bool(a["before"]) and all(a[name] == b[name] for name in ("before", "action", "after"))
