"""The API description, from which the page builds its forms."""

import threading
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
