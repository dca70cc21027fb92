"""Two operators: one lease with explicit take-over, others read only (409); stop is always accepted from anyone."""

import pytest

from tests.harness.serving import Served

ANNA, BEN = ({"x-ctr-client": f"identity-of-{name}", "x-ctr-name": name} for name in ("Anna", "Ben"))
RUN = {"trajectory": {"kind": "hold"}, "duration": 30.0}


@pytest.fixture(autouse=True)
def nobody_afterwards(station: Served):
    yield
    for who in (ANNA, BEN):
        station.rest.delete("/api/operator", headers=who)


def test_the_second_one_is_told_who_commands_and_may_take_over_on_purpose(station: Served) -> None:
    assert station.rest.post("/api/operator", json={}, headers=ANNA).json()["you"] is True
    for path, body in (
        ("/api/start", RUN),
        ("/api/jog", {"space": "tip", "velocity": [0, 0, 0.001]}),
        ("/api/home", {"way_is_clear": True}),
        ("/api/tare", {}),
        ("/api/operator", {}),
    ):
        refused = station.rest.post(path, json=body, headers=BEN)
        assert refused.status_code == 409, path
        assert "'Anna' is operator; ask them, or take over on purpose" in refused.json()["error"]
    assert station.rest.get("/api/status", headers=BEN).json()["operator"]["name"] == "Anna"
    assert station.status()["state"] == "READY"

    assert station.rest.post("/api/operator", json={"take_over": True}, headers=BEN).json()["you"] is True
    assert station.rest.post("/api/start", json=RUN, headers=ANNA).status_code == 409
    assert station.rest.post("/api/start", json=RUN, headers=BEN).status_code == 202


def test_stop_is_taken_from_anybody(station: Served) -> None:
    station.rest.post("/api/operator", json={"take_over": True}, headers=ANNA)
    assert station.rest.post("/api/start", json=RUN, headers=ANNA).status_code == 202
    answer = station.rest.post("/api/stop", headers=BEN)

    assert answer.status_code == 200
    assert answer.json()["state"] == "STOPPED"
    assert station.rest.post("/api/reset", headers=BEN).status_code == 409  # that one is Anna's
