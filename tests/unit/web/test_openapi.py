"""The description of the calls, from which the page makes its forms."""

import fastapi.applications
import pytest
from starlette.testclient import TestClient


def test_it_is_there_before_anybody_asks(app: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """Making it takes the event loop for half a second, and STOP with it."""

    def made_now(**_: object) -> None:
        raise AssertionError("it is made when it is asked for")

    monkeypatch.setattr(fastapi.applications, "get_openapi", made_now)
    assert "/api/stop" in app.get("/api/openapi.json").json()["paths"]


def test_a_station_that_takes_no_targets_offers_no_form_for_them(app: TestClient) -> None:
    """The page offers a run for targets where the description has their bounds."""
    assert "LeadIn" not in app.get("/api/openapi.json").json()["components"]["schemas"]
