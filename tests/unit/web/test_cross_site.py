"""Cross-site request, foreign Host or Origin: refused before anything looks at it, on HTTP and on websockets.

Every rule is in `test_access.py`; here, that they stand before the whole application.
"""

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

FOREIGN = [
    {"host": "evil.example"},
    {"origin": "http://evil.example"},
    {"origin": "null"},
    {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors"},
]


@pytest.mark.parametrize("headers", FOREIGN)
def test_a_foreign_request_is_refused(app: TestClient, headers: dict[str, str]) -> None:
    for path in ("/", "/api/status", "/viser/"):
        assert app.get(path, headers=headers).status_code == 403
    for path in ("/api/stop", "/api/start", "/api/nothing"):
        assert app.post(path, json={}, headers=headers).status_code == 403
    assert app.get("/api/operator").json()["name"] is None


@pytest.mark.parametrize("path", ["/api/telemetry", "/viser/"])
@pytest.mark.parametrize("headers", FOREIGN[:2])
def test_so_is_a_foreign_websocket(app: TestClient, path: str, headers: dict[str, str]) -> None:
    own = {"host": app.base_url.netloc.decode()}
    with pytest.raises(WebSocketDisconnect), app.websocket_connect(path, headers=own | headers):
        pass
    assert headers[next(iter(headers))].removeprefix("http://") in app.get("/api/log?count=1").json()[0]["outcome"]
