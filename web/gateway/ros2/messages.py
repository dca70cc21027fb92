"""ROS 2 messages of what is seen, as CDR: the bytes that ROS 2 has on its wire, without an installation of it.

Little-endian XCDR 1: numbers are aligned to their own size, counted from behind the four bytes at the beginning. The
definitions are those of common_interfaces; the hashes are what ROS 2 (Iron and later) knows them by.
"""

import struct
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from core.robot.robot import Robot
from station.recording.posed import Pose
from web.gateway.seen import Seen

#: Frame of everything, and one at the tip that is not turned, for the force that acts there.
WORLD, LOAD = "world", "tip_load"
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


class Kind(NamedTuple):
    """A type of message."""

    name: str  #: as in `ros2 interface show`
    hash: str
    definition: str  #: all of it, parts included

    @property
    def wire(self) -> str:
        """The name that DDS and Zenoh have for it."""
        package, _, name = self.name.split("/")
        return f"{package}::msg::dds_::{name}_"


class Message(NamedTuple):
    """One, on its way."""

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
JOINT_STATE = Kind(
    "sensor_msgs/msg/JointState",
    "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    f"std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n{_HEADER}",
)
POSE = Kind(
    "geometry_msgs/msg/PoseStamped",
    "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    f"std_msgs/Header header\ngeometry_msgs/Pose pose\n{_HEADER}{_BAR}\nMSG: geometry_msgs/Pose\n"
    f"geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n{_BAR}\nMSG: geometry_msgs/Point\n"
    f"float64 x\nfloat64 y\nfloat64 z\n{_QUATERNION}",
)
WRENCH = Kind(
    "geometry_msgs/msg/WrenchStamped",
    "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    f"std_msgs/Header header\ngeometry_msgs/Wrench wrench\n{_HEADER}{_BAR}\nMSG: geometry_msgs/Wrench\n"
    f"geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n{_VECTOR}",
)
TRANSFORMS = Kind(
    "tf2_msgs/msg/TFMessage",
    "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    f"geometry_msgs/TransformStamped[] transforms\n{_BAR}\nMSG: geometry_msgs/TransformStamped\n"
    f"std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n{_HEADER}{_BAR}\n"
    f"MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
    f"{_VECTOR}{_QUATERNION}",
)
#: What is published, by topic.
TOPICS = {
    "/joint_states": JOINT_STATE,
    "/tip/measured": POSE,
    "/tip/estimated": POSE,
    "/tip/desired": POSE,
    "/tip/force": WRENCH,
    "/tf": TRANSFORMS,
}


class _Cdr:
    """Bytes that grow."""

    def __init__(self) -> None:
        self._data = bytearray()

    def of(self, kind: str, *values: float) -> "_Cdr":
        """Numbers of one kind, as `struct` calls it."""
        size = struct.calcsize(kind)
        self._data += bytes(-len(self._data) % size)
        self._data += struct.pack(f"<{len(values)}{kind}", *values)
        return self

    def word(self, text: str) -> "_Cdr":
        """A string."""
        told = text.encode() + b"\0"
        self.of("I", len(told))
        self._data += told
        return self

    def numbers(self, values: Sequence[float]) -> "_Cdr":
        """A sequence of float64; an empty one has nothing to align."""
        self.of("I", len(values))
        return self.of("d", *values) if values else self

    def head(self, stamp: int, frame: str) -> "_Cdr":
        """A std_msgs/Header of `stamp` [ns] since 1970."""
        seconds, nanoseconds = divmod(stamp, 10**9)
        return self.of("i", seconds).of("I", nanoseconds).word(frame)

    def done(self) -> bytes:
        """All of it."""
        return _LITTLE_ENDIAN + bytes(self._data)


def messages(robot: Robot, seen: Seen) -> list[Message]:
    """All that is known now."""
    said = [Message("/joint_states", joint_state(seen.stamp, robot.joint_names, seen.joints, seen.velocities))]
    said += [Message(f"/tip/{name}", pose(seen.stamp, tip)) for name, tip in seen.tips().items()]
    if seen.posed is None:
        return said
    plate, tip = seen.posed.plate, seen.posed.tip
    named = [("plate", plate), ("tip", tip), (LOAD, (tip[0], _UPRIGHT))]
    named += [(f"{tube.name}_base", base) for tube, base in zip(robot.tubes, seen.bases, strict=True)]
    said.append(Message("/tf", transforms(seen.stamp, named)))
    if seen.force is not None and seen.moment is not None:
        # What the sensors' moment about the plate is about the tip: nothing but noise, if the load acts there.
        torque = seen.moment - np.cross(np.subtract(tip[0], plate[0]), seen.force)
        said.append(Message("/tip/force", wrench(seen.stamp, seen.force.tolist(), torque.tolist())))
    return said


def joint_state(stamp: int, names: Sequence[str], positions: Iterable[float], velocities: Iterable[float]) -> bytes:
    """sensor_msgs/JointState: positions [rad or m] and velocities as sent, without efforts."""
    cdr = _Cdr().head(stamp, "").of("I", len(names))
    for name in names:
        cdr.word(name)
    return cdr.numbers(list(positions)).numbers(list(velocities)).numbers([]).done()


def pose(stamp: int, where: Pose) -> bytes:
    """geometry_msgs/PoseStamped in the world [m]."""
    position, quaternion = where
    return _Cdr().head(stamp, WORLD).of("d", *position, *quaternion).done()


def wrench(stamp: int, force: Sequence[float], torque: Sequence[float]) -> bytes:
    """geometry_msgs/WrenchStamped at the tip, along the axes of the world [N, N m]."""
    return _Cdr().head(stamp, LOAD).of("d", *force, *torque).done()


def transforms(stamp: int, poses: Sequence[tuple[str, Pose]]) -> bytes:
    """tf2_msgs/TFMessage: frames in the world [m]."""
    cdr = _Cdr().of("I", len(poses))
    for name, (position, quaternion) in poses:
        cdr.head(stamp, WORLD).word(name).of("d", *position, *quaternion)
    return cdr.done()
