"""A Zenoh subscriber, with rosbags as the decoder, on a live gateway process."""

import queue
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore
from zenoh.ext import Int64, z_serialize

from tests.harness.gateway import MEASURED, Running, gateway
from tests.harness.gateway_clients import zenoh_session
from tests.harness.serving import free_port
from web.gateway.options import GatewayOptions, ListenAddress

STORE = get_typestore(Stores.ROS2_JAZZY)
#: Pattern of the Zenoh keys of `rmw_zenoh_cpp`: domain, topic, type and hash.
KEY = re.compile(r"0(?P<topic>/.+)/(?P<package>\w+)::msg::dds_::(?P<name>\w+)_/(?P<hash>RIHS01_[0-9a-f]{64})")
TOPICS = {"/joint_states", "/tip/measured", "/tip/estimated", "/tip/desired", "/tip/force", "/tf"}


@pytest.fixture(scope="module")
def running() -> Iterator[Running]:
    with gateway(GatewayOptions(ros2=ListenAddress("127.0.0.1", free_port()))) as running:
        yield running


def port_of(running: Running) -> int:
    (port,) = re.findall(r"tcp/127\.0\.0\.1:(\d+)", running.lines[0])
    return int(port)


def samples(session: zenoh.Session, topics: set[str]) -> dict[str, zenoh.Sample]:
    """Return one message of each topic."""
    heard: queue.Queue[zenoh.Sample] = queue.Queue()
    found: dict[str, zenoh.Sample] = {}
    subscriber = session.declare_subscriber("0/**", heard.put)
    while set(found) != topics:
        sample = heard.get(timeout=30.0)
        match = KEY.fullmatch(str(sample.key_expr))
        assert match is not None, sample.key_expr
        found[match["topic"]] = sample
    subscriber.undeclare()
    return found


def test_every_ros2_topic_arrives_with_the_type_of_its_key(running: Running) -> None:
    with closing(zenoh_session(port_of(running))) as other:
        for sample in samples(other, TOPICS).values():
            match = KEY.fullmatch(str(sample.key_expr))
            assert match is not None
            kind = f"{match['package']}/msg/{match['name']}"
            assert STORE.hash_rihs01(kind) == match["hash"]
            data = sample.payload.to_bytes()
            message = STORE.deserialize_cdr(data, kind)
            assert bytes(STORE.serialize_cdr(message, kind)) == data
            if match["topic"] == "/tip/measured":
                position = message.pose.position
                assert [position.x, position.y, position.z] == list(MEASURED)


def test_ros2_messages_have_the_attachments_that_rmw_zenoh_requires(running: Running) -> None:
    with closing(zenoh_session(port_of(running))) as other:
        told = samples(other, {*TOPICS})
    numbers = set()
    for sample in told.values():
        assert sample.attachment is not None
        data, parts = (
            sample.attachment.to_bytes(),
            [b"\x0fsequence_number", b"\x10source_timestamp", b"\x0asource_gid\x10"],
        )
        assert data.startswith(parts[0])
        number = int.from_bytes(data[len(parts[0]) :][:8], "little")
        rest = data[len(parts[0]) + 8 :]
        assert rest.startswith(parts[1])
        assert rest[len(parts[1]) + 8 :].startswith(parts[2])
        assert len(data) == sum(map(len, parts)) + 8 + 8 + 16
        assert z_serialize(Int64(number)).to_bytes() == data[len(parts[0]) :][:8]
        numbers.add(number)
    assert len(numbers) == len(told)


def test_the_ros2_graph_has_the_stations_node_and_its_publishers(running: Running) -> None:
    with closing(zenoh_session(port_of(running))) as other:
        tokens = [str(reply.ok.key_expr).split("/") for reply in other.liveliness().get("@ros2_lv/**") if reply.ok]
    assert [token[5] for token in tokens].count("NN") == 1
    assert {token[8] for token in tokens} == {"ctr_station"}
    publishers = [token for token in tokens if token[5] == "MP"]
    assert {token[9].replace("%", "/") for token in publishers} == TOPICS
    assert {token[12] for token in publishers} == {"::,10:,:,:,,"}


def test_an_existing_zenoh_router_is_joined() -> None:
    port = free_port()
    router = zenoh_session(port, "router", "listen")
    with (
        closing(router),
        gateway(GatewayOptions(ros2=ListenAddress("127.0.0.1", port))) as running,
        closing(zenoh_session(port)) as other,
    ):
        assert running.lines == (f"ROS 2 is with the Zenoh router at 127.0.0.1:{port}",)
        assert set(samples(other, TOPICS)) == TOPICS


def test_the_ros2_publisher_leaves_no_file_in_shared_memory(running: Running) -> None:
    with closing(zenoh_session(port_of(running))) as other:
        samples(other, TOPICS)
        assert ".zenoh" not in Path(f"/proc/{running.process.pid}/maps").read_text(encoding="utf-8")
