"""Cross-site request, foreign Host or Origin; no token beyond loopback: refused, on HTTP and on websockets.

Every rule is in `tests/unit/web/test_access.py`; here, that they stand before the station itself.
"""

import socket

import httpx
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from tests.harness.serving import Served, serving

FOREIGN = [
    {"host": "evil.example"},
    {"origin": "http://evil.example"},
    {"origin": "null"},
    {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors"},
]


def test_a_foreign_request_is_refused_before_it_is_looked_at(station: Served) -> None:
    for headers in FOREIGN:
        for path in ("/", "/api/status", "/viser/"):
            assert station.rest.get(path, headers=headers).status_code == 403
        for path in ("/api/stop", "/api/start", "/api/nothing"):
            assert station.rest.post(path, json={}, headers=headers).status_code == 403
    assert station.status()["state"] == "READY"


@pytest.mark.parametrize("path", ["/api/telemetry", "/viser/"])
def test_so_is_a_foreign_websocket(station: Served, path: str) -> None:
    for headers in FOREIGN[:2]:
        given, host = headers.get("origin"), headers.get("host", "127.0.0.1")
        origin = None if given is None else Origin(given)
        with socket.create_connection(("127.0.0.1", station.port)) as way, pytest.raises(InvalidStatus) as refusal:
            connect(f"ws://{host}:{station.port}{path}", sock=way, origin=origin, proxy=None)
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
