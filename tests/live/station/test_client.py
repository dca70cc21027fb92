"""The Python client `station.client`, used with a running station."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest

from station.client import NotOperator, RunFailed, Station, StationError, StationRefused
from tests.harness.serving import Served, free_port

CIRCLE = {"kind": "circle", "radius": 0.004, "period": 4.0}


@pytest.fixture
def station(running: Served) -> Iterator[Station]:
    running.ready()
    with Station(running.url, name="Zoë's script") as station:
        yield station


def test_client_runs_waits_for_and_downloads_a_circle(station: Station, tmp_path: Path) -> None:
    run = station.start(trajectory=CIRCLE, load={"kind": "constant", "magnitude": 0.1}, duration=2.0)
    assert station.status()["operator"]["name"] == "Zoë's script"
    assert station.wait(run)["state"] == "READY"
    file = station.download(run, tmp_path / "circle.mcap")
    assert file.read_bytes().startswith(b"\x89MCAP0\r\n")
    assert station.runs()[0]["id"] == run


def test_client_wait_for_a_stopped_run_raises_with_the_cause(station: Station) -> None:
    run = station.start("fig7")
    assert station.stop() == ""
    with pytest.raises(RunFailed, match="STOPPED"):
        station.wait(run)
    station.reset()
    assert station.status()["state"] == "READY"


def test_client_error_has_the_stations_reason_for_a_refusal(station: Station, running: Served, tmp_path: Path) -> None:
    with pytest.raises(StationRefused, match="'nope' is not one of the experiments"):
        station.start("nope")
    with pytest.raises(StationRefused, match="outside"):
        station.jog("tip", (1.0, 0.0, 0.0))
    with pytest.raises(StationRefused, match="nope"):
        station.download("nope", tmp_path / "x.mcap")
    with pytest.raises(StationError, match="cannot be written"):
        station.download(station.runs()[0]["id"], tmp_path / "no" / "folder")
    station.become_operator()  # the refused requests have not made the client the operator
    with Station(running.url, name="another") as another, pytest.raises(NotOperator) as refusal:
        another.tare()
    assert str(refusal.value).startswith(
        "'Zoë's script' is operator, so this script may not send commands: press Release"
    )
    assert "become_operator(take_over=True)" in str(refusal.value)


def test_client_goto_moves_named_joints_and_without_joints_to_the_working_pose(station: Station) -> None:
    station.goto({"inner_rotation": 1.5})
    joints = station.status()["joints"]
    assert joints["inner_rotation"] == pytest.approx(1.5, abs=0.002)
    assert joints["inner_translation"] == pytest.approx(
        -0.1, abs=0.02
    )  # the request did not name this joint, so the joint keeps its position
    with pytest.raises(StationRefused, match=r"inner_translation 0.2 m is outside -0.13 ... -0.005 m"):
        station.goto({"inner_translation": 0.2})
    with pytest.raises(StationRefused, match=r"joints.elbow: robot 'paper' has no such joint; it has outer_rotation"):
        station.goto({"elbow": 0.2})
    station.goto()
    assert station.status()["joints"]["inner_rotation"] == pytest.approx(1.5708, abs=0.002)


def test_client_error_has_the_bound_for_a_telemetry_rate_outside_its_range(station: Station) -> None:
    with pytest.raises(StationRefused, match=r"rate = '200'.*100"):
        next(station.telemetry(200.0))


def test_client_receives_telemetry_at_the_requested_rate(station: Station) -> None:
    samples = [sample for _, sample in zip(range(5), station.telemetry(10.0), strict=False)]
    assert all(later["time"] - earlier["time"] > 0.02 for earlier, later in itertools.pairwise(samples))
    assert len(samples[0]["joints"]) == 3


def test_operators_lease_is_released_when_the_client_closes(station: Station, running: Served) -> None:
    with Station(running.url) as other:
        other.become_operator(take_over=True)
        assert station.status()["operator"]["name"] == "script"
    assert station.status()["operator"]["name"] is None


def test_client_error_names_a_station_that_does_not_answer() -> None:
    with Station(f"http://127.0.0.1:{free_port()}") as nobody, pytest.raises(StationError, match="does not answer"):
        nobody.status()
