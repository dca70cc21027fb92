"""Two stations that share one folder of runs."""

from datetime import datetime
from pathlib import Path

from station.config.controllers import ControllerFile
from station.config.motions import HoldMotion, Orders
from station.config.robots import RobotFile
from station.control.process import ring_width
from station.control.ring import Ring
from station.control.task import MotionTask
from station.recording.history import RunHistory
from station.recording.read import read_case
from station.service.runs import Runs, StartRequest
from station.service.station_file import load_station


def test_runs_that_two_stations_start_in_the_same_second_have_different_names(paper: RobotFile, tmp_path: Path) -> None:
    start = StartRequest(
        MotionTask(ControllerFile().controller(paper), Orders(HoldMotion(), paper.robot()), 2.0), "hold"
    )
    bench, rings = load_station(None).bench(), [Ring(ring_width(paper)) for _ in range(2)]
    stations = [Runs(bench, ring, tmp_path, time_of_day=lambda: datetime(2026, 1, 1)) for ring in rings]
    names = []
    try:
        for station in stations:
            station.open()
            run = station.prepare(start)
            station.accepted(run)
            names.append(run.id)
    finally:
        for station, ring in zip(stations, rings, strict=True):
            station.interrupted("")
            station.close()
            ring.close(remove=True)

    assert len(set(names)) == 2
    history = RunHistory(tmp_path)
    assert {run.id for run in history.runs()} == set(names)
    for name in names:
        assert read_case(history.recording(name)).metadata["run"] == name
