"""Cameras of the pages that show the scene. Each page has a separate camera, found by the page's identity."""

import threading
from collections.abc import Callable
from urllib.parse import parse_qs, urlsplit

import numpy as np
import viser

from core.robot.robot import Array
from web.scene.views import DEFAULT_ASPECT, FIELD_OF_VIEW_RAD, VIEWS, Camera, ViewBounds, camera

#: Query parameter by which the proxy sends the page's identity to viser.
CLIENT_PARAMETER = "client"
#: If a camera is at most this far from its first position, the user has not moved it [scene units].
SAME_CAMERA_DISTANCE = 1e-3


class Cameras:
    """Sets the camera of a page to a named view."""

    def __init__(
        self, server: viser.ViserServer, extent: ViewBounds, unit: float, tip: Callable[[], Array | None]
    ) -> None:
        """`extent`: bounds of the robot that the views show; `tip` returns the present position of the tip (3,) [m]."""
        self._server, self._extent, self._unit, self._tip = server, extent, unit, tip
        self._lock = threading.Lock()
        self._clients: dict[str, viser.ClientHandle] = {}
        server.scene.set_up_direction("-x")
        first = self._camera("Overview", DEFAULT_ASPECT)
        initial = server.initial_camera
        initial.fov, initial.position, initial.look_at = FIELD_OF_VIEW_RAD, unit * first.eye, unit * first.centre
        initial.near, initial.far = 0.01 * unit, 10.0 * unit

        # viser calls this function in its own thread when a page connects.
        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            with self._lock:
                self._clients[self._who(client)] = client
            # The camera of a new page has viser's initial position and is set to the overview. If a page reconnects,
            # its camera is not changed, because the user may have chosen this camera.
            fitted = False

            async def fit(_: viser.CameraHandle) -> None:
                nonlocal fitted
                if (
                    not fitted
                    and np.linalg.norm(np.array(client.camera.position) - unit * first.eye) < SAME_CAMERA_DISTANCE
                ):
                    fitted = True
                    self._set_camera(client, "Overview")

            client.camera.on_update(fit)
            await fit(client.camera)

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            with self._lock:
                for who in [who for who, one in self._clients.items() if one is client]:
                    del self._clients[who]

    def set_view(self, who: str, view: str) -> bool:
        """Set the camera of page `who` to a view; return whether the page is connected and the view is known."""
        with self._lock:
            client = self._clients.get(who)
        if client is None or view not in VIEWS:
            return False
        self._set_camera(client, view)
        return True

    def _camera(self, view: str, aspect: float) -> Camera:
        tip = self._tip()
        return camera(view, self._extent, self._extent.middle if tip is None else tip, aspect)

    def _set_camera(self, client: viser.ClientHandle, view: str) -> None:
        target = self._camera(view, client.camera.aspect)
        with client.atomic():
            client.camera.up_direction = target.up
            client.camera.position = self._unit * target.eye
            client.camera.look_at = self._unit * target.centre

    def _who(self, client: viser.ClientHandle) -> str:
        """Return the page's identity, which the proxy adds to the address that viser receives."""
        socket = self._server._websock_server._live_connections[client.client_id]
        query = "" if socket.request is None else urlsplit(socket.request.path).query
        return parse_qs(query).get(CLIENT_PARAMETER, [""])[0]
