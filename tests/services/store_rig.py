"""A memory store on a real file, between its writers and its readers."""

from pathlib import Path
from typing import Any

import msgspec

from mdb_protocol import codec, keys, messages
from mdb_protocol.bus import Inbox
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.experiment.brain import BrainConfig
from mdb_services.memory.file import MemoryFile
from mdb_services.memory.store import MemoryStore
from tests.services.small import BRAIN

ITERATIONS = 1000


class Rig:
    """See the module's docstring."""

    def __init__(self, path: Path, settings: BrainConfig) -> None:
        long = msgspec.structs.replace(settings.experiment, iterations=ITERATIONS)
        self.path, self.settings = path, msgspec.structs.replace(settings, experiment=long)
        self.fabric = Fabric()
        self.outside = MemoryBus(self.fabric, BRAIN)
        self.pairs = self.outside.publisher(keys.PAIR)
        self.stored = self.outside.subscriber(keys.PAIR_STORED)
        self.changes = self.outside.subscriber(keys.MEMORY_CHANGE)
        self.events = self.outside.subscriber(keys.CONTEXT)
        self.now = 0.0
        self.store = self._start()

    def _start(self) -> MemoryStore:
        bus = MemoryBus(self.fabric, BRAIN)
        return MemoryStore(bus, self.settings, MemoryFile(self.path), clock=lambda: self.now)

    def restart(self) -> None:
        """As after an end in order: what was in memory is gone."""
        self.store.close()
        self.store.bus.close()
        self.store = self._start()

    def give(self, *pairs: messages.Pair) -> None:
        for one in pairs:
            self.pairs.put(one)
        self.store.step()

    def show(self, current: messages.CurrentModel) -> None:
        self.outside.publisher(keys.CURRENT_MODEL, model=current.model).put(current)
        self.store.step()

    def snapshots(self) -> dict[str, dict[str, Any]]:
        return {answer.model: codec.to_plain(answer) for answer in self.outside.query(keys.MEMORY_SNAPSHOT, 1.0)}


def taken(inbox: Inbox) -> list[Any]:
    return list(iter(inbox.take, None))
