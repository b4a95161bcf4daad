"""The ROS 2 body against a robot of another make, through a real router."""

import math
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

pytest.importorskip("rosbags")
pytest.importorskip("zenoh_ros2_sdk")

from mdb_protocol.messages import Drawing
from mdb_sim.bodies.finding import make_body, spec_of
from mdb_sim.bodies.ros2 import messages, names
from mdb_sim.body import NOTHING, BodyError
from tests.conformance.body_conformance import BodyConformance
from tests.ros2.other_side import ROOT, OtherRobot, robot, router

QUICK = {"rate_hz": 0.5, "stale_s": 10.0, "linear_m_s": 1.0, "angular_deg_s": 300.0}
"""With a robot whose time goes by with what it is told: it is told once, however busy this machine is."""
BOUND_S = 30.0


@pytest.fixture(scope="module")
def stepped() -> Iterator[OtherRobot]:
    with robot("--stepped") as other:
        yield other


@pytest.fixture(scope="class")
def conforming(request: pytest.FixtureRequest) -> Iterator[None]:
    with robot("--stepped", "--pillar", "0.9", "0.3") as other:
        request.cls.options = QUICK | {"connect": other.connect, "object_at": {"x_m": 0.9, "y_m": 0.3}}
        yield


def make(other: OtherRobot, **options):
    return make_body("ros2", QUICK | {"connect": other.connect} | options)


@pytest.mark.usefixtures("conforming")
class TestRos2Body(BodyConformance):
    actions = 5
    repeats = False

    def make(self):
        return make_body("ros2", self.options)


# ---- what the other side sees ----


def test_the_other_side_sees_our_topics_with_their_types_and_hashes(stepped):
    body = make(stepped)
    ends = {
        "/cmd_vel": ("publishers", messages.TWIST, names.RELIABLE),
        "/scan": ("subscribers", messages.SCAN, names.SENSOR_DATA),
        "/odom": ("subscribers", messages.ODOMETRY, names.RELIABLE),
    }
    for topic, (kind, name, qos) in ends.items():
        graph = stepped.graph(topic, lambda found, kind=kind: len(found[kind]) == 1)
        assert graph["types"] == [name], "both sides mean one type"
        assert graph[kind] == [["mdb", name, messages.type_of(name).hash, qos]]
    body.close()
    assert stepped.graph("/cmd_vel", lambda found: not found["publishers"]), "it leaves the graph"


def test_the_other_side_is_told_what_was_meant_and_by_whom(stepped):
    body = make(stepped)
    body.reset(1, 0)
    body.act({"turn": 30.0})
    heard = stepped.ask()
    pamoja = pytest.importorskip("pamoja.ros2")
    assert pamoja.twist_from_cdr(heard["raw"]) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), "at last, rest"
    assert heard["last"] == [0.0, 0.0]
    node = body._driver._node
    assert heard["key"] == node.cmd_vel.key(0)
    assert heard["gid"] == names.gid_of(
        node.graph_name.endpoint_token(1, names.PUBLISHER, node.cmd_vel, names.RELIABLE)
    ).hex()  # fmt: skip
    assert heard["sequence"] == node._said
    body.close()


def test_it_turns_and_advances_as_it_is_told(stepped):
    body = make(stepped)
    body.reset(1, 0)
    for turn in (90.0, -45.0, 180.0, 0.0, -120.0):
        (x_m, y_m, heading), touches = stepped.ask()["at"], stepped.ask()["touches"]
        outcome = body.act({"turn": turn})
        after = stepped.ask()
        assert math.remainder(after["at"][2] - heading - math.radians(turn), 2 * math.pi) == pytest.approx(
            0, abs=0.05
        )
        if outcome.event == NOTHING:
            assert math.hypot(after["at"][0] - x_m, after["at"][1] - y_m) == pytest.approx(0.20, abs=0.02)
        assert after["rests"]
        assert after["touches"] == touches
        scene = body.scene()
        assert [scene["x_m"], scene["y_m"], scene["heading_rad"]] == pytest.approx(after["at"], abs=1e-6)
        assert (scene["object_x_m"], scene["object_y_m"]) == (
            pytest.approx(1.0, abs=0.05),
            pytest.approx(0.4, abs=0.05),
        )
    body.close()


def test_speeds_that_are_told_directly_are_held_for_a_while_and_scaled():
    actuators = {
        "ahead": {"does": "linear", "low": -1.0, "high": 1.0, "scale": 0.5},
        "left": {"does": "angular", "low": -90.0, "high": 90.0},
    }
    with robot("--stepped", "--pillar", "1.5", "0.9") as other:
        body = make(other, actuators=actuators, hold_s=1.0)
        assert [actuator.unit for actuator in body.spec.actuators] == ["", "deg/s"]
        body.reset(1, 0)
        body.act({"ahead": 1.0, "left": 0.0})
        heard = other.ask()
        assert heard["fastest"] == [0.5, 0.0]
        assert heard["at"][0] == pytest.approx(0.5, abs=0.06)
        assert heard["rests"]
        body.act({"ahead": 0.0, "left": -90.0})
        assert other.ask()["fastest"] == [0.5, pytest.approx(math.pi / 2)]
        assert math.degrees(other.ask()["at"][2]) == pytest.approx(-90.0, abs=10.0)
        body.close()


def test_it_stops_before_it_touches_and_captures_what_is_in_front():
    with robot("--stepped", "--pillar", "1.2", "0.0") as other:
        body = make(other, capture_distance_m=0.1, then_advance_m=0.5)
        body.reset(1, 0)
        events = [body.act({"turn": 0.0}).event for _ in range(3)]
        assert events == [NOTHING, "bump", "bump"]
        assert other.ask()["touches"] == 0
        body.close()
        body = make(other)
        body.reset(1, 0)
        assert body.act({"turn": 0.0}).event == "capture"
        body.close()


def test_what_is_beyond_its_attention_is_lost_but_stays_in_the_scene():
    with robot("--stepped", "--pillar", "1.5", "0.0") as other:
        body = make(other, then_advance_m=1.0)
        body.reset(1, 0)
        outcomes = [body.act({"turn": turn}) for turn in (180.0, 0.0, 0.0)]
        assert [outcome.event for outcome in outcomes] == [NOTHING, NOTHING, "lost"]
        assert all(outcome.reading == {} for outcome in outcomes)
        assert body.scene()["object_x_m"] == pytest.approx(1.5, abs=0.02)
        body.close()


def test_a_new_episode_begins_around_the_object_at_a_place_of_its_own(stepped):
    body = make(stepped, begin="around")
    body.reset(4, 0)
    before = stepped.ask()
    places = []
    for episode in (1, 2):
        reading = body.reset(4, episode)
        scene = body.scene()
        places.append((scene["x_m"], scene["y_m"]))
        assert 0.6 <= reading["distance"] <= 1.6
    assert len({before["at"][0], *(x for x, _ in places)}) == 3
    assert stepped.ask()["touches"] == before["touches"]
    body.close()


def test_it_can_be_watched(stepped):
    body = make(stepped, sectors=8)
    reading = body.reset(1, 0)
    assert len(reading["ranges"]) == 8
    drawing = body.draw(reading)
    assert isinstance(drawing, Drawing)
    scene = body.scene()
    (thing,) = [shape for shape in drawing.shapes if shape.what == "thing"]
    assert thing.points == [(scene["object_x_m"], scene["object_y_m"])]
    echoes = [shape.points[0] for shape in drawing.shapes if shape.what == "sensed"]
    to_surface = [math.hypot(x - 1.0, y - 0.4) for x, y in echoes]
    assert min(to_surface) == pytest.approx(0.15, abs=0.03)
    body.close()


def test_a_twist_stamped_in_a_domain_and_a_namespace_is_understood():
    with robot("--stepped", "--stamped", "--domain", "42") as other:
        topics = {"cmd_vel": "/cmd_vel", "scan": "/scan", "odom": "/odom"}
        body = make(other, stamped=True, domain=42, namespace="/brain", topics=topics)
        body.reset(1, 0)
        body.act({"turn": 0.0})
        assert other.ask()["at"][0] == pytest.approx(0.2, abs=0.02)
        assert other.ask("graph /cmd_vel")["types"] == [messages.TWIST_STAMPED]
        body.close()


# ---- the halts ----


def told_to_rest(other: OtherRobot, since: int) -> bool:
    """Wait until the robot was told something since, and rests."""
    deadline = time.monotonic() + BOUND_S
    while time.monotonic() < deadline:
        heard = other.ask()
        if heard["twists"] > since and heard["last"] == [0.0, 0.0] and heard["rests"]:
            return True
    return False


def moving(other: OtherRobot) -> int:
    """Wait until the robot moves; return how often it was told something."""
    deadline = time.monotonic() + BOUND_S
    while time.monotonic() < deadline:
        if not (heard := other.ask())["rests"]:
            return int(heard["twists"])
    raise AssertionError("it did not move within the bound")


@pytest.mark.parametrize("how", ["halt", "close"])
def test_while_it_acts_it_is_halted_by_a_twist_of_zero(how):
    """By the clock: this robot keeps the last Twist for ever, so that only a Twist of zero can have stopped it."""
    with robot("--pillar", "1.5", "0.9") as other:
        body = make_body("ros2", {"connect": other.connect, "angular_deg_s": 20.0, "stale_s": 10.0})
        body.reset(1, 0)
        ended = []

        def act() -> None:
            try:
                ended.append(body.act({"turn": 180.0}))
            except BodyError as error:
                ended.append(error)

        thread = threading.Thread(target=act)
        thread.start()
        since = moving(other)
        getattr(body, how)()
        thread.join(BOUND_S)
        assert not thread.is_alive()
        assert told_to_rest(other, since)
        assert abs(other.ask()["at"][2]) < math.radians(170.0), "long before the turn was over"
        if how == "halt":
            assert ended[0].event == NOTHING
            assert body.act({"turn": 0.0}).event == NOTHING, "and it can go on"
        else:
            assert "closed" in str(ended[0])
        body.close()


DRIVER = """
import sys
from mdb_sim.bodies.finding import make_body
body = make_body("ros2", {"connect": sys.argv[1], "angular_deg_s": 20.0})
body.reset(1, 0)
body.act({"turn": 180.0})
"""


def test_a_robot_that_a_dead_process_left_moving_is_stopped_by_the_next():
    with robot("--pillar", "1.5", "0.9") as other:
        process = subprocess.Popen([sys.executable, "-c", DRIVER, other.connect], cwd=ROOT)
        moving(other)
        process.kill()
        process.wait(BOUND_S)
        since = other.ask()["twists"]
        assert not other.ask()["rests"], "nobody has told it to stop"
        body = make_body("ros2", {"connect": other.connect})
        body.reset(1, 0)
        assert told_to_rest(other, since)
        body.close()


@pytest.mark.long
def test_a_robot_that_went_on_while_the_router_was_dead_is_stopped_when_it_is_back():
    with router() as connect:
        other = OtherRobot(connect, "--pillar", "1.5", "0.9")
        body = make_body("ros2", {"connect": connect, "angular_deg_s": 20.0, "stale_s": 0.5})
        body.reset(1, 0)
        failed: list[BodyError] = []
        thread = threading.Thread(target=refused, args=(body, failed))
        thread.start()
        moving(other)
    thread.join(BOUND_S)
    assert "no odometry" in str(failed[0])
    assert not other.ask()["rests"], "it was not heard"
    with router(connect):
        deadline = time.monotonic() + BOUND_S
        while refused(body, failed):
            assert time.monotonic() < deadline, failed[-1]
        assert other.ask()["rests"]
        body.close()
        other.close()


def refused(body, failed: list[BodyError]) -> bool:
    """Tell it to turn; whether it could not."""
    try:
        body.act({"turn": 90.0})
    except BodyError as error:
        failed.append(error)
        return True
    return False


def test_faster_than_real_time_it_acts_by_the_robots_own_clock():
    with robot("--time-scale", "4", "--pillar", "1.5", "0.9") as other:
        body = make_body("ros2", {"connect": other.connect, "stale_s": 10.0, "then_advance_m": 0.3})
        body.reset(1, 0)
        body.act({"turn": 45.0})
        after = other.ask()
        assert after["rests"]
        assert math.degrees(after["at"][2]) == pytest.approx(45.0, abs=20.0)
        assert math.hypot(*after["at"][:2]) == pytest.approx(0.3, abs=0.15)
        body.close()


# ---- what is amiss ----


@pytest.mark.parametrize(
    ("quiet", "says"), [("odom", "no odometry on /odom for 0.5 s"), ("scan", "no scan on /scan")]
)
def test_without_news_it_stops_and_says_so(quiet, says):
    with robot() as other:
        body = make_body("ros2", {"connect": other.connect, "stale_s": 0.5})
        body.reset(1, 0)
        since = other.ask()["twists"]
        other.ask(f"quiet {quiet}")
        with pytest.raises(BodyError, match=says):
            body.act({"turn": 20.0})
        assert told_to_rest(other, since)
        at = other.ask()["at"][:2]
        with pytest.raises(BodyError, match=says):
            body.act({"turn": 0.0})
        assert other.ask()["at"][:2] == pytest.approx(at, abs=0.03), "it does not drive blindly"
        other.ask("quiet")
        assert body.act({"turn": 20.0}).event == NOTHING, "when they come again it goes on"
        body.close()


def test_a_robot_that_is_frozen_is_noticed():
    with robot() as other:
        body = make_body("ros2", {"connect": other.connect, "stale_s": 0.5})
        body.reset(1, 0)
        other.freeze()
        with pytest.raises(BodyError, match="the robot was told to stop; is it on, and the router"):
            body.act({"turn": 20.0})
        other.thaw()
        body.close()


def test_without_a_router_the_error_names_it_and_how_to_start_one():
    says = r"robot\.options\.connect = 'tcp/127\.0\.0\.1:1' within 0\.2 s; .*ros2 run rmw_zenoh_cpp rmw_zenohd"
    with pytest.raises(BodyError, match=says):
        make_body("ros2", {"connect": "tcp/127.0.0.1:1", "first_s": 0.2})


def test_without_a_robot_the_error_says_what_was_waited_for():
    with router() as connect:
        body = make_body("ros2", {"connect": connect, "first_s": 0.2})
        says = r"nothing comes on /scan as sensor_msgs/msg/LaserScan within 0\.2 s, and nobody is there for it"
        with pytest.raises(BodyError, match=says):
            body.reset(1, 0)
        body.close()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"stamped": True}, "nothing is listened to on /cmd_vel as geometry_msgs/msg/TwistStamped .* node base has"),
        ({"hashes": False}, "nothing comes on /scan .* node laser has .*RIHS01_64c1.*TypeHashNotSupported"),
        ({"domain": 3}, "nobody is there for it in domain 3"),
        ({"frames": {"scan": "laser"}}, r"frame is 'base_scan'; robot\.options\.frames\.scan says 'laser'"),
        ({"frames": {"odom": "map"}}, r"frame is 'odom'; robot\.options\.frames\.odom says 'map'"),
        ({"object_width_m": [0.001, 0.002]}, "sees no object, .* 0.001 to 0.002 m wide.*robot.options.object_at"),
    ],
)
def test_a_difference_to_the_robot_is_told(stepped, options, says):
    body = make(stepped, first_s=0.5, **options)
    with pytest.raises(BodyError, match=re.compile(says)):
        body.reset(1, 0)
    body.close()


WITHOUT = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[1]:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Missing())
from mdb_sim.bodies.finding import make_body
make_body("ros2", {})
"""


@pytest.mark.parametrize("package", ["rosbags", "xxhash"])
def test_without_a_package_that_it_needs_the_error_names_the_extra(package):
    command = [sys.executable, "-c", WITHOUT, package]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert f"needs the package {package}" in run.stderr
    assert "pip install 'multilevel-darwinist-brain[ros2]'" in run.stderr


def test_what_it_has_is_known_without_a_robot():
    spec = spec_of("ros2", {})
    assert [sensor.name for sensor in spec.sensors] == ["distance", "angle", "continuity"]
    assert [actuator.name for actuator in spec.actuators] == ["turn"]
    assert spec.events == ("capture", "bump", "lost", "stuck")
