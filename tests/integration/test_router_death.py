"""A router that dies and comes back on the same port: clients rejoin by themselves and get what they missed."""

from collections.abc import Iterator

import pytest

from mdb_deploy.supervision.processes import ROUTER_CONFIG
from mdb_protocol import keys, messages
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import Router
from tests.integration.brain import BRAIN, until

MISSED = 5


class Restartable:
    """A router of this process on a port of its own."""

    def __init__(self) -> None:
        self.router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
        self.endpoint = self.router.endpoint()

    def die(self) -> None:
        self.router.close()

    def come_back(self) -> None:
        self.router = Router(ROUTER_CONFIG, self.endpoint)


@pytest.fixture
def router() -> Iterator[Restartable]:
    router = Restartable()
    yield router
    router.die()


def test_what_was_said_on_a_reliable_key_meanwhile_arrives_without_another_word(router: Restartable) -> None:
    """The last sample before a silence is the one that lockstep waits for."""
    with ZenohBus(BRAIN, router.endpoint) as writer, ZenohBus(BRAIN, router.endpoint) as reader:
        publisher, inbox = writer.publisher(keys.PAIR_STORED), reader.subscriber(keys.PAIR_STORED)
        heard: list[int] = []

        def hear(up_to: int) -> bool:
            while (message := inbox.take()) is not None:
                heard.append(message.iteration)
            return up_to in heard

        def said(iteration: int) -> bool:
            publisher.put(messages.PairStored(iteration=iteration, versions={}))
            return True

        until(lambda: said(0) and hear(0))
        router.die()
        until(lambda: not writer.connected() and not reader.connected())
        for iteration in range(1, MISSED + 1):
            said(iteration)
        router.come_back()
        until(lambda: hear(MISSED), 10.0)
        assert sorted(set(heard)) == list(range(MISSED + 1))


def test_a_session_knows_whether_there_is_a_router_and_tokens_come_back(router: Restartable) -> None:
    with ZenohBus(BRAIN, router.endpoint) as one, ZenohBus(BRAIN, router.endpoint) as other:
        one.token("robot", "body")
        until(lambda: "robot/body" in other.alive())
        assert other.connected()
        router.die()
        until(lambda: not other.connected() and not other.alive())
        router.come_back()
        until(lambda: other.connected() and "robot/body" in other.alive(), 10.0)
