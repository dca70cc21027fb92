"""Every route of the application, HTTP and WebSocket: foreign pages, clients without a token, and second operators.

The routes are those of the application itself, so a new route is tested without a change of this file.
"""

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest
from fastapi import APIRouter, FastAPI
from fastapi_offline import FastAPIOffline
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.testclient import TestClient, WebSocketDenialResponse

from tests.harness.web_app import HOST, web_app
from web.access.gate import CHANGING_METHODS, VIEWER_PATHS
from web.access.identity import Tokens

WEBSOCKET = "websocket"
TOKENS = Tokens("the-operators-token", "the-viewers-token")
#: An address of this computer that is not loopback, which every client reaches with a token only.
LAB = "10.1.2.3"
#: Requests of a page of another site; `access/test_gate.py` has every way in which such a request is recognised.
FOREIGN = [
    {"host": "evil.example:8000"},
    {"origin": "http://evil.example"},
    {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors"},
]
#: Changing requests that need no operator: STOP, the lease itself, notes of a run, and requests that only query.
WITHOUT_LEASE = {
    "/api/stop", "/api/stop/check", "/api/operator", "/api/model/solve", "/api/calibration/exchange",
    "/api/waypoints/check", "/api/runs/x/notes",
}  # fmt: skip


class Served(NamedTuple):
    """The application and its routes."""

    client: TestClient
    routes: list[tuple[str, str]]  #: method, or `WEBSOCKET`, and path with `x` for each parameter


def routes_of(made: list[FastAPI | APIRouter]) -> list[tuple[str, str]]:
    found: set[tuple[str, str]] = {("GET", "/no/such/route"), ("POST", "/api/no_such_route")}
    for route in (route for part in made for route in part.routes):
        match route:
            case Route():
                found |= {(method, without_names(route.path)) for method in route.methods or ()}
            case WebSocketRoute():
                found.add((WEBSOCKET, without_names(route.path)))
            case Mount():
                found.add(("GET", without_names(route.path) + "/x"))
            case _:
                # New versions of FastAPI list an included router among the routes; its own routes are in `made`.
                assert type(route).__name__ == "_IncludedRouter", f"an unknown kind of route: {route}"
    return sorted(found)


def without_names(path: str) -> str:
    """Return a path of a route with `x` for each parameter."""
    return re.sub(r"{[^}]*}", "x", path)


@pytest.fixture(scope="module", params=[HOST, LAB])
def served(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """The application on loopback, and beyond loopback with tokens."""
    made: list[FastAPI | APIRouter] = []

    def noted(**options: Any) -> FastAPI:
        app = FastAPIOffline(**options)
        include = app.include_router

        def noted_router(router: APIRouter, **more: Any) -> None:
            made.append(router)
            include(router, **more)

        app.include_router = noted_router
        made.append(app)
        return app

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("web.app.FastAPIOffline", noted)
        tokens = None if request.param == HOST else TOKENS
        with web_app(tmp_path_factory.mktemp("station"), "0.0.0.0" if tokens else HOST, tokens) as client:
            client.base_url = client.base_url.copy_with(host=request.param)
            yield Served(client, routes_of(made))


def answer(served: Served, method: str, path: str, headers: dict[str, str]) -> tuple[int, str]:
    """Return status and text with which a request, or the handshake of a WebSocket, is answered."""
    if method != WEBSOCKET:
        got = served.client.request(
            method, path, headers=headers, content=b"{}" if method in CHANGING_METHODS else None,
            follow_redirects=False,
        )  # fmt: skip
        return got.status_code, got.text
    own = {"host": served.client.base_url.netloc.decode()}
    try:
        with served.client.websocket_connect(path, headers=own | headers):
            return 101, ""
    except WebSocketDenialResponse as refused:
        return refused.status_code, refused.text


def bearer(served: Served, token: str = TOKENS.operator) -> dict[str, str]:
    beyond = served.client.base_url.host != HOST
    return {"content-type": "application/json"} | ({"authorization": f"Bearer {token}"} if beyond else {})


def test_the_application_has_the_routes_that_these_tests_are_for(served: Served) -> None:
    listed = {path for _, path in served.routes}
    assert {"/", "/static/x", "/api/docs", "/api/queue/x/move", "/api/stiffness", "/viser/x"} <= listed
    assert {(WEBSOCKET, path) for path in ("/api/telemetry", "/api/setpoints", "/api/scene/tip", "/viser")} <= set(
        served.routes
    )


@pytest.mark.parametrize("headers", FOREIGN, ids=str)
def test_no_route_answers_a_page_of_another_site(served: Served, headers: dict[str, str]) -> None:
    for method, path in served.routes:
        status, text = answer(served, method, path, bearer(served) | headers)
        assert status == 403, (method, path)
        assert "error" in text or method == "HEAD", (method, path)


def test_no_changing_route_accepts_the_body_of_a_form(served: Served) -> None:
    for method, path in served.routes:
        if method in CHANGING_METHODS:
            assert answer(served, method, path, bearer(served) | {"content-type": "text/plain"})[0] == 415, (
                method,
                path,
            )


def test_no_route_answers_a_client_without_a_token_beyond_loopback(served: Served) -> None:
    if served.client.base_url.host == HOST:
        return
    for headers in ({}, {"authorization": "Bearer guess"}, {"cookie": f"ctr_station={TOKENS.operator}"}):
        for method, path in served.routes:
            kind = {"content-type": "application/json"}
            assert answer(served, method, path, kind | headers)[0] == 401, (method, path, headers)


def test_no_changing_route_beyond_loopback_accepts_a_viewer_except_stop_and_queries(served: Served) -> None:
    if served.client.base_url.host == HOST:
        return
    for method, path in served.routes:
        if method in CHANGING_METHODS:
            status, text = answer(served, method, path, bearer(served, TOKENS.viewer))
            assert (status == 403 and "viewers" in text) != (path in VIEWER_PATHS), (method, path, status)


def test_no_changing_route_accepts_a_second_operator_except_stop_and_queries(served: Served) -> None:
    first = bearer(served) | {"x-ctr-client": "anna-0123456789", "x-ctr-name": "Anna"}
    second = bearer(served) | {"x-ctr-client": "ben-0123456789"}
    for method, path in served.routes:
        if method not in CHANGING_METHODS or path in WITHOUT_LEASE:
            continue
        assert served.client.post("/api/operator", json={}, headers=first).status_code == 200
        status, text = answer(served, method, path, second)
        # 404 and 410: no route has this path (any more).
        assert (status == 409 and "'Anna' is operator" in text) or status in (404, 410), (method, path, text)
    served.client.delete("/api/operator", headers=first)
