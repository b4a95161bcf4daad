"""One suite that every bus passes: the in-memory one and Zenoh's, through a real router."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus, Inbox, Publisher
from mdb_protocol.errors import BusError, QueryError
from mdb_protocol.keys import Key
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.messages import Message

ROUTER_CONFIG = Path(__file__).parents[2] / "deploy" / "router.json5"
BOUND_S = 5.0

MakeBus = Callable[..., Bus]


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    from mdb_protocol.zenoh_sessions import Router

    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    yield router.endpoint()
    router.close()


@pytest.fixture(params=["memory", "zenoh"])
def make_bus(request: pytest.FixtureRequest) -> Iterator[MakeBus]:
    opened: list[Bus] = []
    fabric = Fabric()
    brain = f"test-{request.node.name.replace('[', '-').rstrip(']')}"[:60]

    def make(brain: str = brain) -> Bus:
        if request.param == "memory":
            bus: Bus = MemoryBus(fabric, brain)
        else:
            from mdb_protocol.zenoh_bus import ZenohBus

            bus = ZenohBus(brain, request.getfixturevalue("endpoint"), lossless=True)
        opened.append(bus)
        return bus

    yield make
    for bus in opened:
        bus.close()


def until(bus: Bus, get: Callable[[], object]) -> object:
    """Wait on the bus, bounded, until `get` gives something true."""
    deadline = time.monotonic() + BOUND_S
    while not (value := get()):
        assert time.monotonic() < deadline, "nothing came within the bound"
        bus.wait(0.05)
    return value


def settle(reader: Bus, writer: Bus) -> None:
    """Return once the reader's declarations have reached the writer: a marker has come through."""
    marker = reader.subscriber(keys.FINISHED)
    publisher = writer.publisher(keys.FINISHED)
    publisher.put(messages.Finished(iterations=1))
    until(reader, marker.take)


def iterations_until(bus: Bus, inbox: Inbox, last: int) -> list[int]:
    """Return the iterations of what comes, up to the last one."""
    got: list[int] = []

    def there() -> bool:
        while (message := inbox.take()) is not None:
            got.append(message.iteration)
        return last in got

    until(bus, there)
    return got


def feedback(iteration: int, teacher: str = "anna", value: float = 1.0) -> messages.Feedback:
    return messages.Feedback(teacher=teacher, iteration=iteration, value=value)


def action(iteration: int) -> messages.Action:
    return messages.Action(iteration=iteration, action={"turn": 20.0}, choice=4, valid_for_s=1.0)


def model(version: int) -> messages.CurrentModel:
    weights = np.arange(5, dtype=np.float32)
    return messages.CurrentModel(
        model="object", version=version, generation=4, layers=[4, 1], weights=weights, error=0.25
    )


def test_reliable_messages_arrive_all_and_in_order(make_bus: MakeBus) -> None:
    reader, writer = make_bus(), make_bus()
    inbox = reader.subscriber(keys.FEEDBACK)
    publisher = writer.publisher(keys.FEEDBACK, teacher="anna")
    settle(reader, writer)
    for i in range(500):
        publisher.put(feedback(i))
    assert iterations_until(reader, inbox, 499) == list(range(500))


def test_latest_value_reader_gets_the_newest_only(make_bus: MakeBus) -> None:
    reader, writer = make_bus(), make_bus()
    inbox = reader.subscriber(keys.ACTION)
    publisher = writer.publisher(keys.ACTION)
    settle(reader, writer)  # before that it is a late joiner, who may for a moment have an older one
    for i in range(50):
        publisher.put(action(i))
    marker = reader.subscriber(keys.FEEDBACK)
    writer.publisher(keys.FEEDBACK, teacher="anna").put(feedback(1))
    settle(reader, writer)
    message = until(reader, inbox.take)
    assert isinstance(message, messages.Action)
    assert message.iteration == 49
    assert inbox.take() is None
    assert marker is not None


@pytest.mark.parametrize("row", [keys.CURRENT_MODEL, keys.PHASE, keys.PERCEPTION], ids=lambda r: r.path)
def test_late_joiner_gets_the_last_of_a_kept_key(make_bus: MakeBus, row: Key) -> None:
    values: dict[str, Callable[[int], Message]] = {
        keys.CURRENT_MODEL.path: model,
        keys.PHASE.path: lambda i: messages.Phase(iteration=i, name=f"phase {i}"),
        keys.PERCEPTION.path: lambda i: messages.Perception(
            iteration=i, event="none", outcome={}, reading={"distance": 0.1 * i}
        ),
    }
    writer = make_bus()
    parameters = {"model": "object"} if row.parameters else {}
    publisher = writer.publisher(row, **parameters)
    for i in range(3):
        publisher.put(values[row.path](i))
    late = make_bus()
    inbox = late.subscriber(row)
    message = until(late, inbox.take)
    plain = values[row.path](2)
    assert type(message) is type(plain)
    assert getattr(message, "iteration", 2) == 2
    assert getattr(message, "version", 2) == 2


def put_pairs(publisher: Publisher, iterations: range) -> None:
    for i in iterations:
        publisher.put(messages.PairStored(iteration=i, versions={}))


def joined_late(make_bus: MakeBus) -> tuple[Bus, Publisher, Bus, Inbox]:
    """Return a writer who has said of three pairs, his publisher, and one who joins after that, with an inbox."""
    writer = make_bus()
    publisher = writer.publisher(keys.PAIR_STORED)
    put_pairs(publisher, range(3))
    late = make_bus()
    return writer, publisher, late, late.subscriber(keys.PAIR_STORED)


def test_late_joiner_of_a_reliable_key_gets_what_comes_and_older_ones_only_before_it(make_bus: MakeBus) -> None:
    writer, publisher, late, inbox = joined_late(make_bus)
    settle(late, writer)
    put_pairs(publisher, range(3, 6))
    got = iterations_until(late, inbox, 5)
    assert got == list(range(got[0], 6))
    assert got[0] <= 3


@pytest.mark.parametrize("make_bus", ["zenoh"], indirect=True)
def test_a_heartbeat_gives_a_late_joiner_the_whole_cache_once_and_before_what_comes(make_bus: MakeBus) -> None:
    _, publisher, late, inbox = joined_late(make_bus)
    older = iterations_until(late, inbox, 2)
    put_pairs(publisher, range(3, 6))
    assert older + iterations_until(late, inbox, 5) == list(range(6))


def test_parameter_narrows_a_subscription(make_bus: MakeBus) -> None:
    reader, writer = make_bus(), make_bus()
    anna = reader.subscriber(keys.FEEDBACK, teacher="anna")
    everyone = reader.subscriber(keys.FEEDBACK)
    settle(reader, writer)
    for teacher in ("bert", "anna"):
        writer.publisher(keys.FEEDBACK, teacher=teacher).put(feedback(1, teacher))
    message = until(reader, anna.take)
    assert isinstance(message, messages.Feedback)
    assert message.teacher == "anna"
    heard = {until(reader, everyone.take).teacher for _ in range(2)}  # type: ignore[attr-defined]
    assert heard == {"anna", "bert"}


def test_message_in_anothers_name_is_refused(make_bus: MakeBus) -> None:
    reader, writer = make_bus(), make_bus()
    inbox = reader.subscriber(keys.FEEDBACK)
    settle(reader, writer)
    publisher = writer.publisher(keys.FEEDBACK, teacher="bert")
    publisher.put(feedback(1, "anna"))
    publisher.put(feedback(2, "bert"))
    message = until(reader, inbox.take)
    assert isinstance(message, messages.Feedback)
    assert message.teacher == "bert"
    assert reader.refusals.counts[keys.FEEDBACK.path] == 1


def test_brains_do_not_hear_each_other(make_bus: MakeBus) -> None:
    reader, other, writer = make_bus(), make_bus("other"), make_bus()
    inbox = reader.subscriber(keys.ACTION)
    settle(reader, writer)
    settle(other, other)
    other.publisher(keys.ACTION).put(action(7))
    writer.publisher(keys.ACTION).put(action(1))
    message = until(reader, inbox.take)
    assert isinstance(message, messages.Action)
    assert message.iteration == 1


def test_query_returns_the_answer_and_arrays_survive(make_bus: MakeBus) -> None:
    asker, answerer = make_bus(), make_bus()
    answerer.queryable(keys.KEPT_MODEL, lambda: model(9), model="object")
    with serving(answerer):
        (answer,) = ask(asker, keys.KEPT_MODEL, model="object")
    assert answer.version == 9
    np.testing.assert_array_equal(answer.weights, model(9).weights)


def test_query_to_nobody_is_an_empty_answer(make_bus: MakeBus) -> None:
    assert make_bus().query(keys.KEPT_MODEL, 1.0, model="object") == []


def test_query_of_all_collects_every_answer(make_bus: MakeBus) -> None:
    asker, one, two = make_bus(), make_bus(), make_bus()
    for bus, name in ((one, "a"), (two, "b")):
        status = messages.Status(role="evolver", instance=name, pid=1, uptime_s=1.0, values={}, refused={})
        bus.queryable(keys.STATUS, lambda status=status: status, role="evolver", instance=name)
    with serving(one), serving(two):
        deadline = time.monotonic() + BOUND_S
        names: set[str] = set()
        while names != {"a", "b"} and time.monotonic() < deadline:
            names = {answer.instance for answer in asker.query(keys.STATUS, 2.0)}
    assert names == {"a", "b"}


def test_failing_queryable_is_an_error_at_the_asker(make_bus: MakeBus) -> None:
    asker, answerer = make_bus(), make_bus()

    def fail() -> Message:
        raise ValueError("disk is full")

    answerer.queryable(keys.KEPT_MODEL, fail, model="object")
    with serving(answerer), pytest.raises(QueryError, match="disk is full"):
        ask(asker, keys.KEPT_MODEL, model="object")


def test_liveliness_shows_who_comes_and_goes(make_bus: MakeBus) -> None:
    watcher, service = make_bus(), make_bus()
    assert watcher.alive() == frozenset()
    service.token("robot", "pioneer")
    until(watcher, lambda: watcher.alive() == {"robot/pioneer"})
    service.close()
    until(watcher, lambda: watcher.alive() == frozenset())


def test_claims_are_seen_by_who_asks_after_them_until_they_are_withdrawn_or_their_bus_is_gone(
    make_bus: MakeBus,
) -> None:
    one, other = make_bus(), make_bus()
    withdraw = one.claim("robot", "body", "one.1.a")
    assert one.holders("robot", "body") == {"one.1.a"}
    other.claim("robot", "body", "two.2.b")
    other.claim("optimizer", "action", "two.2.b")
    assert other.holders("robot", "body") == {"one.1.a", "two.2.b"}, "what was claimed before is seen"
    withdraw()
    until(other, lambda: other.holders("robot", "body") == {"two.2.b"})
    other.close()
    until(one, lambda: one.holders("robot", "body") == frozenset())
    assert one.alive() == frozenset(), "a claim says nothing of being ready"


def test_who_has_a_token_is_admitted_where_nobody_is_denied(make_bus: MakeBus) -> None:
    bus = make_bus()
    assert not bus.admitted("teacher", "anna", 0.1)
    bus.token("teacher", "anna")
    assert bus.admitted("teacher", "anna", BOUND_S)
    assert not bus.admitted("teacher", "bert", 0.1)


def test_wait_is_bounded(make_bus: MakeBus) -> None:
    bus = make_bus()
    bus.wait(0.01)
    assert bus.wait(0.01) is False


def test_a_poke_from_another_thread_ends_a_wait(make_bus: MakeBus) -> None:
    bus = make_bus()
    bus.wait(0.01)
    poker = threading.Timer(0.05, bus.poke)
    poker.start()
    assert bus.wait(BOUND_S) is True
    poker.join()
    assert bus.wait(0.01) is False


def test_tap_sees_every_key(make_bus: MakeBus) -> None:
    recorder, writer = make_bus(), make_bus()
    tap = recorder.tap()
    settle(recorder, writer)
    writer.publisher(keys.ACTION).put(action(3))
    writer.publisher(keys.FEEDBACK, teacher="anna").put(feedback(3))
    seen: set[str] = set()

    def drain() -> bool:
        while (raw := tap.take()) is not None:
            seen.add(raw.key.split("/", 2)[2])
        return {"action", "teacher/anna/feedback", "finished"} <= seen

    until(recorder, drain)


def test_publishing_on_a_wildcard_or_an_empty_key_is_refused(make_bus: MakeBus) -> None:
    bus = make_bus()
    with pytest.raises(BusError, match="not a concrete key"):
        bus.publisher(keys.FEEDBACK)
    with pytest.raises(BusError, match="not a concrete key"):
        bus.publisher(keys.ALIVE, role="a", instance="b")


def test_no_router_is_a_clear_error() -> None:
    from mdb_protocol.zenoh_bus import ZenohBus

    with pytest.raises(BusError, match=r"no router answers at tcp/127\.0\.0\.1:1 .*mdb run router"):
        ZenohBus("nobody", "tcp/127.0.0.1:1", connect_timeout_s=0.1)


def test_port_in_use_is_a_clear_error(endpoint: str) -> None:
    from mdb_protocol.zenoh_sessions import Router

    with pytest.raises(BusError, match="port in use"):
        Router(ROUTER_CONFIG, endpoint)


def ask(bus: Bus, row: Key, **parameters: str) -> list[Message]:
    """Query until the queryable's declaration has come through, bounded."""
    deadline = time.monotonic() + BOUND_S
    while not (answers := bus.query(row, 2.0, **parameters)):
        assert time.monotonic() < deadline, "no answer within the bound"
    return answers


def test_of_a_flood_of_queries_some_are_dropped_and_counted(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from mdb_protocol import zenoh_bus

    monkeypatch.setattr(zenoh_bus, "ASKED_KEPT", 5)
    with zenoh_bus.ZenohBus("flood", endpoint) as bus, zenoh_bus.ZenohBus("flood", endpoint) as asker:
        bus.queryable(keys.KEPT_MODEL, lambda: model(9), model="object")
        with serving(bus):
            ask(asker, keys.KEPT_MODEL, model="object")
        threads = [
            threading.Thread(target=lambda: asker.query(keys.KEPT_MODEL, BOUND_S, model="object")) for _ in range(20)
        ]
        for thread in threads:
            thread.start()
        until(bus, lambda: bus.refusals.dropped[keys.KEPT_MODEL.path] == 15)
        bus.serve()
        for thread in threads:
            thread.join(BOUND_S)
            assert not thread.is_alive()


class serving:  # noqa: N801 - reads as a verb in `with serving(bus)`
    """A thread that answers a bus's queries meanwhile."""

    def __init__(self, bus: Bus) -> None:
        self._bus, self._stop = bus, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._stop.is_set():
            self._bus.wait(0.02)
            self._bus.serve()

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(BOUND_S)
