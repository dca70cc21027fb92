"""ROS 2 publisher over Zenoh, with the keys, tokens and attachments that `rmw_zenoh_cpp` requires."""

import time
from itertools import count
from typing import Any

import zenoh
from zenoh.ext import Int64, z_serialize

from core.robot.robot import Robot
from web.gateway.options import GatewayError, ListenAddress
from web.gateway.ros2.messages import TOPICS, RosType, ros_messages
from web.gateway.snapshot import Snapshot

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
