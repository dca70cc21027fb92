"""The queue of runs belongs to the operator who has filled or resumed it; nothing runs, because the station is OFF."""

from collections.abc import Callable, Iterator

import httpx
import pytest
from starlette.testclient import TestClient

HOLD = {"trajectory": {"kind": "hold"}, "duration": 20.0}
ANNA = {"x-ctr-client": "anna-0123456789", "x-ctr-name": "Anna"}
BEN = {"x-ctr-client": "ben-0123456789", "x-ctr-name": "Ben"}


@pytest.fixture
def filled(app: TestClient) -> Iterator[TestClient]:
    """Yield an application whose queue Anna has filled."""
    assert app.post("/api/queue", json=HOLD, headers=ANNA).json()["paused"] == ""
    yield app
    app.post("/api/operator", json={"take_over": True}, headers=ANNA)
    app.delete("/api/queue", headers=ANNA)
    app.delete("/api/operator", headers=ANNA)


def release(app: TestClient) -> None:
    app.delete("/api/operator", headers=ANNA)


def release_and_return(app: TestClient) -> None:
    release(app)
    app.post("/api/operator", json={}, headers=ANNA)


def release_to_the_next(app: TestClient) -> None:
    release(app)
    app.post("/api/operator", json={}, headers=BEN)


def take_over(app: TestClient) -> None:
    app.post("/api/operator", json={"take_over": True}, headers=BEN)


def take_over_and_back(app: TestClient) -> None:
    take_over(app)
    app.post("/api/operator", json={"take_over": True}, headers=ANNA)


LEFT = "the operator 'Anna' has left; resume the queue to continue"
REPLACED = "'Ben' is operator instead of 'Anna'; resume the queue to continue"


@pytest.mark.parametrize(
    ("change", "reasons"),
    [
        (release, {LEFT}),
        (release_and_return, {LEFT}),
        # The queue keeps the first reason that it sees, and it may look between the two requests.
        (release_to_the_next, {LEFT, REPLACED}),
        (take_over, {REPLACED}),
        (take_over_and_back, {LEFT, REPLACED}),
    ],
)
def test_every_change_of_the_operator_pauses_the_queue(
    filled: TestClient, change: Callable[[TestClient], None], reasons: set[str]
) -> None:
    change(filled)
    assert filled.get("/api/queue").json()["paused"] in reasons


def test_queue_of_the_earlier_operator_works_again_after_it_is_resumed_and_not_after_a_run_is_added(
    filled: TestClient,
) -> None:
    take_over(filled)
    added: httpx.Response = filled.post("/api/queue", json=HOLD, headers=BEN)
    assert [one["state"] for one in added.json()["entries"]] == ["waiting", "waiting"]
    assert "'Ben' is operator instead of 'Anna'" in added.json()["paused"]
    assert filled.post("/api/queue/resume", json={}, headers=ANNA).status_code == 409
    assert filled.post("/api/queue/resume", json={}, headers=BEN).json()["paused"] == ""


def test_a_stop_and_a_reset_pause_the_queue_at_once(filled: TestClient) -> None:
    filled.post("/api/stop", headers=BEN)
    assert filled.get("/api/queue").json()["paused"].startswith("the station was stopped by 'Ben")
