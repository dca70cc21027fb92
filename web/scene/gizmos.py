"""Handles that the operator drags in the scene: the target of the tip, and the force on the simulated tip."""

import threading
import time

import numpy as np
import viser
from viser.transforms import SO3

from core.robot.robot import Array
from web.scene.proxy import HandleBox

#: Names of the handles in the scene's messages.
TARGET_HANDLE, FORCE_HANDLE = "/handle/target", "/handle/force"
#: Length of the arrows of the target handle and of the force handle [m].
TARGET_SIZE_M, FORCE_SIZE_M = 0.035, 0.025
#: Corners of the box within which handles may be dragged, world frame [m].
LOWER_BOUNDS_M, UPPER_BOUNDS_M = (-0.25, -0.25, -0.05), (0.25, 0.25, 0.40)
#: Largest force that can be set with the force handle [N].
MAX_FORCE_N = 0.5
#: Time after a drag during which a handle keeps its position [s]; afterwards the scene may move the handle again.
RELEASE_DELAY_S = 0.5


def boxes(unit: float) -> dict[str, HandleBox]:
    """Return the box within which each handle may be dragged, by the handle's name [scene units]."""

    def scaled(point: tuple[float, float, float]) -> tuple[float, float, float]:
        return (unit * point[0], unit * point[1], unit * point[2])

    return dict.fromkeys((TARGET_HANDLE, FORCE_HANDLE), HandleBox(scaled(LOWER_BOUNDS_M), scaled(UPPER_BOUNDS_M)))


class Gizmo:
    """A draggable handle with arrows of `size` [m]. viser's thread writes its position; the view's thread reads it."""

    def __init__(self, scene: viser.SceneApi, name: str, unit: float, size: float, *, turns: bool = False) -> None:
        """Add the handle. With `turns` the handle also has rings to turn it, and its z axis shows a direction."""
        self._unit = unit
        self._handle = scene.add_transform_controls(
            name, scale=unit * size, disable_rotations=not turns, depth_test=False, visible=False
        )
        self._lock = threading.Lock()
        self._position, self._direction = np.zeros(3), np.array([0.0, 0.0, 1.0])
        self._dragged = -np.inf
        self._moved = False

        # viser calls this function in its own thread, so it only stores the position.
        async def moved(event: viser.TransformControlsEvent) -> None:
            with self._lock:
                self._position = np.array(event.target.position) / unit
                if turns:
                    self._direction = SO3(np.array(event.target.wxyz)).as_matrix()[:, 2]
                self._dragged, self._moved = time.monotonic(), True

        self._handle.on_update(moved)

    def show(self, visible: bool) -> None:
        """Show or hide the handle."""
        self._handle.visible = visible

    def put(self, position: Array, direction: Array | None = None) -> None:
        """Move the handle to `position` (3,) [m] and turn it to `direction` (3,), unless the operator drags it."""
        with self._lock:
            if time.monotonic() - self._dragged < RELEASE_DELAY_S:
                return
            self._position = position
            if direction is not None:
                self._direction = direction
        self._handle.position = self._unit * position
        if direction is not None:
            self._handle.wxyz = along(direction)

    @property
    def position(self) -> Array:
        """Position of the handle (3,) [m]."""
        with self._lock:
            return self._position.copy()

    @property
    def direction(self) -> Array:
        """Direction of the handle's z axis, unit vector (3,)."""
        with self._lock:
            return self._direction.copy()

    def dragged(self) -> Array | None:
        """Return where the handle was dragged since the last call (3,) [m]; None: it was not dragged."""
        with self._lock:
            moved, self._moved = self._moved, False
            return self._position.copy() if moved else None


def along(direction: Array) -> Array:
    """Return the quaternion (w, x, y, z) of the shortest rotation from the z axis to a unit vector (3,)."""
    x, y, z = direction
    numbers = np.array([1.0 + z, -y, x, 0.0])
    length = float(np.linalg.norm(numbers))
    return numbers / length if length > 1e-6 else np.array([0.0, 1.0, 0.0, 0.0])


def handle_force(position: Array, tip: Array, arrow: float) -> Array:
    """Return the bounded force (3,) [N] that the force handle sets.

    Args:
        position: position of the handle (3,) [m].
        tip: position of the tip (3,) [m].
        arrow: length of the force arrow for each newton [m/N].
    """
    force = (position - tip) / arrow
    size = float(np.linalg.norm(force))
    return force if size <= MAX_FORCE_N else force * (MAX_FORCE_N / size)
