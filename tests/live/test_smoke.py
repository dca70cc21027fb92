"""A station as a person starts it: a circle, STOP, and the recording read back."""

from pathlib import Path

from station.client import Station
from station.recording.label import Label
from station.recording.read import read_case
from tests.harness.serving import serving

CIRCLE = {"kind": "circle", "radius": 0.005, "period": 8.0}


def test_a_circle_is_started_stopped_and_read_back(tmp_path: Path) -> None:
    # One of its own: beside it others calculate, and one that all share would stay until they are done.
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

    assert read.label is Label.STOPPED
    assert len(read.rows) > 0
