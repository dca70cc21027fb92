"""Control process killed or hung: the station process stops the axes within 100 ms plus the line; run interrupted."""

import signal
import time
from pathlib import Path

from station.recording.label import Label
from station.recording.read import read_case
from tests.harness.kill_stations import back, kill, until_moving
from tests.harness.lone_station import LoneStation, lone_station
from tests.harness.watched_lab import WatchedLab

#: 100 ms and twice 6.25 ms on the line, four times over for a machine that does other things besides.
MOST = 0.45


def test_the_station_process_stops_the_stages_and_a_reset_starts_a_new_one(tmp_path: Path) -> None:
    with WatchedLab() as lab, lone_station(tmp_path, lab.endpoints) as station:
        for _ in range(2):
            assert 0.0 < kill(station, lab, "control", 0.3) < MOST
            status = station.ask("status")
            assert status["state"] == "FAULT"
            assert "the control process ended by signal 9; 3 stages on" in status["cause"]
            assert status["cause"].endswith("reset to start it anew")
            back(station)
        _hung(station, lab)
        run = station.ask("status")["run"]
    last = read_case(next(tmp_path.glob(f"{run}*")) / "run.mcap")
    assert last.label is Label.INTERRUPTED
    kept = sorted((tmp_path / "last_seconds").glob("*.csv"))
    assert len(kept) >= 3
    assert kept[0].read_text().startswith("# the control process ended by signal 9")
    assert len(kept[0].read_text().splitlines()) > 400


def _hung(station: LoneStation, lab: WatchedLab) -> None:
    """It lives but does not tick: after a second it is ended."""
    until_moving(station)
    begin = time.monotonic()
    station.child("control").send_signal(signal.SIGSTOP)
    assert 0.9 < lab.told(begin) < 1.0 + MOST
    assert "the control loop has not ticked for 1 s" in station.ask("status")["cause"]
