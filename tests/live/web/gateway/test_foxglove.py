"""Plain WebSocket clients of the Foxglove protocol on a live gateway process."""

import json
import socket
import struct
import time
from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from station.control.states import State
from tests.harness.gateway import ANY, Running, gateway
from web.access.identity import Tokens
from web.gateway.options import GatewayOptions, ListenAddress
from web.gateway.process import GatewayNote
from web.gateway.snapshot import StationInfo

TOKENS = Tokens("operator-0123456789", "viewer-0123456789")
SPOKEN = ["foxglove.sdk.v1", "foxglove.websocket.v1"]


@pytest.fixture(scope="module")
def running() -> Iterator[Running]:
    with gateway(GatewayOptions(foxglove=ANY)) as running:
        yield running


@pytest.fixture
def client(running: Running) -> Iterator[ClientConnection]:
    with connect(f"ws://127.0.0.1:{running.port}/", subprotocols=SPOKEN, proxy=None) as client:
        yield client


def test_a_plain_websocket_client_subscribes_to_foxglove_topics_and_unsubscribes(
    running: Running, client: ClientConnection
) -> None:
    assert client.subprotocol == SPOKEN[0]
    info, channels = _text(client), _text(client)
    assert info["op"] == "serverInfo"
    (events,) = [each["id"] for each in channels["channels"] if each["topic"] == "/events"]
    (rows,) = [each["id"] for each in channels["channels"] if each["topic"] == "/telemetry"]
    _say(client, op="subscribe", subscriptions=[{"id": 7, "channelId": events}, {"id": 8, "channelId": rows}])
    seen = set()
    while seen != {7, 8}:
        opcode, subscription, stamp = struct.unpack("<BIQ", client.recv()[:13])
        assert opcode == 1
        assert abs(1e-9 * stamp - time.time()) < 60.0
        seen.add(subscription)
    _say(client, op="unsubscribe", subscriptionIds=[8])
    running.tell(StationInfo(State.HOLD, "the tracker does not see its coil", (("controller.k1", 2.0),)))
    event = _next(client, 7)
    while "HOLD" not in event["message"]:
        event = _next(client, 7)
    assert event["message"] == "HOLD: the tracker does not see its coil"
    assert event["level"] == 3
    running.tell(StationInfo(State.RUNNING, "", (("controller.k1", 2.0), ("controller.strategy", "best"))))
    # no telemetry precedes this message, because the client has unsubscribed from telemetry
    assert _next(client, 7)["message"] == "RUNNING"


def test_foxglove_clients_can_read_controller_gains_but_not_set_them(
    running: Running, client: ClientConnection
) -> None:
    _text(client), _text(client)
    _say(client, op="getParameters", parameterNames=["controller.k1"], id="one")
    k1 = {"name": "controller.k1", "value": 2.0, "type": "float64"}
    assert _text(client) == {"op": "parameterValues", "parameters": [k1], "id": "one"}
    _say(client, op="setParameters", parameters=[{"name": "controller.k1", "value": 99.0}], id="two")
    assert "read-only" in _text(client)["message"]
    told = _text(client)
    assert told["id"] == "two"
    assert {each["name"]: each["value"] for each in told["parameters"]}["controller.k1"] == 2.0
    _say(client, op="subscribeParameterUpdates", parameterNames=["controller.k1"])
    _say(client, op="getParameters", parameterNames=["controller.k1"], id="after")
    assert _text(client)["id"] == "after"
    running.tell(StationInfo(State.RUNNING, "", (("controller.k1", 2.5), ("controller.strategy", "best"))))
    assert _text(client)["parameters"] == [{"name": "controller.k1", "value": 2.5, "type": "float64"}]
    running.tell(StationInfo(State.RUNNING, "", (("controller.k1", 2.0), ("controller.strategy", "best"))))
    assert _text(client)["parameters"][0]["value"] == 2.0


def test_invalid_foxglove_requests_are_ignored_and_do_not_disconnect(client: ClientConnection) -> None:
    _text(client), _text(client)
    for lie in (
        "", "null", "[", "[" * 5000, '{"op": 1}', '{"op": "subscribe"}', b"\x01\x02",
        '{"op": "subscribe", "subscriptions": [1, null]}', '{"op": "unsubscribe", "subscriptionIds": "1"}',
        '{"op": "subscribe", "subscriptions": [{"id": true, "channelId": 1}, {"id": -1, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1e9}, {"id": 1, "channelId": 99}]}',
        '{"op": "getParameters", "parameterNames": [{}]}', '{"op": "subscribeParameterUpdates", "parameterNames": 3}',
    ):  # fmt: skip
        client.send(lie)
    _say(client, op="getParameters", parameterNames=["controller.k1"], id="alive")
    while (told := _text(client)).get("id") != "alive":
        assert told["op"] in ("status", "parameterValues")


def test_a_foxglove_client_that_does_not_read_delays_no_other_client(
    running: Running, client: ClientConnection
) -> None:
    deaf = _deaf(running.port)
    try:
        _text(client), _text(client)
        _say(client, op="subscribe", subscriptions=[{"id": 1, "channelId": 1}, {"id": 4, "channelId": 4}])
        got, stamps = 0, list[int]()
        while got < 3_000_000:  # far more bytes than the system buffers for the client that does not read
            data = client.recv()
            got += len(data)
            stamps += [struct.unpack("<BIQ", data[:13])[2]] if data[1] == 1 else []
        assert np.all(np.diff(stamps) > 0)
        assert abs(time.time() - 1e-9 * stamps[-1]) < 5.0
        deaf.settimeout(30.0)
        held, until = 0, time.time_ns()
        while True:
            data = deaf.recv(1 << 20)
            assert data, "the gateway has hung up"
            held += len(data)
            if _has_a_row_after(data, until):
                break
        assert held < 0.5 * got
    finally:
        deaf.close()


def test_the_foxglove_server_refuses_foreign_pages_hosts_and_protocols(running: Running) -> None:
    address = f"ws://127.0.0.1:{running.port}/"
    for page in ("https://evil.example", "null", "http://localhost"):
        assert _refused(address, origin=page) == 403
    assert httpx.get(f"http://127.0.0.1:{running.port}/", headers={"host": "evil.example"}).status_code == 403
    with connect(address, subprotocols=SPOKEN, origin="https://app.foxglove.dev", proxy=None) as client:
        assert _text(client)["op"] == "serverInfo"
    with pytest.raises(InvalidStatus):
        connect(address, proxy=None)
    assert httpx.get(f"http://127.0.0.1:{running.port}/").status_code == 426


def test_a_configured_origin_may_connect_and_a_refusal_names_the_key() -> None:
    with gateway(GatewayOptions(foxglove=ANY, origins=("http://localhost:8080",))) as running:
        address = f"ws://127.0.0.1:{running.port}/"
        with connect(address, subprotocols=SPOKEN, origin="http://localhost:8080", proxy=None) as client:
            assert _text(client)["op"] == "serverInfo"
        assert _refused(address, origin="http://localhost:8081") == 403
        assert running.pipe.poll(30.0)
        note = running.pipe.recv()
        assert isinstance(note, GatewayNote)
        assert "'http://localhost:8081'" in note.text
        assert "gateway_origins" in note.text


def test_foxglove_clients_without_a_required_token_are_refused() -> None:
    with gateway(GatewayOptions(foxglove=ListenAddress("0.0.0.0", 0)), TOKENS) as running:
        assert running.lines[0].endswith(f"?token={TOKENS.viewer}")
        address = f"ws://127.0.0.1:{running.port}/"
        assert _refused(address) == 401
        assert _refused(address, origin="https://app.foxglove.dev") == 401
        assert _refused(f"{address}?token=guess") == 401
        for token in TOKENS:
            with connect(f"{address}?token={token}", subprotocols=SPOKEN, proxy=None) as client:
                assert _text(client)["op"] == "serverInfo"


def _refused(address: str, **how: Any) -> int:
    with pytest.raises(InvalidStatus) as refusal:
        connect(address, subprotocols=SPOKEN, proxy=None, **how)
    return refusal.value.response.status_code


def _say(client: ClientConnection, **wish: Any) -> None:
    client.send(json.dumps(wish))


def _text(client: ClientConnection) -> dict[str, Any]:
    return json.loads(client.recv(30.0))


def _next(client: ClientConnection, subscription: int) -> dict[str, Any]:
    """Return the next message of a subscription; skip rows sent before it."""
    while True:
        data = client.recv(30.0)
        assert isinstance(data, bytes)
        if struct.unpack("<I", data[1:5])[0] == subscription:
            return json.loads(data[13:])


def _deaf(port: int) -> socket.socket:
    """Return a raw connection that has subscribed to every row; a library would read from it."""
    deaf = socket.socket()
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
    deaf.connect(("127.0.0.1", port))
    deaf.sendall(
        f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
        f"Sec-WebSocket-Protocol: {SPOKEN[0]}\r\n\r\n".encode()
    )
    wish = b'{"op":"subscribe","subscriptions":[{"id":16909060,"channelId":1}]}'
    deaf.sendall(bytes((0x81, 0x80 | len(wish), 0, 0, 0, 0)) + wish)  # masked with zeros
    return deaf


def _has_a_row_after(data: bytes, moment: int) -> bool:
    """Return whether the data has the start of a message of that subscription, newer than `moment` [ns]."""
    head, place = b"\x01" + struct.pack("<I", 16909060), -1
    while (place := data.find(head, place + 1)) >= 0 and place + 13 <= len(data):
        if struct.unpack("<Q", data[place + 5 : place + 13])[0] > moment:
            return True
    return False


def test_invalid_bytes_at_the_foxglove_port_print_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    with gateway(GatewayOptions(foxglove=ANY)) as running:
        for garbage in (b"\x16\x03\x01\x00\xff" * 20, b"GET / HTTP/1.1\r\nhost: x\r\n\r\n", b"\r\n\r\n", b""):
            with socket.create_connection(("127.0.0.1", running.port)) as other:
                other.sendall(garbage)
                other.shutdown(socket.SHUT_WR)
                while other.recv(4096):
                    pass
    assert capfd.readouterr().err == ""
