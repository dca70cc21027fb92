"""The API description, from which the page builds its forms."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import fastapi.applications
import pytest
from fastapi.openapi.utils import get_openapi
from starlette.testclient import TestClient

from tests.harness.waiting import NET
from tests.harness.web_app import web_app


def test_stop_is_answered_while_the_api_description_is_generated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The event loop would be blocked for a quarter of a second, and with it STOP, if it generated the description."""
    started, stopped = threading.Event(), threading.Event()

    def generated_after_stop(**settings: Any) -> dict[str, Any]:
        started.set()
        assert stopped.wait(NET), "STOP was not answered meanwhile"
        return get_openapi(**settings)

    monkeypatch.setattr(fastapi.applications, "get_openapi", generated_after_stop)
    with web_app(tmp_path) as app, ThreadPoolExecutor(1) as pool:
        description = pool.submit(app.get, "/api/openapi.json")
        assert started.wait(NET)
        assert app.post("/api/stop", json={}).status_code == 202
        stopped.set()
        assert "/api/stop" in description.result(NET).json()["paths"]


def test_the_api_description_is_generated_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with web_app(tmp_path) as app:
        first = app.get("/api/openapi.json").json()

        def generated_again(**_: object) -> None:
            raise AssertionError("the description was generated again")

        monkeypatch.setattr(fastapi.applications, "get_openapi", generated_again)
        assert app.get("/api/openapi.json").json() == first


def test_a_station_without_targets_describes_no_target_run(app: TestClient) -> None:
    """The page offers a run for targets if the description has its schema."""
    assert "StreamAgreement" not in app.get("/api/openapi.json").json()["components"]["schemas"]


def operations(app: TestClient) -> Iterator[tuple[str, str, dict[str, Any], dict[str, Any]]]:
    """Yield method, path, description and schema of the JSON body (empty: none) of every request."""
    api = app.get("/api/openapi.json").json()
    for path, methods in api["paths"].items():
        for method, call in methods.items():
            body = call.get("requestBody", {}).get("content", {}).get("application/json", {}).get("schema", {})
            named = next((each["$ref"] for each in (body, *body.get("anyOf", ())) if "$ref" in each), "")
            yield method, path, call, {**api["components"]["schemas"].get(named.rsplit("/", 1)[-1], {}), **body}


def test_every_request_has_a_description_and_the_examples_of_its_body_are_valid(app: TestClient) -> None:
    without, refused = list[str](), list[str]()
    for method, path, call, body in operations(app):
        if not call.get("summary") or not call.get("description"):
            without.append(f"{method} {path}")
        for example in body.get("examples", [None] if body else []):
            answer = app.request(method, path.replace("{name}", "mine").replace("{entry}", "1"), json=example)
            # The station is OFF and has no runs or cameras, so it may refuse the request, but not its body.
            if answer.status_code not in (200, 202, 404, 409):
                refused.append(f"{method} {path} {example}: {answer.text}")
    assert (without, refused) == ([], [])


def test_every_bound_of_a_number_has_a_unit_or_is_a_count(app: TestClient) -> None:
    schemas = app.get("/api/openapi.json").json()["components"]["schemas"]
    bounds = {"minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"}
    bounded = [
        (f"{name}.{key}", field.get("description", ""))
        for name, each in schemas.items()
        for key, field in each.get("properties", {}).items()
        if any(bounds & set(one) for one in (field, *field.get("anyOf", ())))
    ]
    assert len(bounded) > 50
    counts = ("number of ", "factor ", "coefficient ", "how often ", "as a fraction of ")
    assert [name for name, text in bounded if "[" not in text and not any(word in text for word in counts)] == []


@pytest.mark.parametrize(("method", "path"), [("GET", "/api/nothing"), ("POST", "/nothing"), ("POST", "/api/status")])
def test_answer_to_an_unknown_request_names_it_and_the_list_of_requests(
    app: TestClient, method: str, path: str
) -> None:
    answer = app.request(method, path)
    assert answer.status_code in (404, 405)
    assert answer.json()["error"] == f"there is no {method} {path}; /api/docs lists all requests"
