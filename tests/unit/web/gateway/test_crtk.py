"""The messages that the topics of CRTK publish, decoded by rosbags, and the accepted commands."""

import math

import numpy as np
import pytest

from station.control.clock import REAL_TIME_CLOCK
from station.control.ring import Ring
from station.control.states import State
from station.control.telemetry import Channels
from tests.harness.gateway import DESIRED, FORCE, MEASURED, MOMENT, PAPER, Shown
from tests.unit.web.gateway.test_cdr import STORE
from web.gateway.cdr import BadMessage
from web.gateway.crtk import INPUTS, OUTPUTS, Sample, message, operating_state
from web.gateway.ros_types import COMMAND, JOINT_STATE
from web.gateway.snapshot import SnapshotReader, StationInfo

ROBOT = PAPER.robot()
N = len(ROBOT.joint_names)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
#: Names and types of the CRTK documentation and of this project's issue of the names.
DOCUMENTED = {
    "measured_js": "JointState", "setpoint_js": "JointState", "measured_cp": "PoseStamped",
    "measured2_cp": "PoseStamped", "setpoint_cp": "PoseStamped", "goal_cp": "PoseStamped",
    "local/measured_cp": "PoseStamped", "measured_cv": "TwistStamped", "measured_cf": "WrenchStamped",
    "jacobian": "Float64MultiArray", "tubes": "MarkerArray", "/tf": "TFMessage",
    "operating_state": "OperatingState", "error": "String", "warning": "String", "status": "String",
}  # fmt: skip
RECEIVED = {
    **dict.fromkeys(("servo_cp", "servo_cr", "interpolate_cp", "move_cp", "move_cr"), "PoseStamped"),
    **dict.fromkeys(
        ("servo_jp", "servo_jr", "servo_jv", "interpolate_jp", "move_jp", "move_jr"), "JointState"
    ),
    "servo_cv": "TwistStamped", "hold": "Empty", "state_command": "StringStamped",
}  # fmt: skip


@pytest.fixture
def scene():
    feed = Shown(PAPER)
    ring = Ring(len(Channels(ROBOT)))
    reader = SnapshotReader(ring, ROBOT, feed.channels, REAL_TIME_CLOCK)
    row = feed.row(3)
    of = feed.channels.of
    of(row, "request_kind")[:], of(row, "request")[:] = 1.0, (0.1, 0.2, 0.3)
    of(row, "direction_measured")[:], of(row, "direction_desired")[:] = (1.0, 0.0, 0.0), (0.0, 0.6, -0.8)
    of(row, "velocity_observed")[:] = (0.001, 0.002, 0.003)
    ring.write(row)
    yield reader.read(StationInfo(State.RUNNING), with_scene=True).scene
    for each in (ring, feed.ring):
        each.close(remove=True)


@pytest.fixture
def read(scene):
    sample = Sample(ROBOT, Channels(ROBOT), scene)
    return {name: STORE.deserialize_cdr(message(output, sample), output.kind.name) for name, output in OUTPUTS.items()}


def parts(vector):
    return [getattr(vector, name) for name in "xyzw" if hasattr(vector, name)]


def turned(quaternion):
    """Return the z axis of a rotation, by the product of quaternions."""
    x, y, z, w = parts(quaternion)
    return [2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z]


def test_every_name_has_the_type_of_the_crtk_documentation():
    assert {name: output.kind.name.rpartition("/")[2] for name, output in OUTPUTS.items()} == DOCUMENTED
    assert {name: each.kind.name.rpartition("/")[2] for name, each in INPUTS.items()} == RECEIVED
    assert [name for name, output in OUTPUTS.items() if output.latched] == ["operating_state"]
    assert [name for name, each in INPUTS.items() if each.latched] == ["state_command"]


def test_published_values_are_those_of_telemetry(read, scene):
    channels = {one.name: value for one, value in zip(Channels(ROBOT).all, scene.row.tolist(), strict=True)}
    for name, field in (("measured_js", "velocity_sent"), ("setpoint_js", "velocity_commanded")):
        joints = read[name]
        assert joints.name == list(ROBOT.joint_names)
        assert joints.position.tolist() == [channels[f"joints.{joint}"] for joint in ROBOT.joint_names]
        assert joints.velocity.tolist() == [channels[f"{field}.{joint}"] for joint in ROBOT.joint_names]
    for name, place in (("measured2_cp", MEASURED), ("setpoint_cp", DESIRED), ("goal_cp", (0.1, 0.2, 0.3))):
        assert parts(read[name].pose.position) == list(place)
    assert turned(read["measured2_cp"].pose.orientation) == pytest.approx([1.0, 0.0, 0.0])
    assert turned(read["setpoint_cp"].pose.orientation) == pytest.approx([0.0, 0.6, -0.8])
    model = read["measured_cp"].pose
    assert (parts(model.position), parts(model.orientation)) == (list(scene.estimated[0]), list(scene.estimated[1]))
    linear = read["measured_cv"].twist.linear
    assert parts(linear) == [0.001, 0.002, 0.003]
    load = read["measured_cf"]
    assert parts(load.wrench.force) == list(FORCE)
    arm = np.subtract(scene.pose.tip[0], scene.pose.plate[0])
    assert parts(load.wrench.torque) == pytest.approx(np.array(MOMENT) - np.cross(arm, FORCE))
    frames = {name: read[name].header.frame_id for name in DOCUMENTED if hasattr(read[name], "header")}
    assert set(frames.values()) == {"world", "plate", "tip_load"}
    stamps = {
        read[name].header.stamp.sec * 10**9 + read[name].header.stamp.nanosec
        for name, output in OUTPUTS.items()
        if output.frame and output.value
    }
    assert stamps == {scene.stamp}


def test_the_local_pose_in_the_plates_frame_is_the_pose_in_the_world(read, scene):
    local, plate = read["local/measured_cp"].pose, scene.pose.plate

    def product(a, b):
        ax, ay, az, aw = a
        bx, by, bz, bw = b
        return np.array([
            aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz,
        ])  # fmt: skip

    back = product(product(plate[1], (*parts(local.position), 0.0)), (*(-np.array(plate[1][:3])), plate[1][3]))
    assert back[:3] + plate[0] == pytest.approx(list(scene.pose.tip[0]))
    both = product(plate[1], parts(local.orientation))
    assert abs(float(both @ scene.pose.tip[1])) == pytest.approx(1.0)


def test_the_jacobian_is_the_derivative_of_the_models_tip(read, scene):
    layout, data = read["jacobian"].layout, read["jacobian"].data
    assert [(dim.label, dim.size, dim.stride) for dim in layout.dim] == [("rows", 6, 6 * N), ("columns", N, N)]
    assert data.tolist() == scene.pose.jacobian.ravel().tolist()


def test_rviz_shows_the_tubes_and_the_frames(read, scene):
    markers = read["tubes"].markers
    assert [(marker.ns, marker.id, marker.type, marker.action) for marker in markers] == [
        ("tubes", number, 4, 0) for number in range(len(ROBOT.tubes))
    ]
    for marker, tube, line in zip(markers, ROBOT.tubes, scene.lines, strict=True):
        assert [parts(point) for point in marker.points] == line.tolist()
        assert marker.scale.x == tube.outer_diameter
        assert marker.color.a == 1.0
        assert parts(marker.pose.orientation) == list(UPRIGHT)
    frames = {each.child_frame_id: each.transform for each in read["/tf"].transforms}
    assert set(frames) == {"plate", "tip", "tip_load", "inner_base", "outer_base"}
    assert parts(frames["inner_base"].translation) == list(scene.bases[0][0])


def test_unknown_values_have_the_stamp_0(scene):
    row = scene.row.copy()
    channels = Channels(ROBOT)
    channels.of(row, "trouble")[:] = 3.0
    channels.of(row, "request_kind")[:] = 0.0
    sample = Sample(ROBOT, channels, scene.__class__(**{**vars(scene), "row": row, "pose": None}))
    for name in ("measured_cp", "measured2_cp", "goal_cp", "local/measured_cp", "measured_cf"):
        output = OUTPUTS[name]
        stamp = STORE.deserialize_cdr(message(output, sample), output.kind.name).header.stamp
        assert (stamp.sec, stamp.nanosec) == (0, 0), name


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (State.OFF, ("DISABLED", False, False)),
        (State.CONNECTING, ("DISABLED", False, False)),
        (State.CONNECTED, ("DISABLED", False, False)),
        (State.HOMING, ("ENABLED", False, True)),
        (State.HOMED, ("ENABLED", True, False)),
        (State.READY, ("ENABLED", True, False)),
        (State.RUNNING, ("ENABLED", True, False)),
        (State.HOLD, ("PAUSED", True, False)),
        (State.STOPPED, ("PAUSED", True, False)),
        (State.FAULT, ("FAULT", False, False)),
    ],
)
def test_each_state_of_the_station_has_its_state_in_crtk(state, expected):
    assert operating_state(StationInfo(state), busy=False, stamp=5) == (((0, 5), "world"), *expected)
    assert operating_state(StationInfo(state), busy=True, stamp=5)[-1]


def parsed(name, *value):
    each = INPUTS[name]
    return each.parse(ROBOT, each.kind.decode(each.kind.encode(*value)))


def head(frame=""):
    return ((0, 0), frame)


def test_a_pose_is_a_position_and_the_direction_of_its_z_axis():
    half = math.sqrt(0.5)
    content = parsed("move_cp", head("world"), ((0.1, 0.2, 0.3), (0.0, half, 0.0, half)))
    assert content.values == (0.1, 0.2, 0.3)
    assert content.direction == pytest.approx((1.0, 0.0, 0.0))
    assert parsed("servo_cr", head(), ((0.1, 0.2, 0.3), UPRIGHT)).direction is None


def test_joints_are_taken_by_name_or_in_their_order():
    names, numbers = ROBOT.joint_names, tuple(float(number) for number in range(N))
    assert parsed("move_jp", head(), (), numbers, (), ()).values == numbers
    assert parsed("move_jp", head(), names[::-1], numbers[::-1], (), ()).values == numbers
    assert parsed("servo_jv", head(), names, (), numbers, ()).values == numbers
    # A client may fill unused vectors with values that are not numbers.
    assert parsed("move_jp", head(), names, numbers, (math.nan,) * N, ()).values == numbers


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("move_cp", (head("base"), ((0.0, 0.0, 0.0), UPRIGHT)), "frame 'base'"),
        ("servo_cp", (head(), ((math.nan, 0.0, 0.0), UPRIGHT)), "not all finite"),
        ("servo_cp", (head(), ((math.inf, 0.0, 0.0), UPRIGHT)), "not all finite"),
        ("servo_cp", (head(), ((0.0, 0.0, 0.0), (0.0,) * 4)), "no unit quaternion"),
        ("servo_cp", (head(), ((0.0, 0.0, 0.0), (1e308,) * 4)), "no unit quaternion"),
        ("servo_cv", (head(), ((0.0, math.nan, 0.0), (0.0,) * 3)), "not all finite"),
        ("servo_jv", (head(), (), (0.0,) * N, (), ()), "0 numbers for the joints"),
        ("move_jp", (head(), ("a",) * N, (0.0,) * N, (), ()), "send one for outer_rotation"),
        ("move_jp", (head(), ROBOT.joint_names, (math.nan,) * N, (), ()), "not all finite"),
        ("move_jp", (head(), ROBOT.joint_names, (0.0,) * (N + 1), (), ()), "numbers for the joints"),
    ],
)
def test_invalid_content_is_refused_with_the_reason(name, value, reason):
    with pytest.raises(BadMessage, match=reason):
        parsed(name, *value)


def test_commands_of_independent_encoders_are_read():
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), "world")
    joints = types["sensor_msgs/msg/JointState"](header, list(ROBOT.joint_names), np.ones(N), np.zeros(N), np.zeros(0))
    for kind, value in ((JOINT_STATE, joints), (COMMAND, types["crtk_msgs/msg/StringStamped"](header, "enable"))):
        assert kind.decode(bytes(STORE.serialize_cdr(value, kind.name)))[0] == ((1, 2), "world")
