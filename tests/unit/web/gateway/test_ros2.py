"""The sender of a ROS 2 message is known by the attachment and the GID of its publisher."""

import asyncio
import time
from contextlib import closing

import pytest
from zenoh.ext import Int64, z_serialize

from station.config.robots import load_robot
from station.control.telemetry import Channels
from tests.harness.crtk_peer import LATCHED, STAMPED_STRING, Peer, text
from tests.harness.serving import free_port
from web.gateway.options import LOOPBACK, ListenAddress
from web.gateway.ros2 import Ros2Outlet, attached, gid_of

TOKEN = (
    "@ros2_lv/0/0123456789abcdef0123456789abcdef/0/2/MP/%/%/ctr_station/%tip%measured/geometry_msgs::msg::dds_::"
    "PoseStamped_/RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8/::,10:,:,:,,"
)
PARTS = ("sequence_number", Int64(7), "source_timestamp", Int64(1_500_000_000), "source_gid", gid_of(TOKEN))
ATTACHMENT = b"".join(z_serialize(part).to_bytes() for part in PARTS)


def test_gid_is_the_hash_of_the_token_with_its_low_half_first():
    """The value was computed apart, by the rules of the hash's specification for messages of 129 to 240 bytes."""
    assert gid_of(TOKEN).hex() == "593f08be70d3105b4bf566051105cc17"


def test_an_attachment_has_the_senders_number_time_and_gid():
    assert attached(ATTACHMENT) == (7, 1.5, gid_of(TOKEN))


@pytest.mark.parametrize("damaged", [b"", ATTACHMENT[:-1], ATTACHMENT + b"\0", b"x" + ATTACHMENT[1:], bytes(77)])
def test_a_damaged_attachment_names_no_sender(damaged):
    assert attached(damaged) == (0, None, b"")


def test_the_first_command_of_a_client_has_the_name_of_its_node():
    """The command follows directly after the token from which the name is known; each client may disturb this order."""
    nodes, port = [f"node{number}" for number in range(50)], free_port()

    async def commands():
        file, received = load_robot("paper"), asyncio.Queue()

        def send(message):
            received.put_nowait(message)
            return True

        outlet = Ros2Outlet(file, Channels(file.robot()), "CTR", send, time.monotonic, pytest.fail)
        outlet.open(ListenAddress(LOOPBACK, port))
        try:
            for node in nodes:
                with closing(Peer(port, node)) as peer:
                    peer.advertise("state_command", STAMPED_STRING, LATCHED)
                    peer.send("state_command", text("enable"))
                    yield await received.get()
        finally:
            await outlet.close()

    async def names():
        return [command.node async for command in commands()]

    assert asyncio.run(names()) == nodes
