"""Who may write and read what, through a real router with real certificates.

A refusal is silent, so each test also sends what is allowed, before and after, and waits for it: what had not been
refused would have come in between.
"""

import json
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import zenoh
from zenoh import ext

from mdb_deploy.keys.credentials import KeyFolder
from mdb_protocol import codec, keys, messages
from mdb_protocol.bundle import Bundle
from mdb_protocol.bus import Bus, Inbox, Tap
from mdb_protocol.errors import BusError
from mdb_protocol.keys import Key
from mdb_protocol.messages import Message
from mdb_protocol.roles import Role
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import Router
from tests.integration.brain import BRAIN, until

ROUTER_CONFIG = Path(__file__).parents[2] / "deploy" / "router.json5"
LISTEN = "tls/127.0.0.1:0"
BLOCK = zenoh.CongestionControl.BLOCK
BOUND_S = 10.0


class Place(NamedTuple):
    """A router with keys: brains pioneer and other, teachers anna and bert, viewer tom, operator olga."""

    folder: KeyFolder
    endpoint: str

    def bundle(self, name: str) -> Path:
        (user,) = [user for user in self.folder.users().values() if user.name == name]
        return self.folder.bundle(user)

    def bus(self, name: str, brain: str = BRAIN) -> ZenohBus:
        return ZenohBus(brain, self.endpoint, credentials=self.bundle(name))

    def session(self, name: str) -> zenoh.Session:
        """Join as a client that does not ask `roles` first."""
        return join(self.endpoint, Bundle.read(self.bundle(name)))


def join(endpoint: str, bundle: Bundle) -> zenoh.Session:
    connect = {"endpoints": [endpoint], "timeout_ms": 1000, "exit_on_failure": True}
    config = {"mode": "client", "connect": connect, "transport": {"link": {"tls": bundle.client_tls()}}}
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def make_folder(path: Path) -> KeyFolder:
    folder = KeyFolder.create(path, BRAIN)
    folder.add(Role.BRAIN, "other", "other")
    for name in ("anna", "bert"):
        folder.add(Role.TEACHER, name, BRAIN)
    folder.add(Role.VIEWER, "tom", BRAIN)
    folder.add(Role.OPERATOR, "olga", BRAIN)
    return folder


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    folder = make_folder(tmp_path_factory.mktemp("roles") / "keys")
    router = Router(ROUTER_CONFIG, LISTEN, keys=folder.router_keys(LISTEN))
    yield Place(folder, router.endpoint())
    router.close()


def command(iteration: int, teacher: str = "anna") -> messages.Command:
    return messages.Command(teacher=teacher, iteration=iteration, note=1)


def next_of(bus: Bus, inbox: Inbox) -> Message:
    def take() -> object:
        bus.wait(0.05)
        return inbox.take()

    message = until(take, BOUND_S)
    assert isinstance(message, Message)
    return message


def put(session: zenoh.Session, key: str, message: Message) -> object:
    return session.put(
        key, codec.encode(message), encoding=codec.encoding_of(type(message)), congestion_control=BLOCK
    )


def put_declared(session: zenoh.Session, key: str, message: Message) -> object:
    """Put as the bus does: by a publisher with a cache, from which late joiners get as long as it is kept."""
    publisher = ext.declare_advanced_publisher(
        session,
        key,
        encoding=codec.encoding_of(type(message)),
        congestion_control=BLOCK,
        cache=ext.CacheConfig(8),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.1),
        publisher_detection=True,
    )
    publisher.put(codec.encode(message))
    return publisher


def delete(session: zenoh.Session, key: str, _: Message) -> object:
    return session.delete(key)


class Ear:
    """All that comes on the keys of a brain, heard with that brain's own certificate."""

    def __init__(self, place: Place, brain: str) -> None:
        self.bus = place.bus(brain, brain)
        self.tap: Tap = self.bus.tap()
        self.status = messages.Status(role="ear", instance="test", pid=1, uptime_s=0.0, values={}, refused={})
        self.bus.queryable(keys.STATUS, lambda: self.status, role="ear", instance="test")
        self._mark = self.bus.publisher(keys.PHASE)
        self._marks = 0

    def heard(self) -> list[str]:
        """Return the keys of all samples so far: a mark of its own comes after them."""
        self._marks += 1
        self._mark.put(messages.Phase(iteration=self._marks, name="mark"))
        got: list[str] = []

        def marked() -> bool:
            self.bus.wait(0.05)
            while (raw := self.tap.take()) is not None:
                if raw.key != keys.PHASE.at(self.bus.brain):
                    got.append(raw.key)
                elif codec.decode(messages.Phase, raw.payload, raw.encoding).iteration == self._marks:
                    return True
            return False

        until(marked, BOUND_S)
        return got


@pytest.fixture
def ear(place: Place) -> Iterator[Ear]:
    found = Ear(place, BRAIN)
    yield found
    found.bus.close()


@pytest.fixture
def other_ear(place: Place) -> Iterator[Ear]:
    found = Ear(place, "other")
    yield found
    found.bus.close()


def passed(session: zenoh.Session, ear: Ear) -> None:
    """Return when the router has dealt with all that the session has sent: a query has gone to and fro behind it."""
    replies = session.get(keys.STATUS.at(BRAIN, role="ear", instance="test"), timeout=BOUND_S)

    def answered() -> bool:
        ear.bus.wait(0.05)
        ear.bus.serve()
        return replies.try_recv() is not None

    until(answered, BOUND_S)


MODEL = messages.CurrentModel(
    model="object", version=1, generation=1, layers=[4, 1], weights=np.zeros(5, np.float32), error=0.0
)
ACTION = messages.Action(iteration=1, action={"turn": -90.0}, choice=3, valid_for_s=1.0)
PAIR = messages.Pair(
    iteration=1, before={}, note=1, action={"turn": -20.0}, choice=1, after={}, feedback=1.0, versions={},
    teacher="anna", judges=["anna"],
)  # fmt: skip
SCENE = messages.Scene(
    iteration=1, episode=0, successes=0, event="none", action=None, before=None, reached={"x": 1.0}, now={"x": 1.0}
)
PICTURE = messages.Picture(iteration=1)
CHANGE = messages.Change(settings={"swapped": True})
CONTROL = messages.Control(iteration=3, paused=True)
FORBIDDEN: dict[str, tuple[str, Message]] = {
    "an action": (keys.ACTION.at(BRAIN), ACTION),
    "a model": (keys.CURRENT_MODEL.at(BRAIN, model="object"), MODEL),
    "a pair": (keys.PAIR.at(BRAIN), PAIR),
    "a scene": (keys.SCENE.at(BRAIN), SCENE),
    "a picture": (keys.PICTURE.at(BRAIN), PICTURE),
    "a change of the robot": (keys.CHANGE.at(BRAIN), CHANGE),
    "a change of the run": (keys.CONTROL.at(BRAIN), CONTROL),
    "another teacher's lesson": (
        keys.LESSON.at(BRAIN, teacher="bert"),
        messages.Lesson(teacher="bert", iteration=1, commands=["go"], notes=[0]),
    ),
    "another teacher's command": (keys.COMMAND.at(BRAIN, teacher="bert"), command(1, "bert")),
    "another teacher's feedback": (
        keys.FEEDBACK.at(BRAIN, teacher="bert"),
        messages.Feedback(teacher="bert", iteration=1, value=1.0),
    ),
    "what was heard": (keys.HEARD.at(BRAIN, teacher="anna"), command(1)),
    "every teacher's command": (keys.COMMAND.at(BRAIN), command(1)),
    "every key": (f"mdb/{BRAIN}/**", command(1)),
    "every brain's command": ("mdb/*/teacher/anna/command", command(1)),
    "another brain's command": (keys.COMMAND.at("other", teacher="anna"), command(1)),
    "another brain's action": (keys.ACTION.at("other"), ACTION),
}
PUTS: tuple[Callable[[zenoh.Session, str, Message], object], ...] = (put, put_declared, delete)


@pytest.mark.parametrize("what", FORBIDDEN)
def test_a_teacher_cannot_write(what: str, place: Place, ear: Ear, other_ear: Ear) -> None:
    key, message = FORBIDDEN[what]
    own = keys.COMMAND.at(BRAIN, teacher="anna")
    with place.session("anna") as anna:
        put(anna, own, command(1))
        kept = [put_so(anna, key, message) for put_so in PUTS if put_so is not put_declared or "*" not in key]
        kept.append(put_declared(anna, own, command(2)))
        passed(anna, ear)
        heard: list[str] = []
        until(lambda: heard.extend(ear.heard()) or len(heard) > 1, BOUND_S)  # of two at once the other comes later
        assert heard == [own, own]
        assert other_ear.heard() == []
        late = Ear(place, BRAIN)
        until(lambda: own in late.heard(), BOUND_S)
        assert set(late.heard()) <= {own}, "what she keeps for late joiners is asked for only where it is hers"
        late.bus.close()


def test_the_brain_itself_can_write_all_that(place: Place, ear: Ear, other_ear: Ear) -> None:
    with place.session(BRAIN) as brain:
        for key, message in FORBIDDEN.values():
            if "*" not in key:
                put(brain, key, message)
        passed(brain, ear)
    written = [key for key, _ in FORBIDDEN.values() if key.startswith(f"mdb/{BRAIN}/") and "*" not in key]
    assert ear.heard() == written
    assert other_ear.heard() == [], "but only its own brain's keys"


def test_a_teacher_cannot_answer_for_what_another_has_said(place: Place, ear: Ear) -> None:
    said = keys.COMMAND.at(BRAIN, teacher="bert")
    forged = command(7, "bert")

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(said, codec.encode(forged), encoding=codec.encoding_of(messages.Command))

    with place.session("anna") as anna, place.bus("bert") as bert:
        cache = anna.declare_queryable(f"{said}/@adv/**", answer)
        snapshots = anna.declare_queryable(keys.KEPT_MODEL.at(BRAIN, model="object"), answer)
        passed(anna, ear)
        with place.bus(BRAIN) as late:
            commands = late.subscriber(keys.COMMAND)
            assert late.query(keys.KEPT_MODEL, 1.0, model="object") == []
            assert late.refusals.counts == {}
            bert.publisher(keys.COMMAND, teacher="bert").put(command(8, "bert"))
            assert next_of(late, commands) == command(8, "bert")
        for queryable in (cache, snapshots):
            queryable.undeclare()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("name", ["tom", "bert"])
def test_neither_a_viewer_nor_another_teacher_writes_for_anna(name: str, place: Place, ear: Ear) -> None:
    with place.session(name) as session, place.bus("anna") as anna:
        anna.publisher(keys.COMMAND, teacher="anna").put(command(1))
        rows = [row for row in keys.KEYS if row.message is not None]
        concrete = [row.at(BRAIN, **dict.fromkeys(row.parameters, "anna")) for row in rows]
        kept = [put_so(session, key, command(2)) for key in concrete for put_so in PUTS]
        assert kept
        passed(session, ear)
        assert ear.heard() == [keys.COMMAND.at(BRAIN, teacher="anna")]


def test_an_operator_changes_the_robot_and_the_run_and_writes_nothing_else(place: Place, ear: Ear) -> None:
    rows = [row for row in keys.KEYS if row.message is not None and row not in (keys.CHANGE, keys.CONTROL)]
    others = [row.at(BRAIN, **dict.fromkeys(row.parameters, "anna")) for row in rows]
    with place.session("olga") as olga:
        kept = [put_so(olga, key, command(1)) for key in others for put_so in PUTS]
        kept += [put(olga, row.at("other"), said) for row, said in ((keys.CHANGE, CHANGE), (keys.CONTROL, CONTROL))]
        put(olga, keys.CHANGE.at(BRAIN), CHANGE)
        put(olga, keys.CONTROL.at(BRAIN), CONTROL)
        passed(olga, ear)
        assert ear.heard() == [keys.CHANGE.at(BRAIN), keys.CONTROL.at(BRAIN)]


def test_nobody_else_is_present_in_anothers_name(place: Place, ear: Ear) -> None:
    tokens = []  # one that is let go of is withdrawn
    with place.session("anna") as anna, place.session("tom") as tom:
        for session in (anna, tom):
            for role, name in (("teacher", "bert"), ("evolver", "object"), ("viewer", "eve"), ("teacher", "*")):
                tokens.append(session.liveliness().declare_token(f"mdb/{BRAIN}/alive/{role}/{name}"))
            passed(session, ear)
        tokens.append(anna.liveliness().declare_token(keys.ALIVE.at(BRAIN, role="teacher", instance="anna")))
        tokens.append(tom.liveliness().declare_token(keys.ALIVE.at(BRAIN, role="viewer", instance="tom")))
        until(lambda: len(ear.bus.alive()) == 2, BOUND_S)
        assert ear.bus.alive() == {"teacher/anna", "viewer/tom"}


def test_a_teacher_is_heard_in_all_that_is_his(place: Place) -> None:
    sound = messages.AudioFrame(teacher="anna", iteration=3, rate_hz=8000, samples=np.zeros(4, np.int16))
    said: list[tuple[Key, Message]] = [
        (keys.COMMAND, command(3)),
        (keys.FEEDBACK, messages.Feedback(teacher="anna", iteration=3, value=0.5)),
        (keys.LESSON, messages.Lesson(teacher="anna", iteration=3, commands=["go"], notes=[0])),
        (keys.AUDIO, sound),
    ]
    with place.bus(BRAIN) as brain, place.bus("anna") as anna:
        inboxes = [brain.subscriber(row) for row, _ in said]
        anna.token("teacher", "anna")
        until(lambda: "teacher/anna" in brain.alive(), BOUND_S)
        for row, message in said:
            anna.publisher(row, teacher="anna").put(message)
        for inbox, (_, message) in zip(inboxes, said, strict=True):
            got = next_of(brain, inbox)
            assert codec.encode(got) == codec.encode(message)


def report(iteration: int) -> messages.IterationReport:
    return messages.IterationReport(
        iteration=iteration, mode="taught", action={"turn": -20.0}, choice=1, explored=False, predicted=None, note=1,
        feedback=None, event="none", prequential={}, versions={},
    )  # fmt: skip


def test_a_teacher_reads_scene_picture_reports_and_status_but_no_models(place: Place, ear: Ear) -> None:
    with place.bus("anna") as anna:
        scenes, pictures = anna.subscriber(keys.SCENE), anna.subscriber(keys.PICTURE)
        models, reports = anna.subscriber(keys.CURRENT_MODEL), anna.subscriber(keys.ITERATION)
        commands, heard = anna.subscriber(keys.COMMAND, teacher="bert"), anna.subscriber(keys.HEARD, teacher="bert")
        snapshot = messages.MemorySnapshot(
            model="object", version=1, slots=np.zeros(0, np.int64), pairs=np.zeros(0, np.int64),
            inputs=np.zeros((0, 1), np.float32), targets=np.zeros((0, 1), np.float32),
        )  # fmt: skip
        ear.bus.queryable(keys.MEMORY_SNAPSHOT, lambda: snapshot, model="object")
        with place.session("anna") as session:
            passed(session, ear)
            asked = session.get(keys.MEMORY_SNAPSHOT.at(BRAIN, model="object"), timeout=0.5)
            passed(session, ear)
            ear.bus.serve()
            assert not [reply for reply in asked if reply.ok]
        ear.bus.publisher(keys.CURRENT_MODEL, model="object").put(MODEL)
        ear.bus.publisher(keys.COMMAND, teacher="bert").put(command(1, "bert"))
        ear.bus.publisher(keys.HEARD, teacher="bert").put(command(1, "bert"))
        ear.bus.publisher(keys.ITERATION).put(report(7))
        assert next_of(anna, reports) == report(7)
        assert [inbox.take() for inbox in (models, commands, heard)] == [None, None, None]
        for row, inbox, message in ((keys.SCENE, scenes, SCENE), (keys.PICTURE, pictures, PICTURE)):
            ear.bus.publisher(row).put(message)
            assert next_of(anna, inbox) == message
    with place.bus("tom") as tom, place.bus(BRAIN) as late:
        assert next_of(tom, tom.subscriber(keys.CURRENT_MODEL)) is not None, "a viewer reads it"
        assert next_of(late, late.subscriber(keys.CURRENT_MODEL)) is not None


def test_late_joiners_on_both_sides_get_the_last(place: Place, ear: Ear) -> None:
    ear.bus.publisher(keys.PHASE).put(messages.Phase(iteration=5, name="taught"))
    with place.bus("anna") as anna:
        phase = next_of(anna, anna.subscriber(keys.PHASE))
        assert isinstance(phase, messages.Phase)
        assert phase.name == "taught"
        anna.publisher(keys.COMMAND, teacher="anna").put(command(9))
        with place.bus(BRAIN) as late:
            assert next_of(late, late.subscriber(keys.COMMAND)) == command(9)


def test_a_client_of_the_protocol_is_told_at_once_what_it_may_not(place: Place) -> None:
    with place.bus("anna") as anna:
        for row, parameters in ((keys.ACTION, {}), (keys.COMMAND, {"teacher": "bert"})):
            with pytest.raises(
                BusError, match=r"teacher anna of brain pioneer may not write .*allowed: .*anna/command"
            ):
                anna.publisher(row, **parameters)
        with pytest.raises(BusError, match="may not write"):
            anna.token("teacher", "bert")
    with pytest.raises(BusError, match=r"keys of teacher anna of brain pioneer; for brain other others are needed"):
        place.bus("anna", "other")


def test_a_teacher_learns_whether_he_is_admitted(place: Place, tmp_path: Path) -> None:
    with place.bus("anna") as anna:
        assert not anna.admitted("teacher", "anna", 0.2), "no token yet"
        anna.token("teacher", "anna")
        assert anna.admitted("teacher", "anna", BOUND_S)
    as_bert = nameless(place.bundle("anna"), tmp_path / "anna.pem")
    with ZenohBus(BRAIN, place.endpoint, credentials=as_bert) as wrong:
        wrong.token("teacher", "bert")
        assert not wrong.admitted("teacher", "bert", 0.3)
    with ZenohBus("other", place.endpoint, credentials=as_bert) as elsewhere:
        elsewhere.token("teacher", "anna")
        assert not elsewhere.admitted("teacher", "anna", 0.3)


def nameless(path: Path, copy: Path, authority: Path | None = None) -> Path:
    """Copy a bundle without the lines that say whose it is, perhaps with another authority."""
    bundle = Bundle.read(path)
    trusted = Bundle.read(authority).authority if authority else bundle.authority
    copy.write_bytes(bundle.key + bundle.certificate + trusted)
    return copy


def test_certificates_of_another_authority_are_refused_with_the_reason(place: Place, tmp_path: Path) -> None:
    foreign = make_folder(tmp_path / "foreign")
    bundle = foreign.path / "teachers" / "anna.pem"
    with pytest.raises(BusError, match=r"not from the authority in .*anna\.pem"):
        ZenohBus(BRAIN, place.endpoint, credentials=bundle)
    same_name = nameless(bundle, tmp_path / "same.pem", authority=place.bundle("anna"))
    with pytest.raises(BusError, match=r"refuses .*same\.pem: not signed by its authority"):
        ZenohBus(BRAIN, place.endpoint, credentials=same_name)
    with pytest.raises(zenoh.ZError):
        join(place.endpoint, Bundle.read(same_name))


def test_without_a_certificate_nobody_joins(place: Place) -> None:
    with pytest.raises(BusError, match="lets in only who has keys"):
        ZenohBus(BRAIN, place.endpoint)
    bare = {
        "root_ca_certificate_base64": Bundle.read(place.bundle("anna")).client_tls()["root_ca_certificate_base64"]
    }
    connect = {"endpoints": [place.endpoint], "timeout_ms": 500, "exit_on_failure": True}
    config = {"mode": "client", "connect": connect, "transport": {"link": {"tls": bare}}}
    with pytest.raises(zenoh.ZError):
        zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    with pytest.raises(BusError, match=r"something answers there, but not as an open router.*--keys"):
        ZenohBus(BRAIN, place.endpoint.replace("tls/", "tcp/"), connect_timeout_s=0.1)


def test_a_teachers_certificate_does_not_make_a_router(place: Place) -> None:
    keys_of_anna = place.folder.router_keys(LISTEN)._replace(bundle=Bundle.read(place.bundle("anna")))
    router = Router(ROUTER_CONFIG, LISTEN, keys=keys_of_anna)
    try:
        with pytest.raises(BusError, match="not from the authority"):
            ZenohBus(BRAIN, router.endpoint(), credentials=place.bundle("bert"))
    finally:
        router.close()


def test_an_expired_certificate_is_refused_by_both_sides(
    place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mdb_deploy.keys import credentials

    class LongAgo(datetime):
        @classmethod
        def now(cls, tz: object = None) -> "LongAgo":  # noqa: ARG003
            return cls.fromtimestamp((datetime.now(UTC) - timedelta(days=30)).timestamp(), UTC)

    monkeypatch.setattr(credentials, "datetime", LongAgo)
    old = place.folder.add(Role.TEACHER, "old", BRAIN, days=1)
    with pytest.raises(BusError, match=r"ended on .*ask for a new one"):
        ZenohBus(BRAIN, place.endpoint, credentials=old)
    with pytest.raises(BusError, match="the certificate has expired"):
        ZenohBus(BRAIN, place.endpoint, credentials=nameless(old, tmp_path / "old.pem"))


def test_a_wrong_host_name_is_said_with_the_right_ones(place: Place) -> None:
    listen = "tls/0.0.0.0:0"
    router = Router(ROUTER_CONFIG, listen, keys=place.folder.router_keys(listen))
    try:
        assert router.endpoint().startswith("tls/127.0.0.1:"), "where this machine's clients connect"
        wrong = router.endpoint().replace("127.0.0.1", "127.0.0.2")
        with pytest.raises(BusError, match=r"not for 127\.0\.0\.2 but for localhost, .*renew --host 127\.0\.0\.2"):
            ZenohBus(BRAIN, wrong, credentials=place.bundle("anna"))
    finally:
        router.close()
    with pytest.raises(BusError, match="no router answers"):
        ZenohBus(BRAIN, wrong, credentials=place.bundle("anna"), connect_timeout_s=0.1)


def start_again(folder: KeyFolder, endpoint: str) -> Router:
    """Start a router where one was just closed; a QUIC port is free a moment later."""

    def start() -> Router | None:
        try:
            return Router(ROUTER_CONFIG, endpoint, keys=folder.router_keys(endpoint))
        except BusError:
            return None

    router = until(start, BOUND_S)
    assert isinstance(router, Router)
    return router


@pytest.mark.parametrize("listen", [LISTEN, "quic/127.0.0.1:0"])
def test_a_removed_teacher_stays_out_even_when_the_name_is_given_again(listen: str, tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "keys")
    old = nameless(folder.path / "teachers" / "anna.pem", tmp_path / "old.pem")
    router = Router(ROUTER_CONFIG, listen, keys=folder.router_keys(listen))
    endpoint = router.endpoint()
    place = Place(folder, endpoint)
    ear, anna, bert = Ear(place, BRAIN), join(endpoint, Bundle.read(old)), place.bus("bert")
    try:
        put(anna, keys.COMMAND.at(BRAIN, teacher="anna"), command(1))
        passed(anna, ear)
        assert ear.heard() == [keys.COMMAND.at(BRAIN, teacher="anna")]

        folder.remove("anna")
        new = folder.add(Role.TEACHER, "anna", BRAIN)
        router.close()
        router = start_again(folder, endpoint)
        notes = bert.publisher(keys.COMMAND, teacher="bert")
        with ZenohBus(BRAIN, endpoint, credentials=new) as new_anna:
            for name, bus in (("bert", bert), ("anna", new_anna)):
                bus.token("teacher", name)
            until(lambda: {"teacher/bert", "teacher/anna"} <= ear.bus.alive(), BOUND_S)
            with ZenohBus(BRAIN, endpoint, credentials=old) as old_anna:
                old_anna.token("teacher", "anna-again")
                assert not old_anna.admitted("teacher", "anna-again", 0.3)
                before = old_anna.publisher(keys.COMMAND, teacher="anna")
                before.put(command(2))
                put(anna, keys.COMMAND.at(BRAIN, teacher="anna"), command(2))
                assert not list(anna.get(keys.STATUS.at(BRAIN), timeout=0.3))
            notes.put(command(3, "bert"))
            heard = until(ear.heard, BOUND_S)
            assert heard == [keys.COMMAND.at(BRAIN, teacher="bert")]
            new_anna.publisher(keys.COMMAND, teacher="anna").put(command(4))
            until(lambda: keys.COMMAND.at(BRAIN, teacher="anna") in ear.heard(), BOUND_S)
    finally:
        anna.close()  # type: ignore[no-untyped-call]
        for bus in (ear.bus, bert):
            bus.close()
        router.close()
