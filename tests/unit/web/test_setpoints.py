"""The first message of a setpoint stream, before the station moves."""

import asyncio
from typing import Any, NamedTuple

import pytest
from starlette.testclient import TestClient
from starlette.types import Message
from starlette.websockets import WebSocketDisconnect

from web.api import setpoints

#: Longest close reason of a WebSocket, RFC 6455 5.5 [bytes].
LONGEST_REASON = 123


class Refused(NamedTuple):
    """Last message of the station, with close code and reason."""

    error: str
    code: int
    reason: str


def refused(app: TestClient, first: dict[str, Any] | None, **headers: str) -> Refused:
    """Return the answer to `first`, an ASGI message; None: no message is sent."""
    with app.websocket_connect("/api/setpoints", headers={"host": "127.0.0.1:8000", **headers}) as socket:
        if first is not None:
            socket.send({"type": "websocket.receive", **first})
        error = socket.receive_json()["error"]
        with pytest.raises(WebSocketDisconnect) as closed:
            socket.receive_json()
        return Refused(error, closed.value.code, closed.value.reason)


@pytest.mark.parametrize(
    ("first", "reason"),
    [
        ("{}", "OFF"),
        ('{"speed": NaN}', "speed"),
        ('{"speed": 1e9}', "speed: "),
        ('{"reach": -1}', "reach"),
        ('{"unknown": 1}', "unknown"),
        ('{"controller": {"k1": 1e6}}', "K1"),
        ("[]", "a JSON object is needed"),
        ('{"tip": [0, 0', "not JSON"),
        ("[" * 20_000, "not JSON"),
        ('{"speed": 1' + "0" * 400 + "}", "speed"),
        ('{"speed": ' + "9" * 5000 + "}", "not JSON"),
        ('{"\\ud800": 1}', "unable to parse raw data as a unicode string"),
        ('{"controller": {"strategy": "\\udfff"}}', "\\udfff"),
    ],
)
def test_an_invalid_first_message_of_a_setpoint_stream_is_refused_with_the_reason(
    app: TestClient, first: str, reason: str
) -> None:
    answer = refused(app, {"text": first})
    assert reason in answer.error
    assert answer.code == setpoints.POLICY_VIOLATION
    # An invalid message does not make its sender operator; a valid one that the state forbids does.
    assert (app.get("/api/operator").json()["name"] is None) == (first != "{}")
    app.delete("/api/operator")


@pytest.mark.parametrize("gone", [OSError(), WebSocketDisconnect(1006), RuntimeError()])
def test_a_setpoint_client_that_disconnects_before_its_refusal_causes_no_traceback(
    app: TestClient, gone: Exception
) -> None:
    """`send` fails as in the server after a connection was reset."""
    waiting: list[Message] = [{"type": "websocket.connect"}, {"type": "websocket.receive", "text": "[]"}]
    sent = list[str]()

    async def receive() -> Message:
        return waiting.pop(0)

    async def send(message: Message) -> None:
        sent.append(message["type"])
        if message["type"] != "websocket.accept":
            raise gone

    scope = {
        "type": "websocket", "path": "/api/setpoints", "raw_path": b"/api/setpoints", "root_path": "", "scheme": "ws",
        "query_string": b"", "headers": [(b"host", b"127.0.0.1:8000")], "client": ("127.0.0.1", 5), "state": {},
        "server": ("127.0.0.1", 8000), "subprotocols": [], "asgi": {"version": "3.0", "spec_version": "2.4"},
    }  # fmt: skip
    asyncio.run(app.app(scope, receive, send))  # type: ignore[arg-type]
    assert sent == ["websocket.accept", "websocket.send"]


def test_a_binary_first_message_of_a_setpoint_stream_is_refused_with_the_reason(app: TestClient) -> None:
    assert "not bytes" in refused(app, {"bytes": b"{}"}).error


def test_a_setpoint_client_without_a_first_message_is_disconnected_with_the_reason(
    app: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(setpoints, "FIRST_MESSAGE_TIMEOUT_S", 0.01)
    answer = refused(app, None)
    assert "no message for" in answer.error
    assert app.get("/api/operator").json()["name"] is None


def test_only_the_operator_may_stream_setpoints_and_the_close_reason_fits_any_name(app: TestClient) -> None:
    name = "%F0%9F%A6%BE" * 40  # each character has four bytes
    app.post("/api/operator", json={}, headers={"x-ctr-client": "anna-0123456789", "x-ctr-name": name})
    try:
        answer = refused(app, {"text": "{}"})
        assert "is operator; ask them" in answer.error
        assert answer.reason
        assert len(answer.reason.encode()) <= LONGEST_REASON
    finally:
        app.delete("/api/operator", headers={"x-ctr-client": "anna-0123456789"})
