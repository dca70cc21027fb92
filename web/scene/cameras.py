"""Named views of the scene, fitted to the robot's size and to the picture, and the camera of each page."""

import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from itertools import product
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

import numpy as np
import viser

from core.robot.limits import Limits
from core.robot.robot import Array, Robot, Tube
from web.scene.content import NO_POINTS, SceneContent
from web.scene.framing import FIELD_OF_VIEW_RAD, Camera, Vector, fit, fit_next_to_close_up

#: Aspect ratio (width by height) that is assumed for a picture of unknown size.
DEFAULT_ASPECT = 1.4
#: Half the edge length of the cube around the tip that the view "Tip" shows [m].
TIP_VIEW_HALF_EDGE_M = 0.03

#: Fraction of the robot's lateral reach that the overview shows, because the tip is seldom at the limit of its reach.
LATERAL_SHARE = 0.45

#: Direction in the world frame that points up on the screen. Gravity acts along +x, so up is -x.
_UP = (-1.0, 0.0, 0.0)
#: View that shows what is drawn now and follows it; all other views show a fixed part of the world.
FOLLOWING_VIEW = "Frame"
#: Two vectors of each view, world frame: from the picture's centre to the camera (any length), and up on the screen.
DIRECTIONS: dict[str, tuple[Vector, Vector]] = {
    FOLLOWING_VIEW: ((-0.40, -0.88, 0.30), _UP),
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


def camera(view: str, robot: ViewBounds, tip: Array, aspect: float) -> Camera:
    """Return the camera as near as possible to the robot such that the picture contains all bounds of the view.

    Args:
        view: one of `VIEWS`; `FOLLOWING_VIEW` only while nothing is drawn.
        robot: bounds of the robot's reach.
        tip: present tip (3,) [m].
        aspect: aspect ratio of the picture (width by height).
    """
    shown = robot
    if view == "Tip":
        shown = ViewBounds(tip - TIP_VIEW_HALF_EDGE_M, tip + TIP_VIEW_HALF_EDGE_M)
    elif view in ("Overview", FOLLOWING_VIEW):
        middle, along = robot.middle, robot.upper - robot.lower == np.max(robot.upper - robot.lower)
        shown = ViewBounds(*(middle + np.where(along, 1.0, LATERAL_SHARE) * (end - middle) for end in robot))
    return fit(shown.corners, *DIRECTIONS[view], aspect)


SAMPLING_STEP = 1e-3  #: distance between the points of a tube at which its curvature is sampled [m]
#: Margins of the bounds around the plate, the rail and the straight tubes behind the plate: sideways and below [m].
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
#: If a camera differs from the expected one by at most this much, the user has not moved it (`Camera.distance_to`).
SAME_CAMERA = 0.01
#: Differences from the best camera that start a movement of the camera: while one path is drawn, and for a new path.
REFRAME, REFRAME_NEW_PATH = 0.15, 0.03
#: Duration of a movement of the camera [s].
MOVEMENT_S = 0.8
#: Number of commanded cameras that a page may still report, and number of pages whose last camera is kept.
COMMANDED_CAMERAS, KEPT_PAGES = 60, 32


class _Page:
    """Camera of one page; while it follows what is drawn, also its movement to the best camera."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self.client = client
        self.following = False
        self.commanded: deque[Camera] = deque(maxlen=COMMANDED_CAMERAS)
        self.path: Array | None = None  #: drawn path for which the picture was framed
        self.movement: tuple[Camera, Camera, float] | None = None  #: first camera, last camera, start time [s]

    def expects(self, camera: Camera) -> bool:
        """Return whether the page may report this camera although the user has not moved it."""
        return any(one.distance_to(camera) < SAME_CAMERA for one in self.commanded)


class Cameras:
    """Camera of each page: named views, and the view that follows what is drawn until the user moves the camera."""

    def __init__(
        self, server: viser.ViserServer, extent: ViewBounds, unit: float, drawn: Callable[[], SceneContent]
    ) -> None:
        """`extent`: bounds of the robot that the fixed views show; `drawn` returns the content of the last picture."""
        self._server, self._extent, self._unit, self._drawn = server, extent, unit, drawn
        self._path = NO_POINTS  # the last path that was drawn
        self._lock = threading.Lock()
        self._pages: dict[str, _Page] = {}
        self._last: OrderedDict[str, Camera] = OrderedDict()  # last cameras of disconnected pages that followed
        server.scene.set_up_direction("-x")
        first = camera(FOLLOWING_VIEW, extent, np.zeros(3), DEFAULT_ASPECT)
        initial = server.initial_camera
        initial.fov, initial.position, initial.look_at = FIELD_OF_VIEW_RAD, unit * first.eye, unit * first.centre
        initial.near, initial.far = 0.01 * unit, 10.0 * unit

        # viser calls this function in its own thread when a page connects.
        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            page, who = _Page(client), self._who(client)
            with self._lock:
                self._pages[who] = page
                last = self._last.pop(who, None)

            # A page follows if its camera has the initial position, or after a reconnection the last one that was set.
            # The user may have chosen any other camera, so it is not changed.
            async def moved(_: viser.CameraHandle) -> None:
                now = self._reported(client)
                with self._lock:
                    if page.following and not page.expects(now):
                        page.following, page.movement = False, None
                    if page.commanded or all(
                        one is None or one.distance_to(now) > SAME_CAMERA for one in (first, last)
                    ):
                        return
                self._show(page, FOLLOWING_VIEW)

            client.camera.on_update(moved)
            await moved(client.camera)

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            with self._lock:
                for who in [who for who, page in self._pages.items() if page.client is client]:
                    page = self._pages.pop(who)
                    if page.following:
                        self._last[who] = page.commanded[-1]
                while len(self._last) > KEPT_PAGES:
                    self._last.popitem(last=False)

    def set_view(self, who: str, view: str) -> bool:
        """Set the camera of page `who` to a view; return whether the page is connected and the view is known."""
        with self._lock:
            page = self._pages.get(who)
        if page is None or view not in VIEWS:
            return False
        self._path = NO_POINTS  # after a choice, only a path that is drawn now turns the view
        self._show(page, view)
        return True

    def follow(self, *, reframe: bool) -> None:
        """Move the cameras that follow what is drawn, once per picture. `reframe`: also check whether they show it."""
        with self._lock:
            pages = [page for page in self._pages.values() if page.following]
        for page in pages:
            if page.movement is None and reframe:
                self._start_movement(page)
            if page.movement is not None:
                self._move(page)

    def _start_movement(self, page: _Page) -> None:
        path = self._drawn().path
        now, best = page.commanded[-1], self._camera(FOLLOWING_VIEW, page.client.camera.aspect)
        threshold = REFRAME if path is page.path or not len(path) else REFRAME_NEW_PATH
        page.path = path
        if now.distance_to(best) > threshold:
            with self._lock:
                page.movement = (now, best, time.monotonic())

    def _move(self, page: _Page) -> None:
        with self._lock:
            if page.movement is None or not page.following:
                return
            first, last, start = page.movement
            share = min((time.monotonic() - start) / MOVEMENT_S, 1.0)
            if share == 1.0:
                page.movement = None
            self._set_camera(page, first.toward(last, share**2 * (3.0 - 2.0 * share)))

    def _show(self, page: _Page, view: str) -> None:
        target = self._camera(view, page.client.camera.aspect)
        with self._lock:
            page.following, page.movement, page.path = view == FOLLOWING_VIEW, None, self._drawn().path
            self._set_camera(page, target)

    def _camera(self, view: str, aspect: float) -> Camera:
        drawn = self._drawn()
        if view == FOLLOWING_VIEW and len(drawn.robot):
            if len(drawn.path):
                self._path = drawn.path  # the view stays after the motion
            return fit_next_to_close_up(drawn.framed, *DIRECTIONS[view], aspect, self._path)
        return camera(view, self._extent, self._extent.middle if drawn.tip is None else drawn.tip, aspect)

    def _reported(self, client: viser.ClientHandle) -> Camera:
        position, look_at, up = client.camera.position, client.camera.look_at, client.camera.up_direction
        return Camera(np.array(position) / self._unit, np.array(look_at) / self._unit, np.array(up))

    def _set_camera(self, page: _Page, target: Camera) -> None:
        page.commanded.append(target)
        camera = page.client.camera
        with page.client.atomic():
            camera.up_direction = target.up
            camera.position = self._unit * target.eye
            camera.look_at = self._unit * target.centre

    def _who(self, client: viser.ClientHandle) -> str:
        """Return the page's identity, which the proxy adds to the address that viser receives."""
        socket = self._server._websock_server._live_connections[client.client_id]
        query = "" if socket.request is None else urlsplit(socket.request.path).query
        return parse_qs(query).get(CLIENT_PARAMETER, [""])[0]
