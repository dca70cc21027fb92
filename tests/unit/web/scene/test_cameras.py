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
    FOLLOWING_VIEW,
    TIP_VIEW_HALF_EDGE_M,
    Cameras,
    ViewBounds,
    camera,
    extent,
    translations,
)
from web.scene.content import NOTHING, SceneContent
from web.scene.framing import FIELD_OF_VIEW_RAD, Camera
from web.scene.grid import COARSE_SPACING_M, Grid
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


ROOM = ViewBounds(np.array((-0.1, -0.1, -0.15)), np.array((0.1, 0.1, 0.3)))
TIP, UNIT, ASIDE = np.array((0.02, -0.03, 0.25)), 10.0, np.array((1.0, 2.0, 3.0))


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


@pytest.fixture(scope="module")
def cameras(server: viser.ViserServer) -> Cameras:
    return Cameras(server, ROOM, UNIT, lambda: NOTHING._replace(measured=TIP))


def page(server: viser.ViserServer, name: str) -> ClientConnection:
    """Return a browser's socket as the proxy opens it."""
    address = f"ws://127.0.0.1:{server.get_port()}/?client={name}"
    version = f"viser-v{viser.__version__}"
    return connect(address, subprotocols=[version], proxy=None, max_size=None)  # pyright: ignore[reportArgumentType]


def report(
    socket: ClientConnection, position: np.ndarray, aspect: float, look_at: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> None:
    """Send a camera message, as a browser does, with a position and an aspect ratio."""
    message: dict[str, Any] = {
        "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": position.tolist(), "fov": 0.6,
        "near": 0.1, "far": 100.0, "image_height": 100, "image_width": round(100 * aspect),
        "look_at": look_at, "up_direction": (-1.0, 0.0, 0.0),
    }  # fmt: skip
    socket.send(msgspec.msgpack.encode(message))


def stands_at(cameras: Cameras, name: str, view: str, aspect: float) -> bool:
    place = UNIT * camera(view, ROOM, TIP, aspect).eye
    return bool(np.allclose(cameras._pages[name].client.camera.position, place, atol=1e-6))


def test_a_view_moves_the_scene_camera_of_one_page_only(server: viser.ViserServer, cameras: Cameras) -> None:
    with page(server, "page-one") as one, page(server, "page-two") as two:
        report(one, ASIDE, DEFAULT_ASPECT)
        report(two, ASIDE, 2.0)
        until(lambda: len(cameras._pages) == 2)
        assert cameras.set_view("page-two", "Tip")
        assert stands_at(cameras, "page-two", "Tip", 2.0)
        np.testing.assert_allclose(cameras._pages["page-one"].client.camera.position, ASIDE)
        assert not cameras.set_view("page-one", "Somewhere")
        assert not cameras.set_view("page-three", "Tip")
    until(lambda: not cameras._pages)


def test_the_first_scene_picture_is_fitted_to_the_page_and_a_chosen_camera_is_kept(
    server: viser.ViserServer, cameras: Cameras
) -> None:
    first = camera(FOLLOWING_VIEW, ROOM, np.zeros(3), DEFAULT_ASPECT)
    with page(server, "page-new") as new:
        report(new, ASIDE, 0.5)
        until(lambda: "page-new" in cameras._pages)
        report(new, UNIT * first.eye, 0.5, tuple((UNIT * first.centre).tolist()))  # viser's first camera
        until(lambda: stands_at(cameras, "page-new", FOLLOWING_VIEW, 0.5))
    with page(server, "page-back") as back:
        report(back, ASIDE, 0.5)
        until(lambda: "page-back" in cameras._pages)
        report(back, 2.0 * ASIDE, 0.5)
        until(lambda: np.allclose(cameras._pages["page-back"].client.camera.position, 2.0 * ASIDE))


def content(scale: float) -> SceneContent:
    """Return a picture of a curved robot of 0.2 m times `scale`."""
    at = np.linspace(0.0, 0.2 * scale, 30)
    return NOTHING._replace(robot=np.stack((at**2, np.zeros(30), at), axis=1))


def test_the_following_camera_frames_the_drawn_robot_until_the_user_moves_it(server: viser.ViserServer) -> None:
    drawn = [content(1.0)]
    cameras = Cameras(server, ROOM, UNIT, lambda: drawn[0])

    def visible() -> bool:
        """Return whether the last camera shows the whole robot, and the robot fills a third of the picture."""
        cameras.follow(reframe=True)
        seen = on_screen(cameras._pages["page"].commanded[-1], drawn[0].robot, 1.5)
        return bool(np.abs(seen).max() < 1.0 and np.ptp(seen[:, 0]) > 2.0 / 3.0)

    with page(server, "page") as one:
        report(one, ASIDE, 1.5)
        until(lambda: "page" in cameras._pages)
        assert cameras.set_view("page", FOLLOWING_VIEW)
        assert visible()
        small = cameras._pages["page"].commanded[-1]
        drawn[0] = content(0.4)
        cameras.follow(reframe=True)
        assert cameras._pages["page"].movement is not None  # the camera starts to move and does not jump
        until(lambda: visible() and cameras._pages["page"].movement is None)
        assert len(cameras._pages["page"].commanded) > 2
        near = cameras._pages["page"].commanded[-1]
        assert np.linalg.norm(near.eye - near.centre) < 0.6 * np.linalg.norm(small.eye - small.centre)
        report(one, ASIDE, 1.5)  # the user moves the camera
        until(lambda: not cameras._pages["page"].following)
        drawn[0] = content(1.0)
        number = len(cameras._pages["page"].commanded)
        cameras.follow(reframe=True)
        assert len(cameras._pages["page"].commanded) == number
