"""Cameras, grid and rail fit every robot."""

import numpy as np
import pytest

from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import RobotFile, load_robot
from web.scene.grid import COARSE_SPACING_M, Grid
from web.scene.robot_extent import extent, translations
from web.scene.stroke_font import strokes
from web.scene.views import FIELD_OF_VIEW_RAD, TIP_VIEW_HALF_EDGE_M, Camera, ViewBounds, camera
from web.scene.workspace import reachable_tips

ROBOTS = ("paper", "three_tubes", "nylon")
ASPECTS = (0.6, 1.0, 1.4, 2.4)


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> RobotFile:
    return load_robot(request.param)


def on_screen(place: Camera, points: Array, aspect: float) -> Array:
    """Return points (k, 3) in the picture: (k, 2), with the picture's edges at -1 and 1."""
    ahead = (place.centre - place.eye) / np.linalg.norm(place.centre - place.eye)
    right = np.cross(ahead, place.up)
    right /= np.linalg.norm(right)
    seen = points - place.eye
    depth = np.tan(0.5 * FIELD_OF_VIEW_RAD) * (seen @ ahead)
    assert (depth > 0.0).all()
    return np.stack((seen @ right / (aspect * depth), seen @ np.cross(right, ahead) / depth), axis=1)


@pytest.mark.parametrize("view", ["Side", "Above", "Front"])
@pytest.mark.parametrize("aspect", ASPECTS)
def test_a_view_shows_all_that_the_robot_reaches_and_little_else(robot: RobotFile, view: str, aspect: float) -> None:
    room = extent(robot.robot(), robot.limits())
    seen = on_screen(camera(view, room, room.middle, aspect), room.corners, aspect)
    assert np.abs(seen).max() <= 1.0
    assert np.abs(seen).max() > 0.85


@pytest.mark.parametrize("aspect", ASPECTS)
def test_the_overview_shows_the_robot_from_its_rear_end_to_its_furthest_tip(robot: RobotFile, aspect: float) -> None:
    room = extent(robot.robot(), robot.limits())
    axis = np.array([(0.0, 0.0, z) for z in (room.lower[2], 0.0, room.upper[2])])
    seen = on_screen(camera("Overview", room, room.middle, aspect), axis, aspect)
    assert np.abs(seen).max() <= 1.0
    assert np.ptp(seen[:, 0]) > 1.0  # the robot covers at least half of the picture


def test_the_view_of_the_tip_shows_a_cube_around_it(robot: RobotFile) -> None:
    room, tip = extent(robot.robot(), robot.limits()), np.array([0.03, -0.02, 0.2])
    seen = on_screen(
        camera("Tip", room, tip, 1.4), ViewBounds(tip - TIP_VIEW_HALF_EDGE_M, tip + TIP_VIEW_HALF_EDGE_M).corners, 1.4
    )
    assert 0.85 < np.abs(seen).max() <= 1.0


def test_every_tip_and_every_carriage_is_inside_the_bounds_of_the_robot(robot: RobotFile) -> None:
    room = extent(robot.robot(), robot.limits())
    tips = reachable_tips(Statics(robot.robot()), robot.limits(), 60)
    assert len(tips) > 10
    assert (tips >= room.lower - 1e-3).all()
    assert (tips <= room.upper + 1e-3).all()
    rear, front = translations(robot.robot(), robot.limits())
    assert rear.min() >= room.lower[2]
    assert (front >= rear).all()
    # The box is not too large: tips reach more than half of its length.
    assert tips[:, 2].max() > 0.5 * room.upper[2]


def test_the_grid_encloses_the_robot_between_coarse_lines(robot: RobotFile) -> None:
    room = extent(robot.robot(), robot.limits())
    grid = Grid.around(room)
    assert (grid.lower <= room.lower + 0.01).all()
    assert (grid.upper >= room.upper - 0.01).all()
    for ends in (grid.lower, grid.upper, 0.5 * (grid.lower + grid.upper)):
        np.testing.assert_allclose(ends / COARSE_SPACING_M, np.round(ends / COARSE_SPACING_M), atol=1e-9)


@pytest.mark.parametrize("text", ["0", "-150", "23456789", "z mm", "x y"])
def test_grid_labels_are_in_their_plane_around_their_centre(text: str) -> None:
    middle, right, up = np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 1.0]), np.array([-1.0, 0.0, 0.0])
    points = (strokes(text, middle, right, up, 0.008) - middle).reshape(-1, 3)
    np.testing.assert_allclose(points[:, 1], 0.0)
    assert np.abs(points @ up).max() <= 0.004 + 1e-12
    assert np.ptp(points @ right) <= 0.008 * 0.8 * len(text)
    assert abs((points @ right).max() + (points @ right).min()) < 0.004
