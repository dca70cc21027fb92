"""A live station calibrates two cameras with a board that moves for minutes: its clock has the usual speed."""

from pathlib import Path

from station.config.robots import load_robot
from station.control.bench_calibration import BenchCalibration
from tests.harness.serving import serving
from tests.harness.true_cameras import workspace_error, write_true_views
from tests.harness.waiting import until
from tests.live.station.camera.test_two_cameras import BOARD, state


def test_pictures_of_the_shown_board_calibrate_both_cameras(tmp_path: Path) -> None:
    settings = f'lab = "two_cameras"\ncalibration = "{write_true_views("two_cameras", tmp_path)}"\n'
    with serving(settings=settings) as station:
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
