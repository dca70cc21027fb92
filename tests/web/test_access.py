"""Who may talk to the station."""

import asyncio

import httpx
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tests.serving import Served
from web.access import Access, is_loopback

JSON = {"content-type": "application/json"}


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1:1", "localhost:80", ""])
def test_a_foreign_host_is_refused(station: Served, host: str) -> None:
    assert station.rest.get("/api/status", headers={"host": host}).status_code == 403


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1", "https://127.0.0.1.evil.example"]
)
def test_a_page_of_another_origin_can_neither_read_nor_press(station: Served, origin: str) -> None:
    assert station.rest.get("/api/status", headers={"origin": origin}).status_code == 403
    assert station.rest.post("/api/stop", headers={"origin": origin}).status_code == 403
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


async def _hello(scope: dict, receive: object, send: object) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"hello"})


def _get(path: str, **headers: str) -> httpx.Response:
    app = Access(_hello, "0.0.0.0", 8000, "a-token")

    async def ask() -> httpx.Response:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://lab:8000") as client:
            return await client.get(path, headers=headers)

    return asyncio.run(ask())


def test_beyond_loopback_a_token_is_demanded() -> None:
    assert _get("/").status_code == 401
    assert _get("/?token=guess").status_code == 401
    assert _get("/", authorization="Bearer guess").status_code == 401
    assert _get("/", cookie="ctr_station=guess").status_code == 401
    assert _get("/", authorization="Bearer a-token").text == "hello"


def test_the_first_visit_with_the_token_leaves_a_cookie_and_a_clean_address() -> None:
    first = _get("/?token=a-token")
    assert first.status_code == 303
    assert first.headers["location"] == "/"
    assert "HttpOnly" in first.headers["set-cookie"]
    assert "SameSite=Strict" in first.headers["set-cookie"]
    assert _get("/", cookie=first.headers["set-cookie"].split(";")[0]).text == "hello"
