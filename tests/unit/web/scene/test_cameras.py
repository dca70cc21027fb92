"""Cameras of pages, on a real viser server without a station."""

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest
import viser
from websockets.sync.client import ClientConnection, connect

from tests.harness.waiting import until
from web.scene.cameras import Cameras
from web.scene.views import DEFAULT_ASPECT, ViewBounds, camera

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
