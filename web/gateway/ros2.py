"""ROS 2 publisher over Zenoh, without an installation of ROS 2, with what `rmw_zenoh_cpp` requires.

Messages are encoded in CDR, the wire format of ROS 2: little-endian XCDR 1, numbers aligned to their size, counted from
the end of the four-byte header. The type definitions are those of ROS 2's common_interfaces; ROS 2 (Iron and later)
identifies a type by its hash.
"""

import struct
import time
from collections.abc import Iterable, Sequence
from itertools import count
from typing import Any, NamedTuple

import numpy as np
import zenoh
from zenoh.ext import Int64, z_serialize

from core.robot.robot import Robot
from station.recording.drawing import Pose
from web.gateway.options import GatewayError, ListenAddress
from web.gateway.snapshot import SceneState, Snapshot

#: Names of two frames: the world frame of all poses, and an unrotated frame at the tip for the force that acts there.
WORLD, LOAD = "world", "tip_load"
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


class RosType(NamedTuple):
    """A ROS 2 message type."""

    name: str  #: name of the type as in `ros2 interface show`
    hash: str
    definition: str  #: complete text of the definition, nested types included

    @property
    def wire(self) -> str:
        """Name of the type as DDS and Zenoh use it."""
        package, _, name = self.name.split("/")
        return f"{package}::msg::dds_::{name}_"


class RosMessage(NamedTuple):
    """A ROS 2 message that is ready to send."""

    topic: str
    data: bytes


_BAR = "=" * 80
_HEADER = f"""{_BAR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_BAR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_VECTOR = f"""{_BAR}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
_QUATERNION = f"""{_BAR}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
JOINT_STATE = RosType(
    "sensor_msgs/msg/JointState",
    "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    f"std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n{_HEADER}",
)
POSE = RosType(
    "geometry_msgs/msg/PoseStamped",
    "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    f"std_msgs/Header header\ngeometry_msgs/Pose pose\n{_HEADER}{_BAR}\nMSG: geometry_msgs/Pose\n"
    f"geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n{_BAR}\nMSG: geometry_msgs/Point\n"
    f"float64 x\nfloat64 y\nfloat64 z\n{_QUATERNION}",
)
WRENCH = RosType(
    "geometry_msgs/msg/WrenchStamped",
    "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    f"std_msgs/Header header\ngeometry_msgs/Wrench wrench\n{_HEADER}{_BAR}\nMSG: geometry_msgs/Wrench\n"
    f"geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n{_VECTOR}",
)
TRANSFORMS = RosType(
    "tf2_msgs/msg/TFMessage",
    "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    f"geometry_msgs/TransformStamped[] transforms\n{_BAR}\nMSG: geometry_msgs/TransformStamped\n"
    f"std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n{_HEADER}{_BAR}\n"
    f"MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
    f"{_VECTOR}{_QUATERNION}",
)
#: Message type of each published topic.
TOPICS = {
    "/joint_states": JOINT_STATE,
    "/tip/measured": POSE,
    "/tip/estimated": POSE,
    "/tip/desired": POSE,
    "/tip/force": WRENCH,
    "/tf": TRANSFORMS,
}


class _Cdr:
    """Encoder of one message in CDR, the wire format of ROS 2."""

    def __init__(self) -> None:
        self._data = bytearray()

    def of(self, kind: str, *values: float) -> "_Cdr":
        """Append aligned numbers of one `struct` format."""
        size = struct.calcsize(kind)
        self._data += bytes(-len(self._data) % size)
        self._data += struct.pack(f"<{len(values)}{kind}", *values)
        return self

    def string(self, text: str) -> "_Cdr":
        """Append the length of a string, then the string."""
        encoded = text.encode() + b"\0"
        self.of("I", len(encoded))
        self._data += encoded
        return self

    def numbers(self, values: Sequence[float]) -> "_Cdr":
        """Append a sequence of float64; an empty sequence needs no alignment."""
        self.of("I", len(values))
        return self.of("d", *values) if values else self

    def head(self, stamp: int, frame: str) -> "_Cdr":
        """Append a std_msgs/Header with the time `stamp` [ns] since 1970 and the frame's name."""
        seconds, nanoseconds = divmod(stamp, 10**9)
        return self.of("i", seconds).of("I", nanoseconds).string(frame)

    def done(self) -> bytes:
        """Return the bytes of the complete message."""
        return _LITTLE_ENDIAN + bytes(self._data)


def ros_messages(robot: Robot, scene: SceneState) -> list[RosMessage]:
    """Return the ROS 2 messages of all values that are known now."""
    messages = [
        RosMessage("/joint_states", joint_state(scene.stamp, robot.joint_names, scene.joints, scene.velocities))
    ]
    messages += [RosMessage(f"/tip/{name}", pose(scene.stamp, tip)) for name, tip in scene.tips().items()]
    if scene.pose is None:
        return messages
    plate, tip = scene.pose.plate, scene.pose.tip
    named = [("plate", plate), ("tip", tip), (LOAD, (tip[0], _UPRIGHT))]
    named += [(f"{tube.name}_base", base) for tube, base in zip(robot.tubes, scene.bases, strict=True)]
    messages.append(RosMessage("/tf", transforms(scene.stamp, named)))
    if scene.force is not None and scene.moment is not None:
        # The measured moment, converted from the plate's origin to the tip; only noise if the load acts at the tip.
        torque = scene.moment - np.cross(np.subtract(tip[0], plate[0]), scene.force)
        messages.append(RosMessage("/tip/force", wrench(scene.stamp, scene.force.tolist(), torque.tolist())))
    return messages


def joint_state(stamp: int, names: Sequence[str], positions: Iterable[float], velocities: Iterable[float]) -> bytes:
    """Return a sensor_msgs/JointState with positions [rad or m] and commanded velocities, without efforts."""
    cdr = _Cdr().head(stamp, "").of("I", len(names))
    for name in names:
        cdr.string(name)
    return cdr.numbers(list(positions)).numbers(list(velocities)).numbers([]).done()


def pose(stamp: int, value: Pose) -> bytes:
    """Return a geometry_msgs/PoseStamped in the world frame [m]."""
    position, quaternion = value
    return _Cdr().head(stamp, WORLD).of("d", *position, *quaternion).done()


def wrench(stamp: int, force: Sequence[float], torque: Sequence[float]) -> bytes:
    """Return a geometry_msgs/WrenchStamped at the tip, along the world's axes [N, N m]."""
    return _Cdr().head(stamp, LOAD).of("d", *force, *torque).done()


def transforms(stamp: int, poses: Sequence[tuple[str, Pose]]) -> bytes:
    """Return a tf2_msgs/TFMessage with the poses of frames in the world frame [m]."""
    cdr = _Cdr().of("I", len(poses))
    for name, (position, quaternion) in poses:
        cdr.head(stamp, WORLD).string(name).of("d", *position, *quaternion)
    return cdr.done()


#: ROS_DOMAIN_ID that subscribers must use, and the ROS 2 node name of the gateway.
ROS_DOMAIN, NODE_NAME = 0, "ctr_station"
#: Quality of service as `rmw_zenoh_cpp` encodes it: the defaults of ROS 2, with a history of ten messages.
_QOS = "::,10:,:,:,,"


class Ros2Publisher:
    """Publisher of the robot's state for ROS 2; its Zenoh session subscribes to nothing."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._tokens: list[zenoh.LivelinessToken] = []
        self._gid = b""
        self._numbers = count(1)

    def open(self, address: ListenAddress) -> str:
        """Listen at the address, or join the Zenoh router that listens there; return the result as text.

        Raises:
            GatewayError: neither listening nor joining is possible.
        """
        zenoh.init_log_from_env_or("off")
        session, joined = _session("listen", address), False
        if session is None:
            session, joined = _session("connect", address), True
        if session is None:
            raise GatewayError(f"--ros2 {address} is not available: the port is in use, and not by a Zenoh router")
        self._session, zid = session, str(session.info.zid())
        self._gid = bytes.fromhex(f"{zid:0>32}")[:16]
        about = f"@ros2_lv/{ROS_DOMAIN}/{zid}/0"
        self._tokens = [session.liveliness().declare_token(f"{about}/0/NN/%/%/{NODE_NAME}")]
        for number, (topic, kind) in enumerate(TOPICS.items(), start=1):
            what = f"{topic.replace('/', '%')}/{kind.wire}/{kind.hash}/{_QOS}"
            self._tokens.append(session.liveliness().declare_token(f"{about}/{number}/MP/%/%/{NODE_NAME}/{what}"))
            self._publishers[topic] = session.declare_publisher(
                zenoh_key(topic, kind), congestion_control=zenoh.CongestionControl.DROP
            )
        return f"with the Zenoh router at {address}" if joined else f"at tcp/{address} (Zenoh)"

    @property
    def needs_scene(self) -> bool:
        """Whether the robot's shape is needed, because a ROS 2 subscriber exists."""
        # Typed as Any because the type stubs of `zenoh` wrongly declare `matching_status` as a bool.
        found: list[Any] = [publisher.matching_status for publisher in self._publishers.values()]
        return any(status.matching for status in found)

    def publish(self, snapshot: Snapshot) -> None:
        """Publish a snapshot of the robot; slow subscribers miss messages."""
        if snapshot.scene is None:
            return
        for message in ros_messages(self._robot, snapshot.scene):
            self._publishers[message.topic].put(message.data, attachment=self._attachment())

    async def close(self) -> None:
        """End the Zenoh session."""
        if self._session is not None:
            self._session.close()

    def _attachment(self) -> zenoh.ZBytes:
        """Return the attachment that `rmw_zenoh_cpp` requires: number, time and sender of a message."""
        parts = (
            "sequence_number", Int64(next(self._numbers)), "source_timestamp", Int64(time.time_ns()),
            "source_gid", self._gid,
        )  # fmt: skip
        return zenoh.ZBytes(b"".join(z_serialize(part).to_bytes() for part in parts))


def zenoh_key(topic: str, kind: RosType) -> str:
    """Return the Zenoh key under which `rmw_zenoh_cpp` expects a topic."""
    return f"{ROS_DOMAIN}{topic}/{kind.wire}/{kind.hash}"


def _session(mode: str, address: ListenAddress) -> zenoh.Session | None:
    """Return a Zenoh session that uses only this address, with `mode` 'listen' or 'connect'; None if it fails."""
    config = zenoh.Config()
    endpoint = f'["tcp/{address}"]'
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    # Zenoh's shared memory would leave a file in /dev/shm after a kill, and has no benefit for messages this small.
    config.insert_json5("transport/shared_memory/enabled", "false")
    config.insert_json5("listen/endpoints", endpoint if mode == "listen" else "[]")
    config.insert_json5("connect/endpoints", endpoint if mode == "connect" else "[]")
    config.insert_json5("connect/timeout_ms", "5000")
    config.insert_json5("connect/exit_on_failure", "true")
    config.insert_json5("listen/exit_on_failure", "true")
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        return None
