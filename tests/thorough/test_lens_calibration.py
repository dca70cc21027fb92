"""`ctr-station cameras calibrate` on rendered pictures of a board."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from station.camera.simulated_board import board_pose, picture
from station.cli.main import main
from station.devices.config import Mount
from station.service.station_file import load_station
from tests.unit.station.camera.test_lens_calibration import SIZE, SQUARE, true_views


@pytest.fixture(scope="module")
def pictures() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return 24 pairs of pictures of a board, which is anywhere in the picture of one of the cameras."""
    random, views = np.random.default_rng(3), true_views()
    found: tuple[list[np.ndarray], list[np.ndarray]] = [], []
    for number in range(24):
        pose = board_pose(views[number % 2], random, SQUARE)
        for view, kept in zip(views, found, strict=True):
            kept.append(picture(view, SIZE, SQUARE, *pose, random))
    return found


def test_the_command_writes_tables_that_a_station_reads(
    pictures: tuple[list[np.ndarray], list[np.ndarray]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, each in zip(("left", "right"), pictures, strict=True):
        (tmp_path / name).mkdir()
        for number, one in enumerate(each):
            cv2.imwrite(str(tmp_path / name / f"{number:02}.png"), one)
    station, out = tmp_path / "station.toml", tmp_path / "cameras.toml"
    station.write_text("[cameras.left]\n[cameras.left.pose]\nposition = [0.0, -0.4, 0.1]\n", encoding="utf-8")
    folders = [f"{name}={tmp_path / name}" for name in ("left", "right")]
    assert main(("cameras", "calibrate", *folders, "--square", "20", "--config", str(station), "--out", str(out))) == 0

    printed = capsys.readouterr().out
    assert "left and right:" in printed
    assert "mm apart" in printed
    text = out.read_text(encoding="utf-8")
    station.write_text(text[text.index("[cameras.") :], encoding="utf-8")
    cameras = load_station(station).cameras
    assert cameras["left"].lens is not None
    assert cameras["left"].lens.focal[0] == pytest.approx(1283.84, rel=2e-3)
    assert cameras["left"].pose == Mount(position=(0.0, -0.4, 0.1))
    assert cameras["right"].pose is not None
