"""Cross-site request, foreign Host or Origin; no token beyond loopback: refused, on HTTP and on websockets."""

import socket

import httpx
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tests.harness.serving import Served, serving


@pytest.mark.parametrize("path", ["/api/telemetry", "/viser/"])
def test_a_websocket_by_a_foreign_name_is_refused(station: Served, path: str) -> None:
    with socket.create_connection(("127.0.0.1", station.port)) as way, pytest.raises(InvalidStatus) as refusal:
        connect(f"ws://evil.example:{station.port}{path}", sock=way, proxy=None)
    assert refusal.value.response.status_code == 403


def test_beyond_loopback_everything_demands_a_token() -> None:
    with serving("--host", "0.0.0.0") as station:
        for path in ("/", "/api/status", "/api/docs", "/viser/"):
            assert httpx.get(f"{station.url}{path}").status_code == 401
        assert httpx.post(f"{station.url}/api/stop").status_code == 401
        assert httpx.get(f"{station.url}/api/status", headers={"authorization": "Bearer guess"}).status_code == 401
        for path in ("/api/telemetry", "/viser/"):
            with pytest.raises(InvalidStatus) as refusal:
                connect(f"ws://127.0.0.1:{station.port}{path}", proxy=None)
            assert refusal.value.response.status_code in (401, 403)
        assert station.status()["state"] == "READY"  # with the token
