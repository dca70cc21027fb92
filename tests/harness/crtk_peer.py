"""A ROS 2 peer over Zenoh that uses nothing of this project: types from rosbags, tokens and attachments by the rules of
`rmw_zenoh_cpp`.
"""

import itertools
import threading
import time
from collections import defaultdict
from typing import Any

import xxhash
import zenoh
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
OPERATING_STATE, STAMPED_STRING = "crtk_msgs/msg/OperatingState", "crtk_msgs/msg/StringStamped"
STATE_FIELDS = "std_msgs/Header header\nstring state\nbool is_homed\nbool is_busy\n"
STORE.register(get_types_from_msg(STATE_FIELDS, OPERATING_STATE))
STORE.register(get_types_from_msg("std_msgs/Header header\nstring string\n", STAMPED_STRING))
POSE_FIELD, RESULT = "geometry_msgs/Pose cp\n", "bool result\nstring message\n"
#: Requests and responses of the services, as published by `crtk_msgs` and by ROS 2.
SERVICES = {
    "crtk_msgs/srv/QueryForwardKinematics": (f"float64[] jp\n{POSE_FIELD}", POSE_FIELD + RESULT),
    "crtk_msgs/srv/QueryInverseKinematics": (f"{POSE_FIELD}float64[] jp\n", f"float64[] jp\n{RESULT}"),
    "crtk_msgs/srv/TriggerOperatingState": ("", "crtk_msgs/OperatingState operating_state\n"),
    "std_srvs/srv/SetBool": ("bool data\n", "bool success\nstring message\n"),
}
FORWARD, INVERSE, STATE, _ = SERVICES
# ROS 2 takes the `char` of this type as uint8, rosbags does not.
INFO = "uint8 event_type\nbuiltin_interfaces/Time stamp\nuint8[16] client_gid\nint64 sequence_number\n"
STORE.fielddefs["service_msgs/msg/ServiceEventInfo"] = get_types_from_msg(INFO, "a/msg/B")["a/msg/B"]
for name, texts in SERVICES.items():
    parts: dict[str, Any] = {part: (Nodetype.NAME, f"{name}_{part}") for part in ("Request", "Response", "Event")}
    fields: list[Any] = [get_types_from_msg(each, "a/msg/B")["a/msg/B"] if each else ([], []) for each in texts]
    events: list[Any] = [(part.lower(), (Nodetype.SEQUENCE, (parts[part], 1))) for part in ("Request", "Response")]
    info: Any = ("info", (Nodetype.NAME, "service_msgs/msg/ServiceEventInfo"))
    STORE.register({
        **{f"{name}_{part}": each for part, each in zip(parts, fields, strict=False)},
        f"{name}_Event": ([], [info, *events]), name: ([], [(f"{key.lower()}_message", parts[key]) for key in parts]),
    })  # fmt: skip
TYPES = STORE.types
POSE, JOINTS, TWIST = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/JointState", "geometry_msgs/msg/TwistStamped"
STRING, EMPTY = "std_msgs/msg/String", "std_msgs/msg/Empty"
VOLATILE, LATCHED = "::,10:,:,:,,", ":1:,1:,:,:,,"


def wire(kind: str) -> str:
    """Return the part of a key with the type and its hash."""
    package, sort, name = kind.split("/")
    return f"{package}::{sort}::dds_::{name}_/{STORE.hash_rihs01(kind)}"


def attachment(number: int, gid: bytes) -> bytes:
    return (
        b"\x0fsequence_number" + number.to_bytes(8, "little") + b"\x10source_timestamp"
        + time.time_ns().to_bytes(8, "little") + b"\x0asource_gid\x10" + gid
    )  # fmt: skip


class Peer:
    """Node with publishers and subscribers in its own Zenoh session."""

    def __init__(self, port: int, node: str, namespace: str = "CTR") -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
        self.session = zenoh.open(config)
        self.node, self.namespace = node, namespace
        self.id = str(self.session.info.zid())
        self._entities = itertools.count(1)
        self._publishers: dict[str, tuple[Any, str, bytes, Any]] = {}
        self._kept: list[Any] = []
        self._changed = threading.Condition()
        self.newest: dict[str, Any] = {}
        self.all: defaultdict[str, list[Any]] = defaultdict(list)
        self.times: defaultdict[str, list[float]] = defaultdict(list)

    def close(self) -> None:
        self.session.close()

    def subscribe(self, name: str, kind: str) -> None:
        topic = f"/{self.namespace}/{name}"

        def receive(sample: zenoh.Sample) -> None:
            message = STORE.deserialize_cdr(sample.payload.to_bytes(), kind)
            with self._changed:
                self.newest[name] = message
                self.all[name].append(message)
                self.times[name].append(time.monotonic())
                self._changed.notify_all()

        self._kept.append(self.session.declare_subscriber(f"0{topic}/{wire(kind)}", receive))

    def advertise(self, name: str, kind: str, qos: str = VOLATILE) -> None:
        topic = f"/{self.namespace}/{name}"
        token = (
            f"@ros2_lv/0/{self.id}/0/{next(self._entities)}/MP/%/%/{self.node}/{topic.replace('/', '%')}/"
            f"{wire(kind)}/{qos}"
        )
        self._kept.append(self.session.liveliness().declare_token(token))
        gid = xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")
        key = f"0{topic}/{wire(kind)}"
        self._publishers[name] = (self.session.declare_publisher(key), kind, gid, itertools.count(1))

    def send(self, name: str, message: Any) -> None:
        _, kind, gid, numbers = self._publishers[name]
        self.send_bytes(name, bytes(STORE.serialize_cdr(message, kind)), gid, next(numbers))

    def send_bytes(self, name: str, data: bytes, gid: bytes | None = None, number: int = 1) -> None:
        publisher, _, own, _ = self._publishers[name]
        publisher.put(data, attachment=attachment(number, own if gid is None else gid))

    def call(self, name: str, kind: str, *fields: Any) -> Any:
        """Return the response of a service to a request with these fields."""
        request = bytes(STORE.serialize_cdr(TYPES[f"{kind}_Request"](*fields), f"{kind}_Request"))
        sent = attachment(next(self._entities), bytes(range(16)))
        replies = self.session.get(
            f"0/{self.namespace}/{name}/{wire(kind)}", payload=request, attachment=sent, timeout=60.0,
            target=zenoh.QueryTarget.ALL_COMPLETE, consolidation=zenoh.ConsolidationMode.NONE,
        )  # fmt: skip
        (sample,) = [reply.ok for reply in replies]
        assert sample is not None
        assert sample.attachment is not None
        got = sample.attachment.to_bytes()
        assert (got[:24], got[-16:]) == (sent[:24], sent[-16:])  # number and client, by which rmw finds the request
        return STORE.deserialize_cdr(sample.payload.to_bytes(), f"{kind}_Response")

    def wait(self, name: str, what: Any, patience: float = 60.0) -> Any:
        """Return the newest message of a topic for which `what` is true, or one that arrives within `patience` [s]."""
        deadline = time.monotonic() + patience
        with self._changed:
            while not (name in self.newest and what(self.newest[name])):
                left = deadline - time.monotonic()
                assert left > 0.0, (name, self.newest.get(name), [each.data for each in self.all["error"]])
                self._changed.wait(left)
            return self.newest[name]

    def error(self, text: str) -> str:
        """Return an error that contains a text and arrives within a minute, and forget the errors."""
        deadline = time.monotonic() + 60.0
        with self._changed:
            while not (found := [each.data for each in self.all["error"] if text in each.data]):
                left = deadline - time.monotonic()
                assert left > 0.0, (text, [each.data for each in self.all["error"]])
                self._changed.wait(left)
            self.all["error"].clear()
        return found[0]


def header(frame: str = "") -> Any:
    return TYPES["std_msgs/msg/Header"](TYPES["builtin_interfaces/msg/Time"](0, 0), frame)


def text(command: str) -> Any:
    return TYPES[STAMPED_STRING](header(), command)


def pose(position: Any, frame: str = "world") -> Any:
    point = TYPES["geometry_msgs/msg/Point"](*map(float, position))
    upright = TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    return TYPES[POSE](header(frame), TYPES["geometry_msgs/msg/Pose"](point, upright))


def xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]
