"""Who may talk to the station."""

import asyncio
import socket

import httpx
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tests.harness.serving import Served
from web.access import Access, is_loopback
from web.tokens import Tokens

JSON = {"content-type": "application/json"}


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1:1", "localhost:80", ""])
def test_a_foreign_host_is_refused(station: Served, host: str) -> None:
    assert station.rest.get("/api/status", headers={"host": host}).status_code == 403
    assert station.rest.post("/api/stop", headers={"host": host}).status_code == 403
    assert station.status()["state"] == "READY"


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1", "https://127.0.0.1.evil.example"]
)
def test_a_page_of_another_origin_can_neither_read_nor_press(station: Served, origin: str) -> None:
    for path in ("/", "/api/status", "/viser/"):
        assert station.rest.get(path, headers={"origin": origin}).status_code == 403
    for path in ("/api/stop", "/api/start", "/api/nothing"):
        assert station.rest.post(path, headers={"origin": origin}).status_code == 403
    assert station.status()["state"] == "READY"


def test_the_stations_own_page_and_scripts_are_let_in(station: Served) -> None:
    assert station.rest.get("/api/status", headers={"origin": station.url}).status_code == 200
    assert station.rest.post("/api/stop").status_code == 200


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data"])
def test_a_form_is_not_a_request(station: Served, kind: str) -> None:
    answer = station.rest.post("/api/start", content=b"{}", headers={"content-type": kind})
    assert answer.status_code == 415
    assert station.status()["state"] == "READY"


def test_a_cross_site_request_without_origin_is_refused(station: Served) -> None:
    answer = station.rest.post("/api/stop", headers={"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors"})
    assert answer.status_code == 403
    assert station.status()["state"] == "READY"


@pytest.mark.parametrize("path", ["/viser/", "/viser", "/api/telemetry"])
def test_websockets_of_another_origin_are_refused(station: Served, path: str) -> None:
    with pytest.raises(InvalidStatus) as refusal:
        connect(f"ws://127.0.0.1:{station.port}{path}", origin="http://evil.example", proxy=None)
    assert refusal.value.response.status_code == 403


@pytest.mark.parametrize(
    ("host", "local"),
    [
        ("127.0.0.1", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("192.168.1.5", False),
        ("lab", False),
    ],
)
def test_only_loopback_counts_as_loopback(host: str, local: bool) -> None:
    assert is_loopback(host) is local


# ---- beyond loopback

TOKENS = Tokens("the-operators-token", "the-viewers-token")


async def _echo(scope: dict, receive: object, send: object) -> None:
    body = str(scope["state"]["who"].role).encode()
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": body})


def _ask(path: str, method: str = "GET", host: str = "10.1.2.3:8000", **headers: str) -> httpx.Response:
    app = Access(_echo, "0.0.0.0", 8000, TOKENS)

    async def ask() -> httpx.Response:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url=f"http://{host}") as client:
            return await client.request(method, path, headers=headers)

    return asyncio.run(ask())


@pytest.mark.parametrize(
    "headers", [{}, {"authorization": "Bearer guess"}, {"cookie": "ctr_station_8000=guess"}, {"cookie": "=;=,\x7f"}]
)
def test_beyond_loopback_a_token_is_demanded(headers: dict[str, str]) -> None:
    assert _ask("/", **headers).status_code == 401
    assert _ask("/?token=guess", **headers).status_code == 401


@pytest.mark.parametrize(("token", "role"), [(TOKENS.operator, "operator"), (TOKENS.viewer, "viewer")])
def test_the_first_visit_with_a_token_leaves_a_cookie_and_a_clean_address(token: str, role: str) -> None:
    first = _ask(f"/?token={token}")
    assert first.status_code == 303
    assert first.headers["location"] == "/"
    assert "HttpOnly" in first.headers["set-cookie"]
    assert "SameSite=Strict" in first.headers["set-cookie"]
    assert _ask("/", cookie=first.headers["set-cookie"].split(";")[0]).text == role
    assert _ask("/", authorization=f"Bearer {token}").text == role


def test_a_token_does_not_lead_to_another_host() -> None:
    assert _ask(f"/%2Fevil.example/?token={TOKENS.viewer}").headers["location"] == "/evil.example/"


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE"])
def test_viewers_look_and_press_stop(method: str) -> None:
    viewer = {"authorization": f"Bearer {TOKENS.viewer}", "content-type": "application/json"}
    assert _ask("/api/status", **viewer).text == "viewer"
    assert _ask("/api/stop", "POST", **viewer).text == "viewer"
    for path in ("/api/start", "/api/jog", "/api/operator", "/api/runs/x", "/anything"):
        refused = _ask(path, method, **viewer)
        assert refused.status_code == 403
        assert "viewers" in refused.json()["error"]


@pytest.mark.parametrize("host", ["evil.example:8000", "10.1.2.3", "10.1.2.3:9000", "10.1.2.3.evil.example:8000"])
def test_names_that_others_could_point_here_are_refused_even_with_a_token(host: str) -> None:
    assert _ask("/", host=host, authorization=f"Bearer {TOKENS.operator}").status_code == 403


@pytest.mark.parametrize("host", ["10.1.2.3:8000", "127.0.0.1:8000", "[::1]:8000", f"{socket.gethostname()}:8000"])
def test_the_machines_own_names_and_numbers_are_let_in(host: str) -> None:
    assert _ask("/", host=host, authorization=f"Bearer {TOKENS.operator}").status_code == 200


def test_no_other_site_shows_the_page_in_a_frame() -> None:
    operator = {"authorization": f"Bearer {TOKENS.operator}"}
    assert "frame-ancestors 'self'" in _ask("/", **operator).headers["content-security-policy"]
    followed = {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}
    assert _ask("/", **operator, **followed, **{"sec-fetch-dest": "document"}).status_code == 200
    assert _ask("/", **operator, **followed, **{"sec-fetch-dest": "iframe"}).status_code == 403
