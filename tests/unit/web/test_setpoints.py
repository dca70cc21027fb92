"""The first word of one who wants to lead the tip, before a station moves."""

from typing import Any, NamedTuple

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from web.api import setpoints

#: That a websocket may be closed with, RFC 6455 5.5 [bytes].
LONGEST_REASON = 123


class Refused(NamedTuple):
    """What the station said before it hung up, and how it did."""

    error: str
    code: int
    reason: str


def refused(app: TestClient, first: dict[str, Any] | None, **headers: str) -> Refused:
    """The answer to `first`, the message as ASGI has it; None: nothing is said."""
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
        ('{"speed": 1e9}', "speed: Input should be less than or equal to 0.1"),
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
def test_what_cannot_be_is_refused_with_the_reason(app: TestClient, first: str, reason: str) -> None:
    told = refused(app, {"text": first})
    assert reason in told.error
    assert told.code == setpoints.NOT_ALLOWED
    # What makes no sense makes nobody operator; what the state forbids does.
    assert (app.get("/api/operator").json()["name"] is None) == (first != "{}")
    app.delete("/api/operator")


def test_bytes_are_refused_with_the_reason(app: TestClient) -> None:
    assert "not bytes" in refused(app, {"bytes": b"{}"}).error


def test_one_who_connects_and_does_not_begin_is_told_so_and_hung_up(
    app: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(setpoints, "PATIENCE", 0.01)
    told = refused(app, None)
    assert "nothing was said" in told.error
    assert app.get("/api/operator").json()["name"] is None


def test_one_leads_at_a_time_and_the_reason_fits_whatever_the_operators_name(app: TestClient) -> None:
    name = "%F0%9F%A6%BE" * 40  # four bytes each
    app.post("/api/operator", json={}, headers={"x-ctr-client": "anna-0123456789", "x-ctr-name": name})
    try:
        told = refused(app, {"text": "{}"})
        assert "is operator; ask them" in told.error
        assert told.reason
        assert len(told.reason.encode()) <= LONGEST_REASON
    finally:
        app.delete("/api/operator", headers={"x-ctr-client": "anna-0123456789"})
