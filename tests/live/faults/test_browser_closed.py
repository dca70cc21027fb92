"""Operator's browser closed: a recorded run is held, where that is configured; else it goes on (`live/web/api`)."""

from tests.harness.kill_stations import until_moving
from tests.harness.lone_station import LoneStation
from tests.harness.waiting import until


def test_a_run_is_held_without_its_operator_where_that_is_configured(mortal: LoneStation) -> None:
    until_moving(mortal)
    mortal.ask("gone")
    status = until(lambda: (now := mortal.ask("status"))["state"] != "RUNNING" and now)
    assert status["state"] == "HOLD"
    assert "the operator has gone" in status["cause"]
