"""The nearest camera that shows given points inside a window of the picture."""

import numpy as np
import pytest

from web.scene.framing import FIELD_OF_VIEW_RAD, Window, fit, fit_next_to_close_up, free_windows

POINTS = np.random.default_rng(3).uniform((-0.05, -0.02, 0.0), (0.05, 0.03, 0.25), (50, 3))
DIRECTION, UP = (-0.4, -0.9, 0.3), (-1.0, 0.0, 0.0)


def in_picture(camera, aspect: float) -> np.ndarray:
    """Return the points in the picture (k, 2), with the picture's edges at -1 and 1."""
    ahead = (camera.centre - camera.eye) / np.linalg.norm(camera.centre - camera.eye)
    right = np.cross(ahead, camera.up)
    right /= np.linalg.norm(right)
    seen = POINTS - camera.eye
    depth = np.tan(0.5 * FIELD_OF_VIEW_RAD) * (seen @ ahead)
    return np.stack((seen @ right / (aspect * depth), seen @ np.cross(right, ahead) / depth), axis=1)


@pytest.mark.parametrize("aspect", [0.6, 1.0, 1.6, 2.4])
@pytest.mark.parametrize("window", [Window(), Window(0.9, 0.2, 0.8, 0.7), Window(0.5, 0.9, 0.9, -0.2)])
def test_a_fitted_camera_shows_all_points_inside_the_window_and_touches_two_opposite_edges(
    aspect: float, window: Window
) -> None:
    seen = in_picture(fit(POINTS, DIRECTION, UP, aspect, window), aspect)
    gaps = np.array((seen[:, 0].min() + window.left, window.right - seen[:, 0].max(),
                     seen[:, 1].min() + window.below, window.above - seen[:, 1].max()))  # fmt: skip
    assert (gaps > -1e-9).all()
    assert gaps[:2].max() < 1e-9 or gaps[2:].max() < 1e-9


@pytest.mark.parametrize("aspect", [0.6, 1.0, 1.6, 2.4])
def test_the_following_camera_keeps_the_robot_out_of_the_close_up(aspect: float) -> None:
    seen = in_picture(fit_next_to_close_up(POINTS, DIRECTION, UP, aspect, POINTS[:0]), aspect)
    beside, below = free_windows(aspect)
    assert seen[:, 0].max() < beside.right + 1e-9 or seen[:, 1].max() < below.above + 1e-9


TURN = np.linspace(0.0, 2.0 * np.pi, 60)
CIRCLE = 0.01 * np.stack((np.cos(TURN), np.sin(TURN), np.zeros_like(TURN)), axis=1)


def turned(seed: int) -> np.ndarray:
    """Return the circle in another plane."""
    return CIRCLE @ np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0].T


@pytest.mark.parametrize("aspect", [0.6, 1.0, 1.6, 2.4])
@pytest.mark.parametrize("path", [CIRCLE, *map(turned, range(8))])
def test_a_circle_at_the_end_of_the_robot_is_not_seen_edge_on(path: np.ndarray, aspect: float) -> None:
    path = path + np.array([0.03, 0.0, 0.24])
    points = np.concatenate((POINTS, path))
    camera = fit_next_to_close_up(points, DIRECTION, UP, aspect, path)
    ray, normal = camera.eye - path[:-1].mean(axis=0), np.cross(path[20] - path[0], path[40] - path[0])
    tilt = np.rad2deg(np.arcsin(abs(normal @ ray) / np.linalg.norm(normal) / np.linalg.norm(ray)))
    assert tilt > 29.0


def test_a_line_and_a_resting_tip_leave_the_view_unchanged() -> None:
    line = np.linspace((0.0, 0.0, 0.2), (0.01, 0.0, 0.21), 30)
    usual = fit_next_to_close_up(POINTS, DIRECTION, UP, 1.4, CIRCLE[:0])
    for path in (line, CIRCLE[:1], np.tile(CIRCLE[0], (9, 1))):
        assert np.array_equal(fit_next_to_close_up(POINTS, DIRECTION, UP, 1.4, path).eye, usual.eye)
