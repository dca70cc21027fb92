"""Lenses and relative pose from rendered boards equal the true ones; unsuitable pictures are refused with a reason."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from core.calibration.rigid_transform import kabsch
from core.robot.robot import Array
from station.camera.board import CHECK_MM, Corners, board_svg, corner_positions
from station.camera.lens_calibration import CalibrationRefused, View, calibrate_lens, calibrate_pair, composed
from station.camera.simulated_board import board_pose, picture
from station.cli.main import main
from station.devices.cameras import SIDE_POSE, CameraFile, LensFile, SimulationFile
from station.devices.config import Mount
from station.devices.projection import CameraView, true_view_of, view_of

SIZE, SQUARE = (1280, 720), 0.020
LENS = LensFile(focal=(1280.0, 1280.0), centre=(640.0, 360.0), distortion=(-0.05, 0.02, 0.0005, -0.0005, 0.0))
#: Two cameras 0.17 m apart whose focal lengths are off by 0.3 % and whose poses by 0.2 deg.
CAMERAS = (
    CameraFile(
        width=1280, height=720, lens=LENS, pose=SIDE_POSE,
        simulation=SimulationFile(focal_error=0.003, rotation_error=(0.002, -0.002, 0.002)),
    ),
    CameraFile(
        width=1280, height=720, lens=LENS,
        pose=Mount(position=(0.02, -0.36, 0.30), rotation_vector=(-0.90, -1.42, -1.42)),
        simulation=SimulationFile(focal_error=-0.003, rotation_error=(-0.002, 0.002, 0.002)),
    ),
)  # fmt: skip


def true_views() -> tuple[CameraView, CameraView]:
    first, second = (true_view_of(camera) for camera in CAMERAS)
    assert first is not None
    assert second is not None
    return first, second


def seen(name: str, view: CameraView, pose: tuple[Array, Array], random: np.random.Generator) -> View:
    """Return the corners of a board as a camera sees them, with an error of 0.05 pixels."""
    pixels = view.project(corner_positions(SQUARE) @ pose[0].T + pose[1]) + random.normal(0.0, 0.05, (24, 2))
    inside = ((pixels > 0.0) & (pixels < SIZE)).all(axis=1)
    return View(name, np.flatnonzero(inside), pixels[inside])


@pytest.fixture(scope="module")
def corners() -> tuple[list[View], list[View]]:
    random, views = np.random.default_rng(3), true_views()
    poses = [board_pose(views[number % 2], random, SQUARE) for number in range(24)]
    first, second = ([seen(str(n), view, pose, random) for n, pose in enumerate(poses)] for view in views)
    return first, second


def triangulated(views: tuple[CameraView, CameraView], pixels: tuple[Array, Array]) -> Array:
    """Return the points (3,) nearest to the rays of both cameras through pixels (k, 2)."""
    found: list[Array] = []
    for pair in zip(*pixels, strict=True):
        matrix, right = np.zeros((3, 3)), np.zeros(3)
        for view, pixel in zip(views, pair, strict=True):
            straight = cv2.undistortPoints(pixel[None, None], view.matrix, view.distortion, None, None, None)[0, 0]
            ray = view.rotation.T @ np.append(straight, 1.0)
            across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
            matrix, right = matrix + across, right + across @ view.position
        found.append(np.linalg.solve(matrix, right))
    return np.array(found)


def test_corners_are_found_to_a_tenth_of_a_pixel() -> None:
    view, random = true_views()[0], np.random.default_rng(0)
    rotation, position = board_pose(view, random, SQUARE)
    numbers, pixels = Corners().find(picture(view, SIZE, SQUARE, rotation, position, random))
    expected = view.project(corner_positions(SQUARE)[numbers] @ rotation.T + position)

    assert len(numbers) >= 12
    assert np.abs(pixels - expected).mean() < 0.1


def test_calibrated_pair_measures_points_to_a_tenth_of_a_millimetre(corners: tuple[list[View], list[View]]) -> None:
    """The points are in the robot's workspace; a rigid motion is left out, which the registration determines."""
    lenses = [calibrate_lens(views, SIZE, SQUARE) for views in corners]
    pair = calibrate_pair(*corners, (lenses[0].lens, lenses[1].lens), SIZE, SQUARE)
    calibrated = (
        CameraView.of(lenses[0].lens, SIDE_POSE),
        CameraView.of(lenses[1].lens, composed(SIDE_POSE, pair.relative)),
    )
    assumed = view_of(CAMERAS[0]), view_of(CAMERAS[1])
    assert assumed[0] is not None
    assert assumed[1] is not None
    points = np.random.default_rng(1).uniform((-0.05, -0.05, 0.08), (0.05, 0.05, 0.18), (100, 3))
    pixels = tuple(view.project(points) for view in true_views())

    def error(views: tuple[CameraView, CameraView]) -> float:
        measured = triangulated(views, (pixels[0], pixels[1]))
        fitted = kabsch(measured, points)
        return float(np.sqrt(((measured @ fitted.rotation.T + fitted.position - points) ** 2).sum(axis=1).mean()))

    assert error((assumed[0], assumed[1])) > 3e-4
    assert error(calibrated) < 1e-4
    for result, view in zip(lenses, true_views(), strict=True):
        assert result.lens.focal[0] == pytest.approx(view.matrix[0, 0], rel=2e-3)
        assert result.rms < 0.2
        assert result.used >= 10


def test_few_pictures_or_a_small_part_of_the_picture_or_no_tilt_are_refused(
    corners: tuple[list[View], list[View]],
) -> None:
    first = corners[0]
    with pytest.raises(CalibrationRefused, match=r"9 pictures show.*at least 10 are needed"):
        calibrate_lens([view for view in first if len(view.numbers) >= 8][:9], SIZE, SQUARE)
    with pytest.raises(CalibrationRefused, match=r"reached 1?[0-9] % of the picture"):
        calibrate_lens([view._replace(pixels=view.pixels / 8.0) for view in first], SIZE, SQUARE)
    view, random = true_views()[0], np.random.default_rng(5)
    flat: list[View] = []
    for number in range(12):  # the board is parallel to the picture at one distance
        shift = np.array([0.03 * (number % 4) - 0.145, 0.03 * (number // 4) - 0.08, 0.4])
        pose = view.rotation.T, view.position + view.rotation.T @ shift
        flat.append(seen(str(number), view, pose, random))
    with pytest.raises(CalibrationRefused, match=r"tilt the board|reached"):
        calibrate_lens(flat, SIZE, SQUARE)


def test_pictures_that_were_not_taken_together_are_refused(corners: tuple[list[View], list[View]]) -> None:
    first, second = corners
    lenses = LENS, LENS
    shifted = [view._replace(name=str((int(view.name) + 2) % 24)) for view in second]
    with pytest.raises(CalibrationRefused, match="at the same time, and do not move"):
        calibrate_pair(first, shifted, lenses, SIZE, SQUARE)
    with pytest.raises(CalibrationRefused, match="0 pairs of pictures"):
        calibrate_pair(first, [view._replace(name="x" + view.name) for view in second], lenses, SIZE, SQUARE)


def test_the_printed_board_has_its_true_size() -> None:
    text = board_svg(0.030)
    width, height = (float(one) for one in re.findall(r'(?:width|height)="([\d.]+)mm"', text))
    assert width == 7 * 30 + 24
    assert height == 5 * 30 + 24 + 18
    assert f"h{CHECK_MM}m" in text


def test_the_command_names_a_folder_without_visible_pictures_and_a_missing_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "._one.jpg").write_bytes(b"\x00\x05\x16\x07")
    assert main(("cameras", "calibrate", f"left={tmp_path}")) == 2
    assert "no pictures" in capsys.readouterr().err
    assert main(("cameras", "calibrate", str(tmp_path))) == 2
    assert "NAME=FOLDER" in capsys.readouterr().err
