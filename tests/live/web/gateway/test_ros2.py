"""A Zenoh subscriber, with rosbags as the decoder, on a live gateway process."""

import queue
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import zenoh
from zenoh.ext import AdvancedSubscriber, HistoryConfig, Int64, declare_advanced_subscriber, z_serialize

from tests.harness.crtk_peer import LATCHED, OPERATING_STATE, STORE, VOLATILE, wire
from tests.harness.gateway import MEASURED, Running, gateway
from tests.harness.gateway_clients import zenoh_session
from tests.harness.serving import free_port
from web.gateway.crtk import INPUTS, OUTPUTS
from web.gateway.options import GatewayOptions, ListenAddress
from web.gateway.ros2 import gid_of

#: Pattern of the Zenoh keys of `rmw_zenoh_cpp`: domain, topic, type and hash.
KEY = re.compile(r"0(?P<topic>/.+)/(?P<package>\w+)::msg::dds_::(?P<name>\w+)_/(?P<hash>RIHS01_[0-9a-f]{64})")
#: Topics with values that change all the time, and those with texts, which are sent at changes only.
TOPICS = {
    *(f"/CTR/{name}" for name, output in OUTPUTS.items() if output.value and name != "/tf"), "/tf",
    "/CTR/operating_state",
}  # fmt: skip
TEXTS = {"/CTR/error", "/CTR/warning", "/CTR/status"}
COMMANDS = {f"/CTR/{name}" for name in INPUTS}


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
    while not topics <= set(found):
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
            message: Any = STORE.deserialize_cdr(data, kind)
            assert bytes(STORE.serialize_cdr(message, kind)) == data
            if match["topic"] == "/CTR/measured2_cp":
                position = message.pose.position
                assert [position.x, position.y, position.z] == list(MEASURED)


def test_a_ros2_receiver_counts_no_message_as_lost(running: Running) -> None:
    """The receiver counts as `rmw_zenoh_cpp`: in each topic, the numbers of one GID rise by 1."""
    with closing(zenoh_session(port_of(running))) as other:
        heard: queue.Queue[zenoh.Sample] = queue.Queue()
        subscriber = other.declare_subscriber("0/**", heard.put)
        numbers: dict[tuple[str, bytes], list[int]] = {}
        while len(numbers) < len(TOPICS) or min(map(len, numbers.values())) < 3:
            sample = heard.get(timeout=30.0)
            assert sample.attachment is not None
            match = KEY.fullmatch(str(sample.key_expr))
            assert match is not None
            number, gid = _attached(sample.attachment.to_bytes())
            numbers.setdefault((match["topic"], gid), []).append(number)
        subscriber.undeclare()
        tokens = [str(reply.ok.key_expr) for reply in other.liveliness().get("@ros2_lv/**") if reply.ok]
    for found in numbers.values():
        assert found == list(range(found[0], found[0] + len(found)))
    of_tokens = {(token.split("/")[9].replace("%", "/"), gid_of(token)) for token in tokens if "/MP/" in token}
    assert set(numbers) <= of_tokens
    assert {topic for topic, _ in of_tokens} == TOPICS | TEXTS
    assert len({gid for _, gid in of_tokens}) == len(of_tokens)


def _attached(data: bytes) -> tuple[int, bytes]:
    """Return sequence number and GID of an attachment after a check of its other bytes."""
    parts = (b"\x0fsequence_number", b"\x10source_timestamp", b"\x0asource_gid\x10")
    number = data[len(parts[0]) :][:8]
    rest = data[len(parts[0]) + 8 :]
    assert data.startswith(parts[0])
    assert rest.startswith(parts[1])
    assert rest[len(parts[1]) + 8 :].startswith(parts[2])
    assert len(data) == sum(map(len, parts)) + 8 + 8 + 16
    assert z_serialize(Int64(int.from_bytes(number, "little"))).to_bytes() == number
    return int.from_bytes(number, "little"), data[-16:]


def test_the_ros2_graph_has_the_stations_node_with_its_publishers_and_subscribers(running: Running) -> None:
    with closing(zenoh_session(port_of(running))) as other:
        tokens = [str(reply.ok.key_expr).split("/") for reply in other.liveliness().get("@ros2_lv/**") if reply.ok]
    assert [token[5] for token in tokens].count("NN") == 1
    assert {token[8] for token in tokens} == {"ctr_station"}
    for role, topics, latched in (("MP", TOPICS | TEXTS, "operating_state"), ("MS", COMMANDS, "state_command")):
        found = {token[9].replace("%", "/"): token for token in tokens if token[5] == role}
        assert set(found) == topics
        for topic, token in found.items():
            assert token[12] == (LATCHED if topic == f"/CTR/{latched}" else VOLATILE)
            package, _, name = token[10].split("::")[0], "", token[10].split("::")[-1].rstrip("_")
            assert token[11] == STORE.hash_rihs01(f"{package}/msg/{name}")


def test_a_late_subscriber_receives_the_latched_operating_state(running: Running) -> None:
    """The subscriber queries the publisher's history, as that of `rmw_zenoh_cpp` does."""
    with closing(zenoh_session(port_of(running))) as other:
        heard: queue.Queue[zenoh.Sample] = queue.Queue()
        key = f"0/CTR/operating_state/{wire(OPERATING_STATE)}"
        subscriber: AdvancedSubscriber[None] = declare_advanced_subscriber(
            other, key, heard.put, history=HistoryConfig(max_samples=1, detect_late_publishers=True)
        )
        message: Any = STORE.deserialize_cdr(heard.get(timeout=30.0).payload.to_bytes(), OPERATING_STATE)
        subscriber.undeclare()
    assert (message.state, message.is_homed, message.is_busy) == ("ENABLED", True, False)


def test_an_existing_zenoh_router_is_joined() -> None:
    port = free_port()
    router = zenoh_session(port, "router", "listen")
    with (
        closing(router),
        gateway(GatewayOptions(ros2=ListenAddress("127.0.0.1", port))) as running,
        closing(zenoh_session(port)) as other,
    ):
        assert running.lines == (f"ROS 2 is with the Zenoh router at 127.0.0.1:{port}",)
        assert set(samples(other, TOPICS)) >= TOPICS


def test_the_ros2_publisher_leaves_no_file_in_shared_memory(running: Running) -> None:
    with closing(zenoh_session(port_of(running))) as other:
        samples(other, TOPICS)
        assert ".zenoh" not in Path(f"/proc/{running.process.pid}/maps").read_text(encoding="utf-8")
