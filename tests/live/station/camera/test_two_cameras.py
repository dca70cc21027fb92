"""A live station whose only tracker is two cameras: a run, a lost camera, and a cancelled calibration."""

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from station.service.status import PREPARED_LATE_TEXT
from tests.harness.children import children
from tests.harness.serving import Served, serving
from tests.harness.true_cameras import write_true_views
from tests.harness.waiting import until

BOARD = {"cameras": ["left", "right"], "square": 0.02}
CIRCLE = {"trajectory": {"kind": "circle", "radius": 0.003, "period": 6.0}, "duration": 6.0}


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = write_true_views("two_cameras", tmp_path_factory.mktemp("views"))
    settings = f'lab = "two_cameras"\ncalibration = "{folder}"\n'
    with serving(settings=settings, rate=0.2) as served:  # a busy computer needs 60 ms for a picture instead of 10
        yield served


def camera_pids(station: Served) -> set[int]:
    return {camera.pid for camera in children(station.process.pid, "ctr-camera")}


def test_run_on_cameras_alone_reaches_its_path(station: Served) -> None:
    station.ready()
    devices = station.rest.get("/api/devices").json()["devices"]
    (tracker,) = (device for device in devices if device["name"] == "tracker")
    assert tracker["details"]["cameras"] == {"left": "simulated", "right": "simulated"}

    assert station.post("/api/start", CIRCLE).status_code == 202
    station.wait_for(lambda status: status["phase"] == "moving")
    errors = []
    while (status := station.status())["phase"] == "moving":
        if status["tip_true"] and status["tip_measured"]:
            errors.append(np.subtract(status["tip_measured"], status["tip_true"]))
    status = station.wait_for(lambda status: status["state"] != "RUNNING")

    assert status["state"] == "READY", status["message"]
    late = PREPARED_LATE_TEXT.removeprefix("{}")
    assert not any(warning.endswith(late) for warning in status["warnings"])
    assert np.sqrt((np.array(errors) ** 2).sum(axis=1).mean()) < 1e-3  # the newest frame is 50 to 90 ms old


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_run_ends_in_hold_without_one_camera_and_the_camera_returns(station: Served, number: signal.Signals) -> None:
    station.ready()
    assert station.post("/api/start", {**CIRCLE, "duration": 3600.0}).status_code == 202
    station.wait_for(lambda status: status["phase"] == "moving")

    pid = max(camera_pids(station))
    os.kill(pid, number)
    held = station.wait_for(lambda status: status["state"] == "HOLD" and status["cause"])
    if number == signal.SIGSTOP:
        with suppress(ProcessLookupError):  # it may have been replaced
            os.kill(pid, signal.SIGCONT)

    assert "no frames arrive (camera " in held["message"]
    until(lambda: len(camera_pids(station)) == 2)
    station.ready()


# ---- calibration with a board


def state(station: Served) -> dict[str, Any]:
    return station.rest.get("/api/cameras/calibration").json()["board"]


def test_board_is_an_svg_in_true_size(station: Served) -> None:
    answer = station.rest.get("/api/cameras/board.svg", params={"square": 0.02})

    assert answer.headers["content-type"].startswith("image/svg+xml")
    assert "a square has 20 mm" in answer.text
    assert station.rest.get("/api/cameras/board.svg", params={"square": 1.0}).status_code == 422


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ({"cameras": ["left", "top"]}, "left, top: expected one or two different cameras of: left, right"),
        ({"cameras": ["left", "left"]}, "different cameras"),
    ],
)
def test_unknown_cameras_are_refused(station: Served, body: dict[str, Any], reason: str) -> None:
    answer = station.post("/api/cameras/calibration", body)

    assert answer.status_code == 409
    assert reason in answer.json()["error"]


def test_cancelled_calibration_writes_nothing_and_shows_the_robot_again(station: Served) -> None:
    assert station.post("/api/cameras/calibration/finish").status_code == 409
    assert station.post("/api/cameras/calibration", BOARD).status_code == 202
    assert "being calibrated" in station.post("/api/cameras/calibration", BOARD).json()["error"]
    assert "do not suffice" in station.post("/api/cameras/calibration/finish").json()["error"]

    assert station.post("/api/cameras/calibration/cancel").status_code == 200

    until(lambda: state(station)["stage"] == "ended")
    assert state(station)["result"] == ["cancelled; nothing was written"]
    station.ready()
