"""Endpoints taken apart, and which of them a router may listen on without keys."""

import pytest

from mdb_protocol.endpoints import Endpoint, check_listen, parse, with_port_of
from mdb_protocol.errors import BusError


@pytest.mark.parametrize("text", ["tcp/127.0.0.1:7447", "tls/[::1]:0", "quic/brain.lan:65000", "tcp/0.0.0.0:1"])
def test_an_endpoint_is_read_and_written_again(text: str) -> None:
    assert str(parse(text)) == text


def test_metadata_and_config_of_an_endpoint_are_not_its_address() -> None:
    assert parse("tcp/127.0.0.1:7?prio=1#iface=lo") == Endpoint("tcp", "127.0.0.1", 7)


@pytest.mark.parametrize("text", ["", "tcp", "tcp/", "tcp/127.0.0.1", "tcp/:7447", "127.0.0.1:7447", "tcp/a:b"])
def test_what_is_no_endpoint_is_said(text: str) -> None:
    with pytest.raises(BusError, match=r"is not an endpoint; expected PROTOCOL/HOST:PORT"):
        parse(text)


@pytest.mark.parametrize(
    ("host", "loopback"),
    [
        ("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("localhost", True), ("0.0.0.0", False),
        ("::", False), ("192.0.2.1", False), ("fe80::1", False), ("no-such-host.invalid", False),
        ("::ffff:192.0.2.1", False),
    ],
)  # fmt: skip
def test_loopback_is_told_from_the_rest(host: str, loopback: bool) -> None:
    assert Endpoint("tcp", host, 1).is_loopback() is loopback


@pytest.mark.parametrize("listen", ["tcp/127.0.0.1:0", "tcp/[::1]:7447", "ws/localhost:1", "unixsock-stream/a.sock"])
def test_on_this_machine_alone_a_router_is_open(listen: str) -> None:
    check_listen(listen, has_keys=False, open_to_everyone=False)


@pytest.mark.parametrize("listen", ["tcp/0.0.0.0:7447", "tcp/[::]:0", "udp/192.0.2.1:7", "ws/no-such-host.invalid:1"])
def test_beyond_it_needs_keys_or_plain_words(listen: str) -> None:
    with pytest.raises(BusError, match=r"from beyond this machine.*'mdb keys init'.*--open-to-everyone"):
        check_listen(listen, has_keys=False, open_to_everyone=False)
    check_listen(listen, has_keys=False, open_to_everyone=True)
    with pytest.raises(BusError, match=r"with keys a router listens on tls/ or quic/"):
        check_listen(listen, has_keys=True, open_to_everyone=True)


@pytest.mark.parametrize("listen", ["tls/0.0.0.0:7447", "quic/127.0.0.1:0"])
def test_encryption_needs_keys(listen: str) -> None:
    check_listen(listen, has_keys=True, open_to_everyone=False)
    with pytest.raises(BusError, match="needs keys"):
        check_listen(listen, has_keys=False, open_to_everyone=True)


def test_a_router_comes_back_on_the_port_it_got() -> None:
    assert with_port_of("tls/0.0.0.0:0", "tls/127.0.0.1:4711") == "tls/0.0.0.0:4711"
    assert with_port_of("tls/[::]:7447", "tls/[::1]:7447") == "tls/[::]:7447"
    assert str(parse("quic/[::]:7").for_this_machine()) == "quic/[::1]:7"
