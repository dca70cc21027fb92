"""Calibration over REST, on a live station that uses the results of an earlier calibration."""

import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from station.config.strict import PRESETS
from tests.harness.root import ROOT
from tests.harness.serving import Served, serving

CLEAR = {"way_is_clear": True}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the data folder of a station, with one calibration in it."""
    folder = tmp_path_factory.mktemp("data")
    command = [sys.executable, "-m", "station", "calibrate", "tracker", "--still", "--effort", "0.5"]
    subprocess.run([*command, "--out", folder / "calibrations"], cwd=ROOT, check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def earlier(data: Path) -> str:
    (folder,) = (data / "calibrations").iterdir()
    return folder.name


@pytest.fixture(scope="module")
def running(data: Path, earlier: str) -> Iterator[Served]:
    known = str(data / "calibrations" / earlier)
    with serving("--data", str(data), "--lab", "uncalibrated", "--seed", "0", "--calibration", known) as served:
        yield served


@pytest.fixture
def station(running: Served) -> Served:
    running.ready()
    return running


def course(station: Served) -> dict:
    return station.rest.get("/api/calibration").json()["course"]


def test_calibration_procedures_are_listed_with_their_requirements(station):
    told = station.rest.get("/api/calibration").json()

    assert [offer["name"] for offer in told["offers"]] == ["axes", "latency", "tracker", "force", "tubes", "residual"]
    assert all(offer["seconds"] > 0.0 and offer["sentence"] for offer in told["offers"])
    assert "weights" in next(offer for offer in told["offers"] if offer["name"] == "tubes")["needs"]
    assert told["course"] is None
    assert station.status()["lab"].startswith("uncalibrated")


@pytest.mark.parametrize(
    ("body", "named"),
    [
        ({"what": "tracker"}, "way_is_clear"),
        ({"what": "tracker", "way_is_clear": False}, "way_is_clear"),
        ({"what": "everything"} | CLEAR, "what"),
        ({"what": "tracker", "effort": 100.0} | CLEAR, "effort"),
        ({"what": "force", "weights": [0.2, 50.0]} | CLEAR, "weights"),
        ({"what": "force", "weights": [0.2, 0.2]} | CLEAR, "differ"),
        ({"what": "tracker", "speed": 1.0} | CLEAR, "speed"),
    ],
)
def test_an_invalid_calibration_request_is_refused_with_the_reason_and_nothing_moves(station, body, named):
    answer = station.post("/api/calibration/start", body)

    assert answer.status_code == 422
    assert named in answer.json()["error"]
    assert station.status()["state"] == "READY"


def test_a_calibration_has_exclusive_use_of_the_robot_until_stop_ends_it(station):
    assert station.post("/api/calibration/done").status_code == 409
    assert station.post("/api/calibration/abort").status_code == 409
    answer = station.post("/api/calibration/start", {"what": "tracker", "effort": 0.5} | CLEAR)
    assert answer.status_code == 202, answer.text
    assert answer.json()["course"]["stage"] == "thinking"

    station.wait_for(lambda status: status["state"] == "RUNNING")
    now = course(station)
    assert now["on"]
    assert (now["stage"], now["message"]) == ("moving", "pose 1")
    assert now["left"] > 10.0
    assert station.status()["run"]["title"] == "calibrate tracker, pose 1"
    assert station.rest.get("/api/runs").json() == []  # motions of a calibration are not listed as runs
    for path, body in (
        ("start", {"experiment": "fig7"}),
        ("calibration/start", {"what": "axes"} | CLEAR),
        ("tare", {}),
        ("home", CLEAR),
        ("jog", {"space": "joints", "velocity": [0.0, 0.0, 0.0]}),
    ):
        refused = station.post(f"/api/{path}", body)
        assert refused.status_code == 409
        assert "'calibrate tracker' has reserved the robot" in refused.json()["error"]

    assert station.post("/api/stop").status_code == 200
    station.wait_for(lambda _: not course(station)["on"])
    assert course(station)["stage"] == "aborted"
    assert "stopped by 'script at 127.0.0.1'" in course(station)["message"]
    assert len(station.rest.get("/api/calibration/results").json()) == 1


def test_stop_ends_a_computing_calibration_even_before_an_immediate_reset(station):
    station.post("/api/calibration/start", {"what": "tracker", "effort": 0.5} | CLEAR)
    station.post("/api/stop")
    assert station.post("/api/calibration/start", {"what": "axes"} | CLEAR).status_code == 409
    station.post("/api/reset")

    station.wait_for(lambda _: not course(station)["on"])
    assert course(station)["stage"] == "aborted"
    assert "stopped" in course(station)["message"].lower()


def test_an_experiment_uses_the_calibration_that_the_station_was_started_with(station, data, earlier):
    def away() -> np.ndarray:
        """Return the mean difference between the measured and the true tip (3,) [m]."""
        seen = []
        while len(seen) < 20:
            status = station.status()
            seen.append(np.subtract(status["tip_measured"], status["tip_true"]))
            time.sleep(0.03)
        return np.mean(seen, axis=0)

    table = tomllib.loads((data / "calibrations" / earlier / "registration.toml").read_text(encoding="utf-8"))
    before = away()
    assert station.post("/api/start", {"experiment": "fig7"}).status_code == 202
    station.wait_for(lambda status: status["phase"] in ("settling", "moving"))

    # The coil's offset is several millimetres, so ignoring it would be noticed.
    assert np.linalg.norm(table["coil"]) > 3e-3
    assert np.linalg.norm(away() - before) < 1e-3
    station.post("/api/stop")


def test_an_aborted_calibration_stops_the_robot(station):
    station.post("/api/calibration/start", {"what": "axes"} | CLEAR)
    station.wait_for(lambda status: status["state"] == "RUNNING")

    assert station.post("/api/calibration/abort").status_code == 200

    station.wait_for(lambda status: status["state"] == "STOPPED" and not course(station)["on"])
    assert course(station)["message"] == "aborted by the operator"


def test_stored_calibrations_are_listed_described_and_downloaded(station, earlier, data):
    (listed,) = station.rest.get("/api/calibration/results").json()
    assert (listed["name"], listed["procedure"], listed["simulated"]) == (earlier, "tracker", True)
    assert "mm RMS between coil and model" in listed["findings"][0]

    kept = station.rest.get(f"/api/calibration/results/{earlier}").json()
    assert kept["use"]["line"] == f'calibration = "{data / "calibrations" / earlier}"'
    assert {row["name"] for row in kept["found"]} >= {"frame rotation x", "frame position z", "coil y"}
    for name in kept["files"]:
        answer = station.rest.get(f"/api/calibration/results/{earlier}/{name}")
        assert answer.status_code == 200
        assert answer.content == (data / "calibrations" / earlier / name).read_bytes()
    report = station.rest.get(f"/api/calibration/results/{earlier}/report.html")
    assert report.headers["content-type"].startswith("text/html")
    assert "default-src 'none'" in report.headers["content-security-policy"]


@pytest.mark.parametrize(
    "path", ["nope", "nope/report.html", "%2e%2e", "{earlier}/nope.toml", "{earlier}/..%2faudit.jsonl"]
)
def test_missing_calibrations_and_files_are_not_found(station, earlier, path):
    answer = station.rest.get(f"/api/calibration/results/{path.format(earlier=earlier)}")

    assert answer.status_code == 404


def test_an_exchange_of_tubes_has_a_checklist(station):
    def todo(body: dict) -> list[str]:
        answer = station.post("/api/calibration/exchange", body)
        assert answer.status_code == 200, answer.text
        return [line["procedure"] for line in answer.json() if line["procedure"]]

    same = (PRESETS / "robots" / "paper.toml").read_text(encoding="utf-8")
    assert todo({"robot": "paper"}) == ["tracker"]
    assert "tubes" in todo({"robot": "three_tubes"})
    assert todo({"file": same}) == ["tracker"]
    assert todo({"file": same.replace("0.0413", "0.0500")}) == ["tubes"]


@pytest.mark.parametrize(
    ("body", "named"),
    [
        ({}, "robot"),
        ({"robot": "paper", "file": "x"}, "either"),
        ({"robot": "/etc/passwd.toml"}, "not one of the robots"),
        ({"file": "name = 'x'"}, "missing"),
        ({"file": "]["}, "TOML"),
    ],
)
def test_a_tube_exchange_with_an_invalid_robot_is_refused(station, body, named):
    answer = station.post("/api/calibration/exchange", body)

    assert answer.status_code == 422
    assert named in answer.json()["error"]
