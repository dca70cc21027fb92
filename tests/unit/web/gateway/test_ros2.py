"""The sender of a ROS 2 message is known by the attachment and the GID of its publisher."""

import asyncio
import time
from contextlib import asynccontextmanager, closing, contextmanager

import pytest
from zenoh.ext import Int64, z_serialize

from station.config.robots import load_robot
from station.control.telemetry import Channels
from tests.harness.crtk_peer import EMPTY, LATCHED, STAMPED_STRING, TYPES, Peer, text
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


@asynccontextmanager
async def opened(port, send, log=pytest.fail):
    file = load_robot("paper")
    outlet = Ros2Outlet(file, Channels(file.robot()), "CTR", send, time.monotonic, log)
    outlet.open(ListenAddress(LOOPBACK, port))
    try:
        yield outlet
    finally:
        await outlet.close()


@contextmanager
def client(port, node="node"):
    """A node that is gone afterwards."""
    with closing(Peer(port, node)) as peer:
        peer.advertise("state_command", STAMPED_STRING, LATCHED)
        peer.advertise("hold", EMPTY)
        yield peer


def test_the_first_command_of_a_client_has_the_name_of_its_node():
    """The command follows directly after the token from which the name is known; each client may disturb this order."""
    nodes, port = [f"node{number}" for number in range(50)], free_port()

    async def names():
        received = asyncio.Queue()
        async with opened(port, lambda command: received.put_nowait(command) is None):
            for node in nodes:
                with client(port, node) as peer:
                    peer.send("state_command", text("enable"))
                    yield (await received.get()).node

    async def all_names():
        return [name async for name in names()]

    assert asyncio.run(all_names()) == nodes


STOPS = [("hold", TYPES[EMPTY]()), ("state_command", text("pause")), ("state_command", text("disable"))]


@pytest.mark.parametrize("stop", STOPS, ids=["hold", "pause", "disable"])
def test_while_the_station_takes_no_message_a_stop_waits_and_other_commands_are_refused(stop):
    port, log = free_port(), []

    async def first_command():
        received, tried, ready, refused = asyncio.Queue(), asyncio.Event(), asyncio.Event(), asyncio.Event()

        def send(command):
            tried.set()
            if ready.is_set():
                received.put_nowait(command)
            return ready.is_set()

        def note(line):
            log.append(line)
            refused.set()

        async with opened(port, send, note):
            with client(port) as peer:
                peer.send("state_command", text("home"))
                await refused.wait()
                tried.clear()
                peer.send(*stop)
                await tried.wait()
                ready.set()
                return await received.get()

    command = asyncio.run(first_command())
    name, message = stop
    assert command.name == name
    assert command.text == getattr(message, "string", "")
    assert log == ["ROS 2: state_command of 'node' is refused (1 so far): the station is busy; send it again"]
