"""Named views of the scene, fitted to the robot's size and to the picture, and the camera of each page."""

import threading
from collections.abc import Callable
from itertools import product
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

import numpy as np
import viser

from core.robot.limits import Limits
from core.robot.robot import Array, Robot, Tube

#: Vertical field of view of the camera [rad].
FIELD_OF_VIEW_RAD = np.deg2rad(35.0)
#: Aspect ratio (width by height) that is assumed for a picture of unknown size.
DEFAULT_ASPECT = 1.4
#: Factor on the camera's distance that leaves a margin around the bounds.
VIEW_MARGIN = 1.06
#: Half the edge length of the cube around the tip that the view "Tip" shows [m].
TIP_VIEW_HALF_EDGE_M = 0.03

#: Fraction of the robot's lateral reach that the overview shows, because the tip is seldom at the limit of its reach.
LATERAL_SHARE = 0.45

#: Direction in the world frame that points up on the screen. Gravity acts along +x, so up is -x.
_UP = (-1.0, 0.0, 0.0)
#: Two vectors of each view, world frame: from the picture's centre to the camera (any length), and up on the screen.
DIRECTIONS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "Overview": ((-0.42, -0.85, 0.42), _UP),
    "Side": ((0.0, -1.0, 0.0), _UP),
    "Above": ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "Front": ((0.0, 0.0, 1.0), _UP),
    "Tip": ((-0.35, -0.65, 0.68), _UP),
}
VIEWS = tuple(DIRECTIONS)


class ViewBounds(NamedTuple):
    """A box in the world frame that a view shows."""

    lower: Array  #: smallest coordinates (3,) [m]
    upper: Array  #: largest coordinates (3,) [m]

    @staticmethod
    def around(points: Array) -> "ViewBounds":
        """Return the smallest box around points (k, 3) [m]."""
        return ViewBounds(points.min(axis=0), points.max(axis=0))

    @property
    def middle(self) -> Array:
        """Centre of the box (3,) [m]."""
        return 0.5 * (self.lower + self.upper)

    @property
    def corners(self) -> Array:
        """Corners of the box (8, 3) [m]."""
        ends = np.stack((self.lower, self.upper))
        return np.stack([axis.ravel() for axis in np.meshgrid(*ends.T, indexing="ij")], axis=1)


class Camera(NamedTuple):
    """Position and orientation of a camera."""

    eye: Array  #: position (3,) [m]
    centre: Array  #: point at the centre of the picture (3,) [m]
    up: Array  #: direction (3,) that points up in the picture, world frame


def camera(view: str, robot: ViewBounds, tip: Array, aspect: float) -> Camera:
    """Return the camera as near as possible to the robot such that the picture contains all bounds of the view.

    Args:
        view: one of `VIEWS`.
        robot: bounds of the robot's reach.
        tip: present tip (3,) [m].
        aspect: aspect ratio of the picture (width by height).
    """
    shown = robot
    if view == "Tip":
        shown = ViewBounds(tip - TIP_VIEW_HALF_EDGE_M, tip + TIP_VIEW_HALF_EDGE_M)
    elif view == "Overview":
        middle, along = robot.middle, robot.upper - robot.lower == np.max(robot.upper - robot.lower)
        shown = ViewBounds(*(middle + np.where(along, 1.0, LATERAL_SHARE) * (end - middle) for end in robot))
    direction, up = (np.array(vector) for vector in DIRECTIONS[view])
    toward = direction / np.linalg.norm(direction)
    right = np.cross(up, toward)
    right /= np.linalg.norm(right)
    corners = shown.corners - shown.middle
    half = np.tan(0.5 * FIELD_OF_VIEW_RAD)
    sideways = np.abs(corners @ right) / (half * aspect)
    upward = np.abs(corners @ np.cross(toward, right)) / half
    distance = float(np.max(corners @ toward + VIEW_MARGIN * np.maximum(sideways, upward)))
    return Camera(shown.middle + distance * toward, shown.middle, up)


SAMPLING_STEP = 1e-3  #: distance between the points of a tube at which its curvature is sampled [m]
#: Margins of the bounds around the plate, the rail and the straight tubes behind the plate: aside and below [m].
MARGIN_ASIDE_M, MARGIN_BELOW_M = 0.022, 0.026


def translations(robot: Robot, limits: Limits) -> tuple[Array, Array]:
    """Return the rearmost (q,) and foremost (q,) positions of the tubes' proximal ends along the plate's z axis [m]."""
    rear = np.array([tube.translation for tube in robot.tubes])
    front = rear.copy()
    for joint, limit in zip(robot.joints, limits.joints, strict=True):
        if joint.motion == "translation":
            rear[joint.tube], front[joint.tube] = limit.lower, limit.upper
    return rear, front


def extent(robot: Robot, limits: Limits) -> ViewBounds:
    """Return the bounds of robot and stages in the world frame, over all rotations of the tubes and without a load."""
    rear, front = translations(robot, limits)
    translation_sets = product(*zip(rear, 0.5 * (rear + front), front, strict=True))
    reach = max(MARGIN_BELOW_M, *(_lateral_reach(robot, np.array(beta)) for beta in set(translation_sets)))
    length = max(float(start) + tube.length for tube, start in zip(robot.tubes, front, strict=True))
    lower, upper = (-reach, -reach, float(rear.min())), (reach, reach, length)
    base = robot.base
    return ViewBounds.around(
        ViewBounds(np.array(lower), np.array(upper)).corners @ base.rotation.T + np.array(base.position)
    )


def _lateral_reach(robot: Robot, beta: Array) -> float:
    """Return the distance of the tip from the plate's axis [m] if all tubes bend in one plane.

    The proximal ends of the tubes are at `beta` (q,) [m]. The common curvature of aligned tubes is the mean of
    their curvatures, weighted by their bending stiffness.
    """
    length = max(float(start) + tube.length for tube, start in zip(robot.tubes, beta, strict=True))
    at = np.arange(0.0, max(length, SAMPLING_STEP), SAMPLING_STEP)
    stiffness, moment = np.full_like(at, 1e-12), np.zeros_like(at)
    for tube, start in zip(robot.tubes, beta, strict=True):
        stiffness += tube.bending_stiffness * (at < start + tube.length)
        moment += tube.bending_stiffness * _curvature(tube, at - start)
    angle = np.cumsum(moment / stiffness) * SAMPLING_STEP
    return float(np.abs(np.sum(np.sin(angle)) * SAMPLING_STEP))


def _curvature(tube: Tube, at: Array) -> Array:
    """Return the curvature (k,) [1/m] of the unstressed tube at distances `at` (k,) [m] from its proximal end."""
    ends = np.cumsum([section.length for section in tube.sections])
    curvatures = np.array([np.hypot(*section.curvature) for section in tube.sections] + [0.0])
    return curvatures[np.searchsorted(ends, at, side="right")]


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
