"""The API description, from which the page builds its forms."""

import fastapi.applications
import pytest
from starlette.testclient import TestClient


def test_the_api_description_exists_before_the_first_request(app: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """Generating the description at a request would block the event loop, and with it STOP, for half a second."""

    def made_now(**_: object) -> None:
        raise AssertionError("the description was generated at a request")

    monkeypatch.setattr(fastapi.applications, "get_openapi", made_now)
    assert "/api/stop" in app.get("/api/openapi.json").json()["paths"]


def test_a_station_without_targets_describes_no_target_run(app: TestClient) -> None:
    """The page offers a run for targets if the description has its schema."""
    assert "StreamAgreement" not in app.get("/api/openapi.json").json()["components"]["schemas"]
