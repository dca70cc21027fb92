"""Operator's browser closed: a recorded run goes on to its end or to HOLD, as configured."""

import time

from tests.harness.serving import Served, serving

RUN = {"trajectory": {"kind": "circle", "radius": 0.005, "period": 8.0}, "duration": 60.0}
OPERATOR = {"x-ctr-client": "the-operators-page"}


def start_and_leave(station: Served) -> None:
    """An operator starts a run and closes the page in the middle of it."""
    started = station.rest.post("/api/start", json=RUN, headers=OPERATOR)
    assert started.status_code == 202, started.text
    station.wait_for(lambda status: status["phase"] == "moving")
    # what a page says when it goes; without that the lease lapses
    assert station.rest.delete("/api/operator", headers=OPERATOR).status_code == 200


def test_a_run_is_held_without_its_operator_where_that_is_configured() -> None:
    # Before the station that the others share: two on one computer take each other's time.
    with serving(settings='alone = "hold"\n') as station:
        start_and_leave(station)
        status = station.wait_for(lambda status: status["state"] != "RUNNING")
        assert status["state"] == "HOLD"
        assert "the operator has gone" in status["cause"]


def test_a_run_goes_on_without_its_operator(station: Served) -> None:
    start_and_leave(station)
    # Its end is looked for a few times a second of the computer.
    time.sleep(2.0)
    assert station.status()["state"] == "RUNNING"
