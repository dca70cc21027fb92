"""Calibration of two cameras over REST, with the board that the virtual lab shows; refusals with the reason."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from station.config.robots import load_robot
from station.control.bench_calibration import BenchCalibration
from tests.harness.serving import Served, serving
from tests.harness.true_cameras import workspace_error
from tests.harness.waiting import until

BOARD = {"cameras": ["left", "right"], "square": 0.02}


@pytest.fixture(scope="module")
def running() -> Iterator[Served]:
    with serving(settings='lab = "two_cameras"\n') as served:
        yield served


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


def test_pictures_of_the_shown_board_calibrate_both_cameras(station: Served) -> None:
    assert station.post("/api/cameras/calibration", BOARD).status_code == 202

    def solved() -> bool:
        """Finish as soon as there are enough pictures; if the result is refused, the station takes more of them."""
        seen = state(station)
        if seen["stage"] == "looking" and seen["enough"]:
            assert seen["pairs"] >= 12
            assert all(camera["pictures"] >= 20 for camera in seen["cameras"].values())
            assert station.post("/api/cameras/calibration/finish").status_code == 202
        return seen["stage"] in ("done", "ended")

    until(solved)
    done = state(station)
    assert done["stage"] == "done", done["result"]
    assert any("mm apart" in sentence for sentence in done["result"])
    found = BenchCalibration.load(Path(done["folder"]), load_robot("paper")).views
    assert workspace_error("two_cameras", found) < 2e-4
