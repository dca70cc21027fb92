"""The first word of one who wants to lead the tip, before a station moves."""

from typing import Any

import pytest
from starlette.testclient import TestClient


def said(app: TestClient, first: str, **headers: str) -> dict[str, Any]:
    with app.websocket_connect("/api/setpoints", headers={"host": "127.0.0.1:8000", **headers}) as socket:
        socket.send_text(first)
        return socket.receive_json()


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
    ],
)
def test_what_cannot_be_is_refused_with_the_reason(app: TestClient, first: str, reason: str) -> None:
    assert reason in said(app, first)["error"]
    app.delete("/api/operator")


def test_one_leads_at_a_time(app: TestClient) -> None:
    app.post("/api/operator", json={}, headers={"x-ctr-client": "anna-0123456789", "x-ctr-name": "Anna"})
    try:
        assert "'Anna' is operator" in said(app, "{}")["error"]
    finally:
        app.delete("/api/operator", headers={"x-ctr-client": "anna-0123456789"})
