"""Cameras, grid and rail fit every robot; cameras of pages, on a real viser server without a station."""

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest
import viser
from websockets.sync.client import ClientConnection, connect

from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import RobotFile, load_robot
from tests.harness.waiting import until
from web.scene.cameras import (
    DEFAULT_ASPECT,
    FIELD_OF_VIEW_RAD,
    TIP_VIEW_HALF_EDGE_M,
    Camera,
    Cameras,
    ViewBounds,
    camera,
    extent,
    translations,
)
from web.scene.grid import COARSE_SPACING_M, Grid, strokes
from web.scene.overlays import reachable_tips

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


ROOM = ViewBounds(np.array((-0.1, -0.1, -0.15)), np.array((0.1, 0.1, 0.3)))
TIP, UNIT, ASIDE = np.array((0.02, -0.03, 0.25)), 10.0, np.array((1.0, 2.0, 3.0))


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


@pytest.fixture(scope="module")
def cameras(server: viser.ViserServer) -> Cameras:
    return Cameras(server, ROOM, UNIT, lambda: TIP)


def page(server: viser.ViserServer, name: str) -> ClientConnection:
    """Return a browser's socket as the proxy opens it."""
    address = f"ws://127.0.0.1:{server.get_port()}/?client={name}"
    version = f"viser-v{viser.__version__}"
    return connect(address, subprotocols=[version], proxy=None, max_size=None)  # pyright: ignore[reportArgumentType]


def report(socket: ClientConnection, position: np.ndarray, aspect: float) -> None:
    """Send a camera message, as a browser does, with a position and an aspect ratio."""
    message: dict[str, Any] = {
        "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": position.tolist(), "fov": 0.6,
        "near": 0.1, "far": 100.0, "image_height": 100, "image_width": round(100 * aspect),
        "look_at": (0.0, 0.0, 0.0), "up_direction": (-1.0, 0.0, 0.0),
    }  # fmt: skip
    socket.send(msgspec.msgpack.encode(message))


def stands_at(cameras: Cameras, name: str, view: str, aspect: float) -> bool:
    place = UNIT * camera(view, ROOM, TIP, aspect).eye
    return bool(np.allclose(cameras._clients[name].camera.position, place, atol=1e-6))


def test_a_view_moves_the_scene_camera_of_one_page_only(server: viser.ViserServer, cameras: Cameras) -> None:
    with page(server, "page-one") as one, page(server, "page-two") as two:
        report(one, ASIDE, DEFAULT_ASPECT)
        report(two, ASIDE, 2.0)
        until(lambda: len(cameras._clients) == 2)
        assert cameras.set_view("page-two", "Tip")
        assert stands_at(cameras, "page-two", "Tip", 2.0)
        np.testing.assert_allclose(cameras._clients["page-one"].camera.position, ASIDE)
        assert not cameras.set_view("page-one", "Somewhere")
        assert not cameras.set_view("page-three", "Tip")
    until(lambda: not cameras._clients)


def test_the_first_scene_picture_is_fitted_to_the_page_and_a_chosen_camera_is_kept(
    server: viser.ViserServer, cameras: Cameras
) -> None:
    first = UNIT * camera("Overview", ROOM, TIP, DEFAULT_ASPECT).eye
    with page(server, "page-new") as new:
        report(new, ASIDE, 0.5)  # the position of viser's first camera
        until(lambda: "page-new" in cameras._clients)
        report(new, first, 0.5)
        until(lambda: stands_at(cameras, "page-new", "Overview", 0.5))
    with page(server, "page-back") as back:
        report(back, ASIDE, 0.5)
        until(lambda: "page-back" in cameras._clients)
        report(back, 2.0 * ASIDE, 0.5)
        until(lambda: np.allclose(cameras._clients["page-back"].camera.position, 2.0 * ASIDE))
