"""Requests to old REST paths are answered with the new path."""

import pytest
from starlette.testclient import TestClient

from web.api.refusals import METHODS, RENAMED_PATHS


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("old", RENAMED_PATHS)
def test_a_request_to_an_old_path_is_answered_410_with_the_new_path(app: TestClient, method: str, old: str) -> None:
    answer = app.request(method, old, json={})
    assert answer.status_code == 410
    assert answer.json()["error"] == f"{old} was renamed in REST format 2: use {RENAMED_PATHS[old]}"


def test_the_api_description_has_every_new_path_and_no_old_path(app: TestClient) -> None:
    paths = app.get("/api/openapi.json").json()["paths"]
    assert set(RENAMED_PATHS.values()) <= set(paths)
    assert not set(RENAMED_PATHS) & set(paths)
