"""The tip is tracked with two rendered cameras, also in the closed loop, and their faults are told."""

from pathlib import Path

import numpy as np
import pytest

from station.cli.main import main
from station.config.robots import load_robot
from station.control.bench_calibration import BenchCalibration
from station.control.clock import VirtualClock
from station.devices.cameras import CalibratedView
from station.devices.interfaces import Severity
from station.experiments.experiment import load_experiment
from station.experiments.runner import run_case
from station.lab.config import load_lab
from station.lab.virtual_bench import VirtualBench, virtual_bench
from tests.harness.true_cameras import true_views, workspace_error, write_true_views

LAB = "two_cameras"
ROBOT = load_robot("paper")
START = np.array([0.0, 0.5 * np.pi, -0.1])


def measured(bench: VirtualBench, until: float) -> np.ndarray:
    """Return the errors (k, 3) of the tracker [m] and the delays of its readings (k,) [s], as rows (k, 4)."""
    tracker, rows = bench.devices.tracker, []
    assert tracker is not None
    tracker.connect(0.0)
    for now in np.arange(0.0, until, 0.002):
        truth = bench.lab.advance(float(now))
        reading = tracker.poll(float(now))
        if reading is not None:
            rows.append(np.append(reading.position - truth.tip, now - reading.time))
    return np.array(rows)


def test_calibrated_cameras_measure_the_tip_at_rest_to_a_twentieth_of_a_millimetre() -> None:
    bench = virtual_bench(ROBOT, load_lab(LAB, ROBOT), 0, START, views=true_views(LAB))

    rows = measured(bench, 1.0)

    assert len(rows) >= 20  # of 30; 5 % of the frames of each camera are dropped
    assert np.abs(rows[:, :3]).max() < 5e-5
    assert rows[:, 3] == pytest.approx(0.052, abs=0.003)  # latency and processing


def test_uncalibrated_cameras_are_half_a_millimetre_off_and_a_warning_says_so() -> None:
    """The poses of the lab's cameras are off by 0.2 deg and their focal lengths by 0.3 %, as measured by hand."""
    bench = virtual_bench(ROBOT, load_lab(LAB, ROBOT), 0, START)

    rows = measured(bench, 2.0)

    assert np.linalg.norm(rows[:, :3], axis=1).min() > 5e-4
    assert bench.devices.tracker is not None
    fault = bench.devices.tracker.trouble(2.0)
    assert fault is not None
    assert fault.severity is Severity.WARN
    assert "calibrate the cameras" in fault.text


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


@pytest.mark.parametrize(
    "motion", ['kind = "circle"\nradius = 0.005\nperiod = 6.0\n', 'kind = "hold"\n'], ids=["circle", "fig8"]
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
    recording = run_case(load_experiment(str(file)).cases[0], 0, VirtualClock(), lambda _: None)

    assert recording.completed, recording.cause
    of = recording.channels.of
    error = of(recording.rows, "tip_true") - of(recording.rows, "tip_desired")
    assert np.sqrt((error**2).sum(axis=1).mean()) < 1e-3
    assert np.linalg.norm(error, axis=1).max() < 2.5e-3
