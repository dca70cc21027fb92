"""ROS 2 over Zenoh: what `rmw_zenoh_cpp` would publish, with the keys, tokens and attachments that it looks for."""

import time
from itertools import count
from typing import Any

import zenoh
from zenoh.ext import Int64, z_serialize

from core.robot.robot import Robot
from web.gateway.ros2.messages import TOPICS, Kind, messages
from web.gateway.seen import Look
from web.gateway.wanted import Address, GatewayError

#: ROS_DOMAIN_ID of those who listen, and the name of this node.
DOMAIN, NODE = 0, "ctr_station"
#: Reliability, durability, history and all else as ROS 2 has them by default; ten messages deep.
_QOS = "::,10:,:,:,,"


class Ros2Publisher:
    """One Zenoh session, which publishes only."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._tokens: list[zenoh.LivelinessToken] = []
        self._gid = b""
        self._numbers = count(1)

    def open(self, address: Address) -> str:
        """Listen there, or join the router that is there already; where, for a person.

        Raises:
            GatewayError: neither can be had.
        """
        zenoh.init_log_from_env_or("off")
        session, joined = _session("listen", address), False
        if session is None:
            session, joined = _session("connect", address), True
        if session is None:
            raise GatewayError(f"--ros2 {address} cannot be had: the port is taken, and not by a Zenoh router")
        self._session, zid = session, str(session.info.zid())
        self._gid = bytes.fromhex(f"{zid:0>32}")[:16]
        about = f"@ros2_lv/{DOMAIN}/{zid}/0"
        self._tokens = [session.liveliness().declare_token(f"{about}/0/NN/%/%/{NODE}")]
        for number, (topic, kind) in enumerate(TOPICS.items(), start=1):
            what = f"{topic.replace('/', '%')}/{kind.wire}/{kind.hash}/{_QOS}"
            self._tokens.append(session.liveliness().declare_token(f"{about}/{number}/MP/%/%/{NODE}/{what}"))
            self._publishers[topic] = session.declare_publisher(
                key(topic, kind), congestion_control=zenoh.CongestionControl.DROP
            )
        return f"with the Zenoh router at {address}" if joined else f"at tcp/{address} (Zenoh)"

    @property
    def watched(self) -> bool:
        """Whether anybody has subscribed to anything."""
        # The package's own description takes it for a bool.
        found: list[Any] = [publisher.matching_status for publisher in self._publishers.values()]
        return any(status.matching for status in found)

    def publish(self, look: Look) -> None:
        """What is seen; whoever reads too slowly gets less of it."""
        if look.seen is None:
            return
        for message in messages(self._robot, look.seen):
            self._publishers[message.topic].put(message.data, attachment=self._attachment())

    async def close(self) -> None:
        """End the session."""
        if self._session is not None:
            self._session.close()

    def _attachment(self) -> zenoh.ZBytes:
        """Without it `rmw_zenoh_cpp` takes no message: its number, its time, and who has sent it."""
        parts = (
            "sequence_number", Int64(next(self._numbers)), "source_timestamp", Int64(time.time_ns()),
            "source_gid", self._gid,
        )  # fmt: skip
        return zenoh.ZBytes(b"".join(z_serialize(part).to_bytes() for part in parts))


def key(topic: str, kind: Kind) -> str:
    """What a topic is called on Zenoh."""
    return f"{DOMAIN}{topic}/{kind.wire}/{kind.hash}"


def _session(way: str, address: Address) -> zenoh.Session | None:
    """One that knows nobody but who is at that address; None: it cannot be."""
    config = zenoh.Config()
    endpoint = f'["tcp/{address}"]'
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", endpoint if way == "listen" else "[]")
    config.insert_json5("connect/endpoints", endpoint if way == "connect" else "[]")
    config.insert_json5("connect/timeout_ms", "5000")
    config.insert_json5("connect/exit_on_failure", "true")
    config.insert_json5("listen/exit_on_failure", "true")
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        return None
