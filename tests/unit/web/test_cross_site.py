"""Cross-site request, foreign Host or Origin: refused before any processing, on HTTP and on WebSockets.

`access/test_gate.py` tests every rule of the access checks; this file tests that the checks precede the application.
"""

import pytest
from starlette.testclient import TestClient, WebSocketDenialResponse

FOREIGN = [
    {"host": "evil.example"},
    {"origin": "http://evil.example"},
    {"origin": "null"},
    {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors"},
]


@pytest.mark.parametrize("headers", FOREIGN)
def test_a_cross_site_rest_request_is_refused(app: TestClient, headers: dict[str, str]) -> None:
    for path in ("/", "/api/status", "/viser/"):
        assert app.get(path, headers=headers).status_code == 403
    for path in ("/api/stop", "/api/start", "/api/nothing"):
        assert app.post(path, json={}, headers=headers).status_code == 403
    assert app.get("/api/operator").json()["name"] is None


@pytest.mark.parametrize("path", ["/api/telemetry", "/viser/"])
@pytest.mark.parametrize("headers", FOREIGN[:2])
def test_a_cross_site_websocket_is_refused(app: TestClient, path: str, headers: dict[str, str]) -> None:
    own = {"host": app.base_url.netloc.decode()}
    with pytest.raises(WebSocketDenialResponse) as refused, app.websocket_connect(path, headers=own | headers):
        pass
    assert refused.value.status_code == 403
    assert "error" in refused.value.json()
    assert headers[next(iter(headers))].removeprefix("http://") in app.get("/api/log?count=1").json()[0]["outcome"]


@pytest.mark.parametrize("path", ["/api/telemetry?rate=200", "/api/telemetry?rate=fast"])
def test_a_websocket_with_an_invalid_parameter_is_refused_with_its_name_and_value(app: TestClient, path: str) -> None:
    headers = {"host": app.base_url.netloc.decode()}
    with pytest.raises(WebSocketDenialResponse) as refused, app.websocket_connect(path, headers=headers):
        pass
    assert refused.value.status_code == 422
    assert refused.value.json()["error"].startswith("rate = ")
