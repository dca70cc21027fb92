"""Access checks, without a station behind them."""

import asyncio
import json
import socket

import httpx
import pytest
from starlette.types import Message, Receive, Scope, Send

from web.access.gate import Access, is_loopback
from web.access.identity import Tokens

TOKENS = Tokens("the-operators-token", "the-viewers-token")
OWN = "127.0.0.1:8000"


async def _echo(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with the sender that the access checks have determined; this is the application behind the checks."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        await send({"type": "websocket.close"})
        return
    body = str(scope["state"]["who"].role).encode()
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": body})


def _asked(app: Access, path: str, method: str, host: str, headers: dict[str, str], content: bytes) -> httpx.Response:
    async def ask() -> httpx.Response:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url=f"http://{host}") as client:
            return await client.request(method, path, headers=headers, content=content)

    return asyncio.run(ask())


# ---- on loopback, where every client may be operator


def _here(path: str, method: str = "GET", content: bytes = b"", host: str = OWN, **headers: str) -> int:
    """Return the status code with which the access checks answer a request on loopback."""
    return _asked(
        Access(_echo, "127.0.0.1", 8000, None), path, method, OWN, {"host": host, **headers}, content
    ).status_code


def test_the_stations_page_and_scripts_are_accepted() -> None:
    assert _here("/api/status", origin=f"http://{OWN}") == 200
    assert _here("/api/stop", "POST") == 200
    assert _here("/api/stop", "POST", b"{}", **{"content-type": "application/json"}) == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1", "127.0.0.1:1", "localhost:80", "", "127.0.0.1.evil.example:8000"]
)
def test_a_foreign_host_is_refused(host: str) -> None:
    assert _here("/", host=host) == 403
    assert _here("/api/status", "POST", host=host) == 403


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "", "http://127.0.0.1", "http://127.0.0.1:8000.evil.example"]
)
def test_a_page_of_another_origin_can_neither_read_nor_command(origin: str) -> None:
    assert _here("/api/status", origin=origin) == 403
    assert _here("/api/stop", "POST", origin=origin) == 403


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data"])
def test_a_request_with_a_form_body_is_refused(kind: str) -> None:
    assert _here("/api/start", "POST", b"{}", **{"content-type": kind}) == 415


def test_a_cross_site_request_without_origin_is_refused() -> None:
    for site, mode in (("cross-site", "no-cors"), ("same-site", "cors")):
        assert _here("/api/stop", "POST", **{"sec-fetch-site": site, "sec-fetch-mode": mode}) == 403


@pytest.mark.parametrize("path", ["/viser/", "/viser", "/api/telemetry"])
@pytest.mark.parametrize("headers", [{"origin": "http://evil.example"}, {"host": "evil.example"}])
def test_foreign_websockets_are_refused_with_the_reason(path: str, headers: dict[str, str]) -> None:
    own = _socket(path, {"host": OWN})
    assert [message["type"] for message in own] == ["websocket.accept", "websocket.close"]  # the page's own WebSocket
    start, body = _socket(path, {"host": OWN, **headers})
    assert (start["type"], start["status"]) == ("websocket.http.response.start", 403)
    assert body["type"] == "websocket.http.response.body"
    assert "evil.example" in json.loads(body["body"])["error"]


def _socket(path: str, headers: dict[str, str]) -> list[Message]:
    """Return the messages that a WebSocket receives."""
    sent: list[Message] = []
    scope = {
        "type": "websocket", "path": path, "query_string": b"", "client": ("127.0.0.1", 50000),
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
    }  # fmt: skip

    async def receive() -> Message:
        return {"type": "websocket.connect"}

    async def send(message: Message) -> None:
        sent.append(message)

    asyncio.run(Access(_echo, "127.0.0.1", 8000, None)(scope, receive, send))
    return sent


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
def test_only_loopback_addresses_count_as_loopback(host: str, local: bool) -> None:
    assert is_loopback(host) is local


# ---- beyond loopback


def _ask(path: str, method: str = "GET", host: str = "10.1.2.3:8000", **headers: str) -> httpx.Response:
    return _asked(Access(_echo, "0.0.0.0", 8000, TOKENS), path, method, host, headers, b"")


@pytest.mark.parametrize(
    "headers", [{}, {"authorization": "Bearer guess"}, {"cookie": "ctr_station_8000=guess"}, {"cookie": "=;=,\x7f"}]
)
def test_a_token_is_required_beyond_loopback(headers: dict[str, str]) -> None:
    assert _ask("/", **headers).status_code == 401
    assert _ask("/?token=guess", **headers).status_code == 401


@pytest.mark.parametrize(("token", "role"), [(TOKENS.operator, "operator"), (TOKENS.viewer, "viewer")])
def test_the_first_visit_with_a_token_sets_a_cookie_and_removes_the_token_from_the_address(
    token: str, role: str
) -> None:
    first = _ask(f"/?token={token}")
    assert first.status_code == 303
    assert first.headers["location"] == "/"
    assert "HttpOnly" in first.headers["set-cookie"]
    assert "SameSite=Strict" in first.headers["set-cookie"]
    assert _ask("/", cookie=first.headers["set-cookie"].split(";")[0]).text == role
    assert _ask("/", authorization=f"Bearer {token}").text == role


def test_the_redirect_that_removes_the_token_stays_on_this_host() -> None:
    assert _ask(f"/%2Fevil.example/?token={TOKENS.viewer}").headers["location"] == "/evil.example/"
    assert _ask(f"/%09/evil.example/?token={TOKENS.viewer}").headers["location"] == "/%09/evil.example/"


@pytest.mark.parametrize("path", ["/%e2%82%ac", "/%0a", "/%0d%0aset-cookie:%20a=b", "/%00", "/a%20b", "/api/runs/%ff"])
def test_the_redirect_that_removes_the_token_works_for_any_path(path: str) -> None:
    answer = _ask(f"{path}?token={TOKENS.viewer}")
    assert answer.status_code == 303
    assert all(0x20 < ord(letter) < 0x7F for letter in answer.headers["location"])
    assert answer.headers.get_list("set-cookie") == [
        f"ctr_station_8000={TOKENS.viewer}; Path=/; HttpOnly; SameSite=Strict"
    ]


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE"])
def test_viewers_may_only_read_and_press_stop(method: str) -> None:
    viewer = {"authorization": f"Bearer {TOKENS.viewer}", "content-type": "application/json"}
    assert _ask("/api/status", **viewer).text == "viewer"
    assert _ask("/api/stop", "POST", **viewer).text == "viewer"
    for path in ("/api/start", "/api/jog", "/api/operator", "/api/runs/x", "/anything"):
        refused = _ask(path, method, **viewer)
        assert refused.status_code == 403
        assert "viewers" in refused.json()["error"]


@pytest.mark.parametrize("host", ["evil.example:8000", "10.1.2.3", "10.1.2.3:9000", "10.1.2.3.evil.example:8000"])
def test_foreign_host_names_are_refused_even_with_a_token(host: str) -> None:
    assert _ask("/", host=host, authorization=f"Bearer {TOKENS.operator}").status_code == 403


@pytest.mark.parametrize("host", ["10.1.2.3:8000", "127.0.0.1:8000", "[::1]:8000", f"{socket.gethostname()}:8000"])
def test_the_computers_names_and_addresses_are_accepted(host: str) -> None:
    assert _ask("/", host=host, authorization=f"Bearer {TOKENS.operator}").status_code == 200


def test_no_other_site_can_show_the_page_in_a_frame() -> None:
    operator = {"authorization": f"Bearer {TOKENS.operator}"}
    assert "frame-ancestors 'self'" in _ask("/", **operator).headers["content-security-policy"]
    followed = {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}
    assert _ask("/", **operator, **followed, **{"sec-fetch-dest": "document"}).status_code == 200
    assert _ask("/", **operator, **followed, **{"sec-fetch-dest": "iframe"}).status_code == 403
