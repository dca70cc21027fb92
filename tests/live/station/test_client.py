"""The client against a station that really runs."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest

from station.client import Refused, RunFailed, Station, StationError
from tests.harness.serving import Served, free_port

CIRCLE = {"kind": "circle", "radius": 0.004, "period": 4.0}


@pytest.fixture
def station(running: Served) -> Iterator[Station]:
    running.ready()
    with Station(running.url, name="Zoë's script") as station:
        yield station


def test_a_circle_is_run_waited_for_and_downloaded(station: Station, tmp_path: Path) -> None:
    run = station.start(trajectory=CIRCLE, load={"kind": "constant", "magnitude": 0.1}, duration=2.0)
    assert station.status()["operator"]["name"] == "Zoë's script"
    assert station.wait(run)["state"] == "READY"
    file = station.download(run, tmp_path / "circle.mcap")
    assert file.read_bytes().startswith(b"\x89MCAP0\r\n")
    assert station.runs()[0]["id"] == run


def test_a_stopped_run_has_failed_and_says_why(station: Station) -> None:
    run = station.start("fig7")
    assert station.stop() == ""
    with pytest.raises(RunFailed, match="STOPPED"):
        station.wait(run)
    station.reset()
    assert station.status()["state"] == "READY"


def test_refusals_carry_the_stations_reason(station: Station, running: Served, tmp_path: Path) -> None:
    with pytest.raises(Refused, match="'nope' is not one of the experiments"):
        station.start("nope")
    with pytest.raises(Refused, match="outside"):
        station.jog("tip", (1.0, 0.0, 0.0))
    with pytest.raises(Refused, match="nope"):
        station.download("nope", tmp_path / "x.mcap")
    with pytest.raises(StationError, match="cannot be written"):
        station.download(station.runs()[0]["id"], tmp_path / "no" / "folder")
    station.become_operator()  # what made no sense has made nobody so
    with Station(running.url, name="another") as another, pytest.raises(Refused, match="Zoë's script"):
        another.tare()


def test_joints_are_gone_to_by_name_and_the_working_pose_without_one(station: Station) -> None:
    station.goto({"inner_rotation": 1.5})
    joints = station.status()["joints"]
    assert joints["inner_rotation"] == pytest.approx(1.5, abs=0.002)
    assert joints["inner_translation"] == pytest.approx(-0.1, abs=0.02)  # not named: it stayed
    with pytest.raises(Refused, match=r"inner_translation 0.2 m is outside -0.13 ... -0.005 m"):
        station.goto({"inner_translation": 0.2})
    with pytest.raises(Refused, match=r"joints.elbow: robot 'paper' has no such joint; it has outer_rotation"):
        station.goto({"elbow": 0.2})
    station.goto()
    assert station.status()["joints"]["inner_rotation"] == pytest.approx(1.5708, abs=0.002)


def test_telemetry_comes_at_the_rate_that_was_asked_for(station: Station) -> None:
    samples = [sample for _, sample in zip(range(5), station.telemetry(10.0), strict=False)]
    assert all(later["time"] - earlier["time"] > 0.02 for earlier, later in itertools.pairwise(samples))
    assert len(samples[0]["joints"]) == 3


def test_the_lease_is_given_back(station: Station, running: Served) -> None:
    with Station(running.url) as other:
        other.become_operator(take_over=True)
        assert station.status()["operator"]["name"] == "script"
    assert station.status()["operator"]["name"] is None


def test_a_station_that_is_not_there_is_said_so() -> None:
    with Station(f"http://127.0.0.1:{free_port()}") as nobody, pytest.raises(StationError, match="does not answer"):
        nobody.status()
