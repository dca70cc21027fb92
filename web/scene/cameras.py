"""The cameras of the pages that look at the scene: each one's own, known by the page's identity."""

import threading
from collections.abc import Callable
from urllib.parse import parse_qs, urlsplit

import numpy as np
import viser

from core.robot.robot import Array
from web.scene.views import ASPECT, FIELD, VIEWS, Bounds, Camera, camera

#: By this name the proxy tells viser whose socket it is.
CLIENT = "client"
#: A camera that stands this near to where it began has not been moved, scene units.
NEAR = 1e-3


class Cameras:
    """Puts a page's camera where its person wants to look from."""

    def __init__(self, server: viser.ViserServer, extent: Bounds, unit: float, tip: Callable[[], Array | None]) -> None:
        """`extent` is what the views show, `tip` where the tip is now (3,) [m]."""
        self._server, self._extent, self._unit, self._tip = server, extent, unit, tip
        self._lock = threading.Lock()
        self._clients: dict[str, viser.ClientHandle] = {}
        server.scene.set_up_direction("-x")
        first = self._camera("Overview", ASPECT)
        begin = server.initial_camera
        begin.fov, begin.position, begin.look_at = FIELD, unit * first.eye, unit * first.centre
        begin.near, begin.far = 0.01 * unit, 10.0 * unit

        # On viser's own thread.
        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            with self._lock:
                self._clients[self._who(client)] = client
            # A page that is new reports a camera of viser's own, then the first one; one that comes back after a cut
            # reports the place that its person has chosen, and keeps it.
            fitted = False

            async def fit(_: viser.CameraHandle) -> None:
                nonlocal fitted
                if not fitted and np.linalg.norm(np.array(client.camera.position) - unit * first.eye) < NEAR:
                    fitted = True
                    self._place(client, "Overview")

            client.camera.on_update(fit)
            await fit(client.camera)

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            with self._lock:
                for who in [who for who, one in self._clients.items() if one is client]:
                    del self._clients[who]

    def look(self, who: str, view: str) -> bool:
        """Have the page of that identity look from a view; whether it is there and the view is known."""
        with self._lock:
            client = self._clients.get(who)
        if client is None or view not in VIEWS:
            return False
        self._place(client, view)
        return True

    def _camera(self, view: str, aspect: float) -> Camera:
        tip = self._tip()
        return camera(view, self._extent, self._extent.middle if tip is None else tip, aspect)

    def _place(self, client: viser.ClientHandle, view: str) -> None:
        place = self._camera(view, client.camera.aspect)
        with client.atomic():
            client.camera.up_direction = place.up
            client.camera.position = self._unit * place.eye
            client.camera.look_at = self._unit * place.centre

    def _who(self, client: viser.ClientHandle) -> str:
        """The identity that the proxy has put into the address; viser's interface does not show it."""
        socket = self._server._websock_server._live_connections[client.client_id]
        asked = "" if socket.request is None else urlsplit(socket.request.path).query
        return parse_qs(asked).get(CLIENT, [""])[0]
