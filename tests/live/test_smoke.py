"""Smoke test of a station as a user starts it: a circle, STOP, and the recording."""

from pathlib import Path

from station.client import Station
from station.recording.read import read_case
from station.recording.run_outcome import RunOutcome
from tests.harness.serving import serving

CIRCLE = {"kind": "circle", "radius": 0.005, "period": 8.0}


def test_new_station_starts_and_stops_a_circle_whose_recording_is_readable(tmp_path: Path) -> None:
    # Uses its own station, because a shared one would run until all tests that share it have ended.
    with serving() as served, Station(served.url) as station:
        served.ready()
        run = station.start(trajectory=CIRCLE, duration=3600.0)
        moving = served.wait_for(lambda status: status["phase"] == "moving")
        assert moving["state"] == "RUNNING"
        station.stop()
        assert station.status()["state"] == "STOPPED"
        station.reset()
        served.wait_for(lambda status: not status["run"]["recording"])
        read = read_case(station.download(run, tmp_path / "circle.mcap"))

    assert read.label is RunOutcome.STOPPED
    assert len(read.rows) > 0
