"""ROS 2 message types of the gateway: definitions as published, and the hashes by which ROS 2 identifies the types.

The definitions are those of ROS 2's common_interfaces and of `crtk_msgs`, without comments and constants.
"""

from functools import cached_property
from typing import Any, NamedTuple

from web.gateway.cdr import Layout, decode, encode, layout_of

#: Fields of each type, one a line.
DEFINITIONS = {
    "Time": "int32 sec\nuint32 nanosec",
    "Duration": "int32 sec\nuint32 nanosec",
    "Header": "Time stamp\nstring frame_id",
    "Point": "float64 x\nfloat64 y\nfloat64 z",
    "Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "Pose": "Point position\nQuaternion orientation",
    "Twist": "Vector3 linear\nVector3 angular",
    "Wrench": "Vector3 force\nVector3 torque",
    "Transform": "Vector3 translation\nQuaternion rotation",
    "TransformStamped": "Header header\nstring child_frame_id\nTransform transform",
    "MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "MultiArrayLayout": "MultiArrayDimension[] dim\nuint32 data_offset",
    "ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "CompressedImage": "Header header\nstring format\nuint8[] data",
    "UVCoordinate": "float32 u\nfloat32 v",
    "MeshFile": "string filename\nuint8[] data",
    "Marker": "Header header\nstring ns\nint32 id\nint32 type\nint32 action\nPose pose\nVector3 scale\n"
    "ColorRGBA color\nDuration lifetime\nbool frame_locked\nPoint[] points\nColorRGBA[] colors\n"
    "string texture_resource\nCompressedImage texture\nUVCoordinate[] uv_coordinates\nstring text\n"
    "string mesh_resource\nMeshFile mesh_file\nbool mesh_use_embedded_materials",
    "JointState": "Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
    "PoseStamped": "Header header\nPose pose",
    "TwistStamped": "Header header\nTwist twist",
    "WrenchStamped": "Header header\nWrench wrench",
    "Float64MultiArray": "MultiArrayLayout layout\nfloat64[] data",
    "String": "string data",
    "Empty": "",
    "OperatingState": "Header header\nstring state\nbool is_homed\nbool is_busy",
    "StringStamped": "Header header\nstring string",
    "QueryForwardKinematics_Request": "float64[] jp\nPose cp",
    "QueryForwardKinematics_Response": "Pose cp\nbool result\nstring message",
    "QueryInverseKinematics_Request": "Pose cp\nfloat64[] jp",
    "QueryInverseKinematics_Response": "float64[] jp\nbool result\nstring message",
    "TriggerOperatingState_Request": "",
    "TriggerOperatingState_Response": "OperatingState operating_state",
    "TFMessage": "TransformStamped[] transforms",
    "MarkerArray": "Marker[] markers",
}


class RosType:
    """A ROS 2 type of a message or of a service."""

    def __init__(self, name: str, digest: str) -> None:
        """`name` is that of `ros2 interface show`; `digest` is the type's hash (RIHS01) in hexadecimal digits."""
        self.name, self.hash = name, f"RIHS01_{digest}"

    @property
    def wire(self) -> str:
        """Name of the type as DDS and Zenoh use it."""
        package, sort, name = self.name.split("/")
        return f"{package}::{sort}::dds_::{name}_"

    @cached_property
    def layout(self) -> Layout:
        """Fields of the type."""
        return layout_of(self.name.rpartition("/")[2], DEFINITIONS)

    def encode(self, *value: Any) -> bytes:
        """Return the bytes of a message from the values of its fields."""
        return encode(self.layout, value)

    def decode(self, data: bytes) -> tuple[Any, ...]:
        """Return the values of the fields of a message; raise BadMessage if the bytes are no such message."""
        return decode(self.layout, data)


class RosService(NamedTuple):
    """A ROS 2 service type and its two messages."""

    kind: RosType
    request: RosType
    response: RosType


def _service(name: str, digest: str) -> RosService:
    name = f"crtk_msgs/srv/{name}"
    return RosService(RosType(name, digest), *(RosType(f"{name}_{part}", "") for part in ("Request", "Response")))


JOINT_STATE = RosType("sensor_msgs/msg/JointState", "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e")
POSE = RosType("geometry_msgs/msg/PoseStamped", "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8")
TWIST = RosType("geometry_msgs/msg/TwistStamped", "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64")
WRENCH = RosType("geometry_msgs/msg/WrenchStamped", "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77")
MATRIX = RosType("std_msgs/msg/Float64MultiArray", "1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f")
STRING = RosType("std_msgs/msg/String", "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18")
EMPTY = RosType("std_msgs/msg/Empty", "20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312")
STATE = RosType("crtk_msgs/msg/OperatingState", "5cc57eea589b217fe5194bf2735b91d4a7f2dd5ac1245ae657f7ea7590c2c80e")
COMMAND = RosType("crtk_msgs/msg/StringStamped", "83efb802e6596e03f69ac322e3231037329946f2bd13ed48874d97f5b8f5db1d")
TRANSFORMS = RosType("tf2_msgs/msg/TFMessage", "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087")
MARKERS = RosType(
    "visualization_msgs/msg/MarkerArray", "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf"
)
FORWARD = _service("QueryForwardKinematics", "5906fc58a120dbfa461f62abf0cd0d6e57d0967fa79ea4838b2d342e06d65323")
INVERSE = _service("QueryInverseKinematics", "a2ead2f28d548d1b8589033207d18095262a0a07cf3eb290cb4af77b679960be")
STATE_QUERY = _service("TriggerOperatingState", "364ceef23563859e687f916bb77ba0c376c081cccce83eb6c576e14a6f8f8372")
