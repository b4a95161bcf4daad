"""The inbox that all buses share: nothing newer is lost, nothing grows without bound, junk is counted."""

import threading
from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from mdb_protocol import bus as bus_module
from mdb_protocol import codec, keys, messages
from mdb_protocol.bus import AT_ONCE, LOGGED_LETTERS, Refusals
from mdb_protocol.errors import BusError
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.waiting import Raw

BRAIN = "test"


def action(iteration: int) -> messages.Action:
    return messages.Action(iteration=iteration, action={"turn": 20.0}, choice=1, valid_for_s=1.0)


def raw_action(iteration: int) -> Raw:
    key, encoding = keys.ACTION.at(BRAIN), codec.encoding_of(messages.Action)
    return Raw(key, codec.encode(action(iteration)), encoding)


def test_a_value_that_comes_while_the_one_before_is_read_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    inbox = MemoryBus(Fabric(), BRAIN).subscriber(keys.ACTION)
    inbox.put(raw_action(1))
    read = bus_module.read

    def read_slowly(*arguments: Any) -> Any:
        monkeypatch.setattr(bus_module, "read", read)
        inbox.put(raw_action(2))
        return read(*arguments)

    monkeypatch.setattr(bus_module, "read", read_slowly)
    assert inbox.take().iteration == 1
    assert inbox.take().iteration == 2
    assert inbox.take() is None


def test_junk_behind_a_good_value_does_not_hide_it() -> None:
    bus = MemoryBus(Fabric(), BRAIN)
    inbox = bus.subscriber(keys.ACTION)
    inbox.put(raw_action(1))
    inbox.put(raw_action(2))
    for _ in range(5):
        inbox.put(Raw(keys.ACTION.at(BRAIN), b"junk", codec.encoding_of(messages.Action)))
    assert inbox.take().iteration == 2
    assert inbox.take() is None
    assert bus.refusals.counts[keys.ACTION.path] == 5


def test_waking_needs_no_memory_when_nobody_waits() -> None:
    bus = MemoryBus(Fabric(), BRAIN)
    inbox = bus.subscriber(keys.ACTION)
    for i in range(1000):
        inbox.put(raw_action(i))
        inbox.take()
    assert bus._wake._marks.qsize() <= 1
    assert bus.wait(0.0) is True
    assert bus.wait(0.0) is False


def test_a_message_wakes_the_one_who_waits() -> None:
    fabric = Fabric()
    reader, writer = MemoryBus(fabric, BRAIN), MemoryBus(fabric, BRAIN)
    inbox = reader.subscriber(keys.ACTION)
    reader.wait(0.0)
    publisher = writer.publisher(keys.ACTION)
    for i in range(200):
        thread = threading.Thread(target=publisher.put, args=(action(i),))
        thread.start()
        assert reader.wait(5.0)
        assert inbox.take().iteration == i
        thread.join()


def test_a_full_inbox_drops_the_oldest_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus_module, "RELIABLE_KEPT", 3)
    bus = MemoryBus(Fabric(), BRAIN)
    inbox = bus.subscriber(keys.FINISHED)
    publisher = bus.publisher(keys.FINISHED)
    for i in range(5):
        publisher.put(messages.Finished(iterations=i))
    assert [inbox.take().iterations for _ in range(3)] == [2, 3, 4]
    assert inbox.take() is None
    assert bus.refusals.dropped == {keys.FINISHED.path: 2}
    assert bus.refusals.counts == {}


def test_a_sample_on_another_key_or_in_anothers_name_is_refused() -> None:
    bus = MemoryBus(Fabric(), BRAIN)
    inbox = bus.subscriber(keys.COMMAND)
    command = codec.encode(messages.Command(teacher="anna", iteration=1, note=1))
    encoding = codec.encoding_of(messages.Command)
    for key in ("mdb/test/teacher/bert/command", "mdb/test/teacher/*/command", "mdb/other/teacher/anna/command", ""):
        inbox.put(Raw(key, command, encoding))
    assert inbox.take() is None
    assert bus.refusals.counts[keys.COMMAND.path] == 4


def test_of_one_sample_all_readers_get_one_message_which_is_none_of_the_writers() -> None:
    fabric = Fabric()
    first, second, writer = (MemoryBus(fabric, BRAIN) for _ in range(3))
    inboxes, tap = [bus.subscriber(keys.CURRENT_MODEL) for bus in (first, second)], second.tap()
    weights = np.zeros(4, dtype=np.float32)
    model = messages.CurrentModel(model="world", version=1, generation=1, layers=[1, 1, 1], weights=weights, error=0)
    writer.publisher(keys.CURRENT_MODEL, model="world").put(model)
    message = inboxes[0].take()
    assert (raw := tap.take()) is not None
    assert inboxes[1].take() is message is bus_module.read(keys.CURRENT_MODEL, BRAIN, raw)
    assert not np.shares_memory(message.weights, weights)
    assert not message.weights.flags.writeable


def test_a_sample_that_is_no_message_each_reader_refuses() -> None:
    fabric = Fabric()
    readers = [MemoryBus(fabric, BRAIN) for _ in range(2)]
    inboxes = [bus.subscriber(keys.ACTION) for bus in readers]
    junk = Raw(keys.ACTION.at(BRAIN), b"junk", codec.encoding_of(messages.Action))
    fabric.put(readers[0], keys.ACTION, junk)
    assert [inbox.take() for inbox in inboxes] == [None, None]
    assert [bus.refusals.counts[keys.ACTION.path] for bus in readers] == [1, 1]


def test_a_closed_bus_refuses_to_publish_and_closes_twice() -> None:
    bus = MemoryBus(Fabric(), BRAIN)
    publisher = bus.publisher(keys.ACTION)
    bus.close()
    bus.close()
    with pytest.raises(BusError, match="closed"):
        publisher.put(action(1))


def test_samples_beyond_what_their_key_may_hold_are_refused_unread() -> None:
    bus = MemoryBus(Fabric(), BRAIN)
    inbox = bus.subscriber(keys.ACTION)
    key, encoding = keys.ACTION.at(BRAIN), codec.encoding_of(messages.Action)
    inbox.put(Raw(key, bytes(keys.SMALL), encoding))
    inbox.put(Raw(key, b"", "x" * keys.SMALL))
    assert bus.queued() == 0
    assert bus.refusals.counts[keys.ACTION.path] == 2


def test_nobody_can_send_what_nobody_would_read() -> None:
    bus = MemoryBus(Fabric(), BRAIN)
    reading = {f"{i:05}": 1.0 for i in range(9000)}
    message = messages.Perception(iteration=1, event="none", outcome=reading, reading={})
    with pytest.raises(BusError, match=r"perception: \d+ bytes; readers take"):
        bus.publisher(keys.PERCEPTION).put(message)


@pytest.mark.parametrize("kind", ["inbox", "tap"])
def test_what_waits_is_bounded_in_bytes(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus_module, "KEPT_BYTES", 10_000)
    bus = MemoryBus(Fabric(), BRAIN)
    reader = bus.tap() if kind == "tap" else bus.subscriber(keys.PHASE)
    publisher = bus.publisher(keys.PHASE)
    for i in range(20):
        publisher.put(messages.Phase(iteration=i, name="x" * 1000))
    assert bus.queued() == 9
    assert sum(bus.refusals.dropped.values()) == 11
    assert len([1 for _ in iter(reader.take, None)]) == 9
    assert (bus.queued(), bus.taken()) == (0, 9)


def test_of_a_flood_only_some_is_taken_before_other_things_get_their_turn() -> None:
    bus = MemoryBus(Fabric(), BRAIN)
    inbox = bus.subscriber(keys.FINISHED)
    publisher = bus.publisher(keys.FINISHED)
    for i in range(AT_ONCE + 1):
        publisher.put(messages.Finished(iterations=i))
    assert len(list(inbox.some())) == AT_ONCE
    assert bus.wait(0.0), "the rest wakes the reader"
    assert len(list(inbox.some())) == 1
    assert not bus.wait(0.0)
    for _ in range(AT_ONCE + 1):
        inbox.put(Raw(keys.FINISHED.at(BRAIN), b"junk", codec.encoding_of(messages.Finished)))
    publisher.put(messages.Finished(iterations=7))
    bus.wait(0.0)
    assert inbox.take() is None
    assert bus.wait(0.0)
    assert inbox.take().iterations == 7


def test_junk_is_said_in_the_log_a_few_times_and_then_once_a_minute() -> None:
    now = 0.0
    refusals = Refusals(clock=lambda: now)
    with capture_logs() as lines:
        for i in range(1000):
            now = 0.5 * i
            refusals.add("action", "x" * 100_000)
            refusals.drop("pair", "no room")
    assert (refusals.counts, refusals.dropped) == ({"action": 1000}, {"pair": 1000})
    said = [line["count"] for line in lines if line["key"] == "action"]
    assert said == [1, 2, 3, *range(123, 1000, 120)]
    assert max(len(line["reason"]) for line in lines) == LOGGED_LETTERS
    assert len(lines) == 2 * len(said)
