"""Triangulated points are the true ones, and their covariance is that of many noisy pixels."""

import numpy as np
import pytest

from station.devices.cameras import LensFile
from station.devices.config import Mount
from station.devices.projection import CameraView
from station.devices.stereo.triangulation import triangulate

LENS = LensFile(focal=(1280.0, 1270.0), centre=(640.0, 355.0), distortion=(-0.1, 0.05, 0.001, -0.002, 0.01))


def view(position: tuple[float, float, float], turn: tuple[float, float, float]) -> CameraView:
    return CameraView.of(LENS, Mount(position=position, rotation_vector=turn))


#: Two cameras that look at the origin from 0.5 m, along y and along x.
ALONG_Y = view((0.0, -0.5, 0.0), (-np.pi / 2, 0.0, 0.0))
ALONG_X = view((-0.5, 0.0, 0.0), (0.0, np.pi / 2, 0.0))


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (0.05, -0.04, 0.06), (-0.08, 0.07, -0.05)])
def test_exact_pixels_give_the_point(point: tuple[float, float, float]) -> None:
    views = [ALONG_Y, ALONG_X]
    pixels = np.vstack([each.project(np.array([point])) for each in views])

    found = triangulate(views, pixels)

    assert found is not None
    assert found.position == pytest.approx(point, abs=1e-8)
    assert found.residual < 1e-4


def test_covariance_is_that_of_points_from_noisy_pixels() -> None:
    near = view((0.1, -0.45, 0.05), (-np.pi / 2, 0.0, 0.0))
    views, point = [ALONG_Y, near], np.array([0.02, 0.03, -0.02])
    pixels = np.vstack([each.project(point[None]) for each in views])
    random, deviation = np.random.default_rng(0), 0.2
    found = [triangulate(views, pixels + random.normal(0.0, deviation, (2, 2))) for _ in range(1000)]
    points = np.array([one.position for one in found if one is not None])
    exact = triangulate(views, pixels)

    assert exact is not None
    assert len(points) == 1000
    measured, computed = np.cov(points.T), deviation**2 * exact.covariance
    assert np.sqrt(np.linalg.eigvalsh(measured)) == pytest.approx(np.sqrt(np.linalg.eigvalsh(computed)), rel=0.1)


def test_lines_of_sight_that_miss_each_other_have_a_residual() -> None:
    views = [ALONG_Y, ALONG_X]
    pixels = np.vstack([each.project(np.zeros((1, 3))) for each in views])
    pixels[1, 0] += 20.0  # across the plane of both lines of sight

    found = triangulate(views, pixels)

    assert found is not None
    assert found.residual == pytest.approx(10.0, rel=0.1)


def test_parallel_lines_and_points_behind_a_camera_are_refused() -> None:
    assert triangulate([ALONG_Y, ALONG_Y], np.array([[640.0, 355.0], [640.0, 355.0]])) is None
    away = view((0.0, 0.5, 0.0), (-np.pi / 2, 0.0, 0.0))  # looks away from the origin
    pixels = np.vstack([ALONG_X.project(np.zeros((1, 3))), [[640.0, 355.0]]])
    assert triangulate([ALONG_X, away], pixels) is None
