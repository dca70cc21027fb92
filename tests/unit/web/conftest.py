"""Fixture with the web application without processes: no test has to wait, and nothing moves."""

from collections.abc import Iterator

import pytest
from starlette.testclient import TestClient

from tests.harness.leftovers import nothing_left_behind
from tests.harness.web_app import web_app


@pytest.fixture(autouse=True, scope="module")
def nothing_is_left_behind() -> Iterator[None]:
    """Check that no thread or process outlives its module; the application's threads run until the module's end."""
    with nothing_left_behind(30.0):
        yield


@pytest.fixture(scope="module")
def app(tmp_path_factory: pytest.TempPathFactory, nothing_is_left_behind: None) -> Iterator[TestClient]:
    """Yield a client of the web application of a station that is OFF."""
    with web_app(tmp_path_factory.mktemp("station")) as client:
        yield client
