"""Operator's browser closed: a recorded run goes on to its end or to HOLD, as configured."""

import time

from tests.harness.kill_stations import until_moving
from tests.harness.lone_station import LoneStation
from tests.harness.serving import Served
from tests.harness.waiting import until

RUN = {"trajectory": {"kind": "circle", "radius": 0.005, "period": 8.0}, "duration": 60.0}
OPERATOR = {"x-ctr-client": "the-operators-page"}


def test_a_run_is_held_without_its_operator_where_that_is_configured(mortal: LoneStation) -> None:
    until_moving(mortal)
    mortal.ask("gone")
    status = until(lambda: (now := mortal.ask("status"))["state"] != "RUNNING" and now)
    assert status["state"] == "HOLD"
    assert "the operator has gone" in status["cause"]


def test_a_run_goes_on_without_its_operator(station: Served) -> None:
    started = station.rest.post("/api/start", json=RUN, headers=OPERATOR)
    assert started.status_code == 202, started.text
    station.wait_for(lambda status: status["phase"] == "moving")
    # what a page says when it goes; without that the lease lapses
    assert station.rest.delete("/api/operator", headers=OPERATOR).status_code == 200
    # Its end is looked for a few times a second of the computer.
    time.sleep(2.0)
    assert station.status()["state"] == "RUNNING"
