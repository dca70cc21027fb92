"""Station process killed: the control process stops the axes within 100 ms plus the line; recording recovered."""

import time
from pathlib import Path

import psutil

from station.recording.label import Label
from station.recording.read import read_case
from tests.harness.kill_stations import kill
from tests.harness.lone_station import lone_station
from tests.harness.watched_lab import WatchedLab

#: 100 ms and twice 6.25 ms on the line, and as much again for a machine that does other things besides.
MOST = 0.225


def test_the_control_process_stops_the_stages_and_the_next_start_has_the_recording(tmp_path: Path) -> None:
    with WatchedLab() as lab:
        for number in range(2):
            with lone_station(tmp_path, lab.endpoints) as station:
                recovered = station.ask("status")["recovered"]
                assert len(recovered) <= number
                control = station.child("control")
                assert 0.0 < kill(station, lab, "station", 0.4) < MOST
                psutil.wait_procs([control], timeout=5.0)
                assert not control.is_running()
        deadline = time.monotonic() + 5.0
        while list(tmp_path.glob("*.partial")) and time.monotonic() < deadline:
            time.sleep(0.05)  # the recorder is finishing
    runs = [folder for folder in tmp_path.iterdir() if (folder / "run.mcap").exists()]
    assert len(runs) == 2
    for run in runs:
        assert read_case(run / "run.mcap").label is Label.INTERRUPTED
