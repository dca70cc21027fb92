"""CDR bytes of ROS 2 messages, decoded by rosbags with this project's definitions and with those of rosbags."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from station.control.clock import REAL_TIME_CLOCK
from station.control.ring import Ring
from station.control.states import State
from station.control.telemetry import Channels
from tests.harness.gateway import DESIRED, FORCE, MEASURED, MOMENT, PAPER, Shown
from web.gateway.ros2 import TOPICS, joint_state, ros_messages, transforms
from web.gateway.snapshot import SnapshotReader, StationInfo

ROBOT = PAPER.robot()
STORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture
def scene():
    feed = Shown(PAPER)
    ring = Ring(len(Channels(ROBOT)))
    reader = SnapshotReader(ring, ROBOT, feed.channels, REAL_TIME_CLOCK)
    ring.write(feed.row(3))
    yield reader.read(StationInfo(State.RUNNING), with_scene=True).scene
    for each in (ring, feed.ring):
        each.close(remove=True)


def xyz(vector) -> list[float]:
    return [vector.x, vector.y, vector.z]


@pytest.mark.parametrize("kind", sorted(set(TOPICS.values()), key=lambda kind: kind.name), ids=lambda kind: kind.name)
def test_ros2_type_definitions_and_hashes_are_those_of_ros(kind):
    own = get_typestore(Stores.EMPTY)
    own.register(get_types_from_msg(kind.definition, kind.name))
    assert own.hash_rihs01(kind.name) == STORE.hash_rihs01(kind.name) == kind.hash


def test_rosbags_reads_every_ros2_topic(scene):
    messages = {message.topic: message.data for message in ros_messages(ROBOT, scene)}
    assert set(messages) == set(TOPICS)
    read = {topic: STORE.deserialize_cdr(data, TOPICS[topic].name) for topic, data in messages.items()}
    for topic, data in messages.items():
        # The message has the same bytes as one that rosbags encodes.
        assert bytes(STORE.serialize_cdr(read[topic], TOPICS[topic].name)) == data

    joints = read["/joint_states"]
    assert joints.name == list(ROBOT.joint_names)
    assert joints.position == pytest.approx(scene.joints)
    assert joints.velocity == pytest.approx(scene.velocities)
    assert len(joints.effort) == 0
    assert joints.header.stamp.sec * 10**9 + joints.header.stamp.nanosec == scene.stamp
    for name, place in (("measured", MEASURED), ("desired", DESIRED)):
        tip = read[f"/tip/{name}"]
        assert tip.header.frame_id == "world"
        assert xyz(tip.pose.position) == list(place)
        assert tip.pose.orientation.w == 1.0
    frames = {each.child_frame_id: each.transform for each in read["/tf"].transforms}
    assert set(frames) == {"plate", "tip", "tip_load", "inner_base", "outer_base"}
    assert xyz(frames["tip"].translation) == list(scene.estimated[0])
    assert xyz(frames["inner_base"].translation) == list(scene.bases[0][0])
    turned = frames["inner_base"].rotation
    assert [turned.x, turned.y, turned.z, turned.w] == list(scene.bases[0][1])
    felt = read["/tip/force"]
    assert felt.header.frame_id == "tip_load"
    assert xyz(felt.wrench.force) == list(FORCE)
    arm = np.array(xyz(frames["tip"].translation)) - xyz(frames["plate"].translation)
    assert xyz(felt.wrench.torque) == pytest.approx(np.array(MOMENT) - np.cross(arm, FORCE))


@pytest.mark.parametrize("names", [(), ("a",), ("ab", "abc"), ("abcd", "abcde", "abcdefg")])
def test_ros2_numbers_after_names_of_any_length_are_aligned(names):
    numbers = [0.5 * number for number in range(len(names))]
    joints = STORE.deserialize_cdr(joint_state(5, names, numbers, numbers), "sensor_msgs/msg/JointState")
    assert joints.name == list(names)
    assert joints.position.tolist() == joints.velocity.tolist() == numbers
    poses = [(name, ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))) for name in names]
    read = STORE.deserialize_cdr(transforms(5, poses), "tf2_msgs/msg/TFMessage")
    assert [(each.child_frame_id, xyz(each.transform.translation)) for each in read.transforms] == [
        (name, [1.0, 2.0, 3.0]) for name in names
    ]


def test_unknown_values_are_not_published_to_ros2(scene):
    topics = {m.topic for m in ros_messages(ROBOT, scene.__class__(**{**vars(scene), "measured": None, "force": None}))}
    assert topics == set(TOPICS) - {"/tip/measured", "/tip/force"}
