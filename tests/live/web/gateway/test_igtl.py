"""Third-party OpenIGTLink clients on a live gateway process."""

import socket
import struct
import time
from collections.abc import Iterator

import numpy as np
import pytest
from pyigtl import OpenIGTLinkClient
from pyigtl.messages import MessageBase, StringMessage, TransformMessage

from station.control.states import State
from tests.harness.gateway import ANY, MEASURED, Running, eventually, gateway
from web.gateway.igtl import HEADER_BYTES
from web.gateway.options import GatewayOptions
from web.gateway.process import TargetMessage
from web.gateway.snapshot import StationInfo


@pytest.fixture(scope="module")
def running() -> Iterator[Running]:
    with gateway(GatewayOptions(igtl=ANY)) as running:
        yield running


@pytest.fixture
def client(running: Running) -> Iterator[OpenIGTLinkClient]:
    client = OpenIGTLinkClient("127.0.0.1", running.port)
    yield client
    client.stop()


@pytest.fixture
def plain(running: Running) -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", running.port)) as plain:
        plain.settimeout(30.0)
        yield plain


def test_pyigtl_receives_the_tips_and_the_state(running: Running, client: OpenIGTLinkClient) -> None:
    measured = client.wait_for_message("TipMeasured", timeout=30)
    assert measured.matrix[:3, 3] == pytest.approx(1e3 * np.array(MEASURED), rel=1e-6)
    for name in ("TipEstimated", "TipDesired", "InnerBase", "OuterBase"):
        assert isinstance(client.wait_for_message(name, timeout=30), TransformMessage)
    running.tell(StationInfo(State.HOLD, "the tracker does not see its coil"))
    assert eventually(lambda: _newest_text(client, "Cause") == "the tracker does not see its coil")
    running.tell(StationInfo(State.RUNNING))
    assert eventually(lambda: _newest_text(client, "State") == "RUNNING")


def test_an_openigtlink_client_that_does_not_read_delays_no_other_client(running: Running) -> None:
    """Three clients: two read, one never reads."""
    deaf = socket.socket()
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
    deaf.connect(("127.0.0.1", running.port))
    readers = [socket.create_connection(("127.0.0.1", running.port)) for _ in range(2)]
    try:
        sent = 0
        while sent < 1_500_000:  # ten times the bytes that the system buffers for a client that does not read
            for reader in readers:
                reader.settimeout(30.0)
                messages = [_message(reader) for _ in range(300)]
                stamps = [stamp for _, name, stamp, _ in messages if name == "TipMeasured"]
                assert np.all(np.diff(stamps) > 0.0)  # each message is newer than the one before
            sent += sum(HEADER_BYTES + len(body) for *_, body in messages)
        # The last message is current, although messages for the other client are queued.
        assert abs(time.time() - stamps[-1]) < 5.0
        deaf.settimeout(30.0)
        assert len(_all_there(deaf)) < 0.2 * sent
    finally:
        for each in (deaf, *readers):
            each.close()


def test_openigtlink_streams_can_be_stopped_and_started(plain: socket.socket) -> None:
    assert _stamps(plain, "TipMeasured", 2)
    plain.sendall(_query("STP_TRANS", ""))
    _until(plain, "RTS_TRANS")
    kinds = {kind for kind, _, _ in _read(plain, 40)}
    assert "TRANSFORM" not in kinds
    assert "POLYDATA" in kinds
    plain.sendall(_query("STT_TRANS", "TipMeasured") + _query("STT_TRANS", ""))
    assert _until(plain, "RTS_TRANS") == b"\0"
    assert _stamps(plain, "TipMeasured", 2)
    plain.sendall(_query("STT_TDATA", "", struct.pack("> i 32s", 20, b"")))
    assert _until(plain, "RTS_TDATA") == b"\0"
    assert len(_until(plain, "TDATA")) == 5 * 70
    plain.sendall(_query("STT_IMAGE", ""))
    assert _until(plain, "RTS_IMAGE") == b"\1"  # 1: the station has no images
    plain.sendall(_query("GET_STATUS", ""))
    assert _until(plain, "STATUS")[30:].rstrip(b"\0") == b"RUNNING"


def test_only_openigtlink_targets_of_the_first_client_reach_the_station(
    running: Running, client: OpenIGTLinkClient
) -> None:
    client.wait_for_message("TipMeasured", timeout=30)
    matrix = np.eye(4)
    matrix[:3, 3] = (11.0, 22.0, 155.0)
    client.send_message(StringMessage("nonsense", device_name="Target"))
    client.send_message(TransformMessage(matrix, device_name="Needle"))
    client.send_message(TransformMessage(matrix, device_name="Target", timestamp=77.25))
    heard = _next_target(running)
    assert heard.position == pytest.approx([0.011, 0.022, 0.155])
    assert heard.sent == pytest.approx(77.25)
    with socket.create_connection(("127.0.0.1", running.port)) as second:
        second.settimeout(30.0)
        second.sendall(TransformMessage(-matrix, device_name="Target").pack() + _query("GET_TRANS", "TipMeasured"))
        second.sendall(_query("STP_SENSOR", ""))
        _until(second, "RTS_SENSOR")  # the answer shows that the server has also read the target
    client.send_message(TransformMessage(matrix, device_name="Target", timestamp=78.25))
    assert _next_target(running).sent == pytest.approx(78.25)


def test_corrupted_openigtlink_bytes_disconnect_only_their_sender(running: Running, client: OpenIGTLinkClient) -> None:
    random = np.random.default_rng(1)
    target = TransformMessage(device_name="Target").pack()
    for junk in (
        random.bytes(5000),
        target[:40] + random.bytes(200),
        target[:HEADER_BYTES] + b"\1" * 48,
        b"GET / HTTP/1.1\r\n" * 9,
    ):
        with socket.create_connection(("127.0.0.1", running.port)) as bad:
            bad.settimeout(30.0)
            bad.sendall(junk)
            assert _is_hung_up(bad)
    client.get_latest_messages()
    assert client.wait_for_message("TipMeasured", timeout=30)
    while running.pipe.poll(0.5):
        assert "a client is disconnected" in running.pipe.recv().text


def _next_target(running: Running) -> TargetMessage:
    """Return the next target that the gateway has sent, after its notes about skipped messages."""
    while running.pipe.poll(30.0):
        heard = running.pipe.recv()
        if isinstance(heard, TargetMessage):
            return heard
        assert "are skipped" in heard.text
    raise AssertionError("no target")


def _newest_text(client: OpenIGTLinkClient, name: str) -> str | None:
    message = client.wait_for_message(name, timeout=0.1)
    return None if message is None else message.string


def _exactly(plain: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = plain.recv(count - len(data))
        assert more, "the gateway has hung up"
        data += more
    return data


def _message(plain: socket.socket) -> tuple[str, str, float, bytes]:
    head = MessageBase.parse_header(_exactly(plain, HEADER_BYTES))
    return head["message_type"], head["device_name"], head["timestamp"], _exactly(plain, head["body_size"])


def _read(plain: socket.socket, count: int) -> list[tuple[str, str, bytes]]:
    return [(kind, name, body) for kind, name, _, body in (_message(plain) for _ in range(count))]


def _until(plain: socket.socket, kind: str) -> bytes:
    """Return the body of the next message of that kind."""
    for _ in range(1000):
        found, _, _, body = _message(plain)
        if found == kind:
            return body
    raise AssertionError(f"no {kind}")


def _stamps(plain: socket.socket, name: str, count: int) -> list[float]:
    stamps: list[float] = []
    while len(stamps) < count:
        _, found, stamp, _ = _message(plain)
        if found == name:
            stamps.append(stamp)
    return stamps


def _query(kind: str, name: str, body: bytes = b"") -> bytes:
    message = MessageBase(device_name=name)
    message.header_version = 2
    message._message_type = kind
    message._pack_content = lambda: body
    return message.pack()


def _all_there(plain: socket.socket) -> bytes:
    """Read queued messages until one is newer than now."""
    now, data = time.time(), b""
    while True:
        head = _exactly(plain, HEADER_BYTES)
        fields = MessageBase.parse_header(head)
        data += head + _exactly(plain, fields["body_size"])
        if fields["timestamp"] > now:
            return data


def _is_hung_up(plain: socket.socket) -> bool:
    try:
        while plain.recv(65536):
            pass
    except ConnectionError:
        pass
    return True
