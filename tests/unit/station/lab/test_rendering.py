"""Rendered frames show the tubes and the ball where the lens projects them."""

import numpy as np
import pytest

from core.robot.robot import Array, Robot
from station.devices.cameras import CameraFile, LensFile, SimulationFile
from station.devices.projection import view_of
from station.lab.plant import TubeShape
from station.lab.rendering import BALL, Renderer


def shape(tip: Array, force: Array | None = None, inner: float = 1.0) -> TubeShape:
    """Return straight tubes from the plate to `tip` (3,) [m]; the inner tube ends at a share of the length."""
    length = float(np.linalg.norm(tip))
    tangent = tip / length
    line = np.array([[0.0, 0.0, 0.0, 0.0, *tangent], [length, *tip, *tangent]])
    return TubeShape(
        line,
        np.array([inner * length, length if inner < 1.0 else 0.5 * length]),
        np.zeros(3) if force is None else force,
        np.inf,
    )


def camera(noise: float) -> CameraFile:
    lens = LensFile(focal=(900.0, 905.0), centre=(325.0, 236.0), distortion=(-0.15, 0.03, 0.001, -0.001, 0.0))
    return CameraFile(lens=lens, simulation=SimulationFile(noise=noise, ball=0.006))


def centroid(picture: Array) -> Array:
    """Return the centre of the green ball (column, row), weighted by its colour."""
    blue, green, red = (picture[..., channel].astype(float) for channel in range(3))
    weight = np.clip(green - np.maximum(blue, red) - 20.0, 0.0, None)
    rows, columns = np.indices(weight.shape)
    return np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()


@pytest.mark.parametrize("tip", [(0.0, 0.0, 0.13), (0.031, 0.012, 0.171), (-0.042, -0.018, 0.098)])
@pytest.mark.parametrize(
    "inner", [1.0, 0.6, 0.0]
)  # the ball is at the end of the inner tube, also inside the outer one
def test_ball_is_at_the_projected_tip(paper_robot: Robot, tip: tuple[float, float, float], inner: float) -> None:
    config = camera(noise=0.0)
    view = view_of(config)
    assert view is not None
    picture = Renderer(paper_robot, config, view, 0).render(shape(np.array(tip), inner=inner))

    assert picture.shape == (480, 640, 3)
    assert np.abs(centroid(picture) - view.project(inner * np.array([tip]))[0]).max() < 0.06


def test_tubes_are_on_the_projected_line_and_noise_has_its_size(paper_robot: Robot) -> None:
    config = camera(noise=3.0)
    view = view_of(config)
    assert view is not None
    renderer = Renderer(paper_robot, config, view, 0)
    tubes, empty = renderer.render(shape(np.array([0.02, 0.0, 0.15]))), renderer.render(None)

    for part in (0.1, 0.4, 0.7):
        column, row = np.round(view.project(part * np.array([[0.02, 0.0, 0.15]]))[0]).astype(int)
        assert tubes[row, column].mean() > empty[row, column].mean() + 60
    difference = renderer.render(None)[:, 400:].astype(float) - empty[:, 400:]
    assert difference.std() == pytest.approx(3.0 * np.sqrt(2.0), rel=0.05)


def test_load_is_drawn_as_an_arrow_from_the_tip(paper_robot: Robot) -> None:
    config = camera(noise=0.0)
    view = view_of(config)
    assert view is not None
    renderer, tip = Renderer(paper_robot, config, view, 0), np.array([0.0, 0.0, 0.13])
    without, loaded = renderer.render(shape(tip)), renderer.render(shape(tip, np.array([0.5, 0.0, 0.0])))

    column, row = np.round(view.project(np.array([[0.015, 0.0, 0.13]]))[0]).astype(int)
    assert np.abs(loaded[row, column].astype(int) - without[row, column]).max() > 50
    assert BALL[1] > max(BALL[0], BALL[2])
