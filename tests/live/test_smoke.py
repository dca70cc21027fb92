"""Smoke test of a station as a user starts it: a circle, STOP, and the recording."""

from pathlib import Path

from station.client import Station
from station.recording.read import read_case
from station.recording.run_outcome import RunOutcome
from tests.harness.serving import Served

CIRCLE = {"kind": "circle", "radius": 0.005, "period": 8.0}


def test_station_starts_and_stops_a_circle_whose_recording_is_readable(running: Served, tmp_path: Path) -> None:
    running.ready()
    with Station(running.url) as station:
        run = station.start(trajectory=CIRCLE, duration=3600.0)
        moving = running.wait_for(lambda status: status["phase"] == "moving")
        assert moving["state"] == "RUNNING"
        station.stop()
        assert station.status()["state"] == "STOPPED"
        station.reset()
        running.wait_for(lambda status: not status["run"]["recording"])
        read = read_case(station.download(run, tmp_path / "circle.mcap"))

    assert read.label is RunOutcome.STOPPED
    assert len(read.rows) > 0
