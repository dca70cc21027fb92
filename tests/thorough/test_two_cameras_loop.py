"""Two cameras as the only tracker, with rendered pictures: their calibration, and the tip under a load."""

from pathlib import Path

import numpy as np
import pytest

from station.cli.main import main
from station.control.bench_calibration import BenchCalibration
from station.devices.cameras import CalibratedView
from station.experiments.experiment import load_experiment
from station.lab.config import load_lab
from station.lab.virtual_bench import virtual_bench
from tests.harness.cases import a_run
from tests.harness.true_cameras import workspace_error, write_true_views
from tests.virtual.station.devices.test_two_cameras import ROBOT, START, measured

LAB = "two_cameras"


@pytest.mark.parametrize(
    "motion", ['kind = "circle"\nradius = 0.005\nperiod = 6.0\n', 'kind = "hold"\n'], ids=["circle", "hold"]
)
def test_tip_stays_within_1_5_mm_under_a_load_with_cameras_alone(motion: str, tmp_path: Path) -> None:
    folder = write_true_views(LAB, tmp_path / "views")
    file = tmp_path / "own.toml"
    file.write_text(
        f'title = "on cameras"\nlab = "{LAB}"\nduration = 6.0\nsettling = 2.0\ncalibration = "{folder}"\n'
        "start = { outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.1 }\n"
        f"[trajectory]\n{motion}"
        '[controller]\ninner = "type_2"\nfeedback = "observer"\nfeedforward = true\nload = "wrenches"\n'
        '[cases.loaded.load]\nkind = "ramps"\ntimes = [1.0, 3.0]\nmagnitudes = [0.0, 0.5]\n',
        encoding="utf-8",
    )
    recording = a_run(load_experiment(str(file)).cases[0])

    assert recording.completed, recording.cause
    of = recording.channels.of
    error = of(recording.rows, "tip_true") - of(recording.rows, "tip_desired")
    assert np.sqrt((error**2).sum(axis=1).mean()) < 1e-3
    assert np.linalg.norm(error, axis=1).max() < 2.5e-3


def test_simulated_pictures_of_the_board_calibrate_the_cameras(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "cameras.toml"
    assert main(["cameras", "calibrate", "--lab", LAB, "--square", "20", "--out", str(out)]) == 0
    assert "pixels from the model" in capsys.readouterr().out
    found = BenchCalibration.load(tmp_path, ROBOT).views

    bench = virtual_bench(ROBOT, load_lab(LAB, ROBOT), 0, START, views=found)
    rows = measured(bench, 1.0)

    described = {
        name: CalibratedView(lens=camera.view[0], pose=camera.view[1])
        for name, camera in load_lab(LAB, ROBOT).cameras.items()
        if camera.view is not None
    }
    assert workspace_error(LAB, described) > 2e-4
    assert workspace_error(LAB, found) < 6e-5
    # A common motion of both cameras remains: the pose of the first one in the robot's frame stays as described.
    assert len(rows) >= 20
    assert np.ptp(rows[:, :3], axis=0).max() < 1e-4
