"""A recorded run ends in HOLD when its operator's browser is closed, if the station file configures that.

Otherwise the run continues; `tests/live/web/api` tests that.
"""

from tests.harness.lone_station import LoneStation
from tests.harness.waiting import until
from tests.tools.kill_stations import until_moving


def test_run_ends_in_hold_after_the_operator_disconnects_if_so_configured(mortal: LoneStation) -> None:
    until_moving(mortal)
    mortal.ask("gone")
    status = until(lambda: (now := mortal.ask("status"))["state"] != "RUNNING" and now["cause"] and now)
    assert status["state"] == "HOLD"
    assert "the operator has disconnected" in status["cause"]
