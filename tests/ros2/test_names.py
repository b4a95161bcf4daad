"""Names, hashes, tokens, attachments and CDR against rmw_zenoh's own examples and two implementations of others."""

import math
import struct

import numpy as np
import pytest

pytest.importorskip("rosbags")
ros2 = pytest.importorskip("pamoja.ros2")

from zenoh_ros2_sdk.attachment import Attachment  # noqa: E402
from zenoh_ros2_sdk.discovery import _parse_liveliness_keyexpr  # noqa: E402
from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability  # noqa: E402

from mdb_sim.bodies.ros2 import messages, names  # noqa: E402
from mdb_sim.bodies.ros2.names import Node, Topic, Type  # noqa: E402
from mdb_sim.body import BodyError  # noqa: E402
from tests.ros2.peer import parts  # noqa: E402

STRING = Type("std_msgs/msg/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18")
SESSION = "aac3178e146ba6f1fc6e6a4085e77f21"
OF_ROS = {
    messages.TWIST: "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    messages.TWIST_STAMPED: "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    messages.SCAN: "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    messages.ODOMETRY: "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
}
"""As `ros2 topic info -v` says them, in several public repositories."""


def test_keys_and_tokens_are_those_of_rmw_zenohs_design_page():
    assert Topic("/chatter", STRING).key(0) == f"0/chatter/std_msgs::msg::dds_::String_/{STRING.hash}"
    assert Topic("/robot1/chatter", STRING).key(0).startswith("0/robot1/chatter/std_msgs::")
    listener = Node(2, SESSION, "/", "listener")
    assert listener.token() == f"@ros2_lv/2/{SESSION}/0/0/NN/%/%/listener"
    token = listener.endpoint_token(10, names.SUBSCRIPTION, Topic("/chatter", STRING), names.RELIABLE)
    assert token == (
        f"@ros2_lv/2/{SESSION}/0/10/MS/%/%/listener/%chatter/std_msgs::msg::dds_::String_/{STRING.hash}/::,10:,:,:,,"
    )


@pytest.mark.parametrize(
    ("number", "kind", "gid"),
    [
        (1, names.PUBLISHER, "e4f56c26790a63265397a613657e3aab"),
        (2, names.SUBSCRIPTION, "3747c389aa1c3b32ca6f32a904ff7c18"),
    ],
)
def test_an_endpoint_is_known_by_the_gid_that_rmw_zenoh_gives_it(number, kind, gid):
    """Vectors that RaftROS captured from Jazzy's `simplified_XXH3_128bits` (its test of ZenohROSIdentity)."""
    node = Node(23, SESSION, "/raft_test", "raft_fixture")
    token = node.endpoint_token(number, kind, Topic("/raft_test/chatter", STRING), names.SENSOR_DATA)
    assert names.gid_of(token).hex() == gid


@pytest.mark.parametrize("name", [messages.TWIST, messages.TWIST_STAMPED, messages.SCAN, messages.ODOMETRY])
def test_hashes_are_those_of_another_implementation_and_of_ros(name):
    found = messages.type_of(name)
    assert found.hash == parts(name)[2], "zenoh-ros2-sdk computes it from the definitions alike"
    assert found.hash == f"RIHS01_{OF_ROS[name]}"
    assert bytes(ros2.type_hash_digest(found.hash)).hex() == OF_ROS[name]
    assert found.dds == ros2.dds_type_name(name)
    assert messages.type_of(name, hashed=False).hash == "TypeHashNotSupported"


@pytest.mark.parametrize("topic", ["/cmd_vel", "/robot1/cmd_vel", "/a/b_c/d9"])
def test_keys_and_mangled_names_are_those_of_another_implementation(topic):
    twist = messages.type_of(messages.TWIST)
    assert Topic(topic, twist).key(7) == ros2.entity_key(7, topic, twist.name, twist.hash)
    assert names.mangled(topic) == ros2.percent_mangle(topic)


def test_a_token_says_to_another_implementation_what_it_should():
    topic = Topic("/r/cmd_vel", messages.type_of(messages.TWIST))
    token = Node(3, SESSION, "/r", "mdb").endpoint_token(1, names.PUBLISHER, topic, names.RELIABLE)
    said = _parse_liveliness_keyexpr(token)
    assert said is not None
    assert (said["domain_id"], said["kind"], said["node_name"]) == (3, "MP", "mdb")
    assert (said["namespace"], said["qualified_name"]) == ("/r", "/r/cmd_vel")
    assert (said["dds_type"], said["type_hash"]) == (topic.type.dds, topic.type.hash)
    assert names.endpoint_of(token) == names.Endpoint("MP", "mdb", "/r/cmd_vel", topic.type.dds, topic.type.hash)
    for other in (Node(3, SESSION, "/r", "mdb").token(), "", "@ros2_lv/0", "mdb/pioneer/alive"):
        assert names.endpoint_of(other) is None


def test_qualities_of_service_are_those_of_another_implementation():
    reliable = QosProfile(reliability=QosReliability.RELIABLE, durability=QosDurability.VOLATILE, history_depth=10)
    assert reliable.encode() == names.RELIABLE
    sensor = QosProfile(reliability=QosReliability.BEST_EFFORT, durability=QosDurability.VOLATILE, history_depth=5)
    assert sensor.encode() == names.SENSOR_DATA


def test_an_attachment_is_read_by_another_implementation():
    sent = names.attachment(5, 1_700_000_000_123_456_789, bytes(range(16)))
    assert len(sent) == 33
    assert Attachment.from_bytes(sent) == Attachment(5, 1_700_000_000_123_456_789, bytes(range(16)))


@pytest.mark.parametrize(("name", "namespace", "whole"), [
    ("cmd_vel", "/", "/cmd_vel"), ("cmd_vel", "/robot1", "/robot1/cmd_vel"), ("/odom", "/robot1", "/odom"),
])  # fmt: skip
def test_a_relative_name_is_in_the_namespace(name, namespace, whole):
    assert names.resolved(name, namespace) == whole
    assert ros2.is_fully_qualified(whole)


@pytest.mark.parametrize("name", ["", "/", "a b", "9a", "scan/", "a//b", "/scan/*", "a%b"])
def test_a_name_that_is_none_is_refused(name):
    with pytest.raises(BodyError, match="expected letters"):
        names.resolved(name, "/")


def test_a_twist_is_read_by_another_cdr():
    linear, angular = ros2.twist_from_cdr(list(messages.twist_cdr(0.25, -1.5)))
    assert (linear, angular) == ((0.25, 0.0, 0.0), (0.0, 0.0, -1.5))
    stamped = ros2.CdrReader(list(messages.twist_cdr(0.25, -1.5, "base")))
    assert (stamped.read_i32(), stamped.read_u32(), stamped.read_u32()) == (0, 0, len("base") + 1)


def text(writer, value):
    """CDR of a string that fills four bytes with its end, as `abc` does."""
    raw = value.encode() + b"\0"
    assert len(raw) % 4 == 0
    writer.write_u32(len(raw))
    for (word,) in struct.iter_unpack("<I", raw):
        writer.write_u32(word)


def test_a_scan_of_another_cdr_is_read():
    writer = ros2.CdrWriter()
    writer.write_i32(12)
    writer.write_u32(500_000_000)
    text(writer, "laserfr")
    for value in (-1.0, 1.0, 0.5, 0.0, 0.2, 0.25, 4.0):
        writer.write_f32(value)
    writer.write_u32(5)
    for value in (1.0, math.inf, 0.1, math.nan, 3.5):
        writer.write_f32(value)
    writer.write_u32(0)
    scan = messages.scan_of(bytes(writer.bytes))
    assert (scan.stamp_s, scan.frame, scan.step_rad, scan.most_m) == (12.5, "laserfr", 0.5, 4.0)
    np.testing.assert_allclose(scan.bearings_rad, [-1.0, 1.0])
    np.testing.assert_allclose(scan.ranges_m, [1.0, 3.5])


def test_an_odometry_of_another_cdr_is_read():
    writer = ros2.CdrWriter()
    writer.write_i32(7)
    writer.write_u32(0)
    text(writer, "odomfra")
    text(writer, "basefra")
    half = math.radians(120.0) / 2.0
    for value in (1.5, -2.0, 0.0, 0.0, 0.0, math.sin(half), math.cos(half), *[0.0] * 36):
        writer.write_f64(value)
    for value in (0.3, 0.0, 0.0, 0.0, 0.0, -0.7, *[0.0] * 36):
        writer.write_f64(value)
    found = messages.odometry_of(bytes(writer.bytes))
    assert (found.stamp_s, found.frame, found.child_frame) == (7.0, "odomfra", "basefra")
    assert (found.x_m, found.y_m, found.forward_m_s, found.turning_rad_s) == (1.5, -2.0, 0.3, -0.7)
    assert found.heading_rad == pytest.approx(math.radians(120.0))


@pytest.mark.parametrize("cdr", [b"", b"\x00\x01\x00\x00", b"nonsense" * 9])
def test_bytes_that_are_no_message_are_refused(cdr):
    for read in (messages.scan_of, messages.odometry_of):
        with pytest.raises(ValueError, match="that are no"):
            read(cdr)
