"""Handles that an operator drags in the scene: a target for the tip, and the force on the simulated tip."""

import threading
import time

import numpy as np
import viser
from viser.transforms import SO3

from core.robot.robot import Array
from web.scene.messages import Box

#: Names by which the gate knows them.
TARGET, FORCE = "/handle/target", "/handle/force"
#: Length of their arrows [m].
TARGET_SIZE, FORCE_SIZE = 0.035, 0.025
#: Where they may be dragged [m].
LOWER, UPPER = (-0.25, -0.25, -0.05), (0.25, 0.25, 0.40)
#: The force that a hand may pull with [N].
MOST_FORCE = 0.5
#: After a drag the handle is the operator's for this time, then it follows the arrow again [s].
HELD = 0.5


def boxes(unit: float) -> dict[str, Box]:
    """How far each may be dragged, scene units."""

    def scaled(place: tuple[float, float, float]) -> tuple[float, float, float]:
        return (unit * place[0], unit * place[1], unit * place[2])

    return dict.fromkeys((TARGET, FORCE), Box(scaled(LOWER), scaled(UPPER)))


class Gizmo:
    """One handle with arrows of `size` [m]; what is dragged is read by another thread."""

    def __init__(self, scene: viser.SceneApi, name: str, unit: float, size: float, *, turns: bool = False) -> None:
        """One that `turns` has rings, too, and its z axis is a direction."""
        self._unit = unit
        self._handle = scene.add_transform_controls(
            name, scale=unit * size, disable_rotations=not turns, depth_test=False, visible=False
        )
        self._lock = threading.Lock()
        self._place, self._direction = np.zeros(3), np.array([0.0, 0.0, 1.0])
        self._dragged = -np.inf
        self._fresh = False

        # On viser's own thread: no more than taking the place down.
        async def moved(event: viser.TransformControlsEvent) -> None:
            with self._lock:
                self._place = np.array(event.target.position) / unit
                if turns:
                    self._direction = SO3(np.array(event.target.wxyz)).as_matrix()[:, 2]
                self._dragged, self._fresh = time.monotonic(), True

        self._handle.on_update(moved)

    def show(self, visible: bool) -> None:
        """Have it there or not."""
        self._handle.visible = visible

    def put(self, place: Array, direction: Array | None = None) -> None:
        """Move it to (3,) [m], and turn it to a unit vector (3,), unless somebody has it in hand."""
        with self._lock:
            if time.monotonic() - self._dragged < HELD:
                return
            self._place = place
            if direction is not None:
                self._direction = direction
        self._handle.position = self._unit * place
        if direction is not None:
            self._handle.wxyz = along(direction)

    @property
    def place(self) -> Array:
        """Where it is (3,) [m]."""
        with self._lock:
            return self._place.copy()

    @property
    def direction(self) -> Array:
        """Of its z axis, unit vector (3,)."""
        with self._lock:
            return self._direction.copy()

    def taken(self) -> Array | None:
        """Where it was dragged to since the last look (3,) [m]; None when nobody did."""
        with self._lock:
            fresh, self._fresh = self._fresh, False
            return self._place.copy() if fresh else None


def along(direction: Array) -> Array:
    """Quaternion w, x, y, z of the shortest turn from z to a unit vector (3,)."""
    x, y, z = direction
    numbers = np.array([1.0 + z, -y, x, 0.0])
    length = float(np.linalg.norm(numbers))
    return numbers / length if length > 1e-6 else np.array([0.0, 1.0, 0.0, 0.0])


def pull(place: Array, tip: Array, arrow: float) -> Array:
    """Force (3,) [N] of a handle at `place` (3,) [m] whose arrow has `arrow` [m/N], from `tip` (3,) [m]; bounded."""
    force = (place - tip) / arrow
    size = float(np.linalg.norm(force))
    return force if size <= MOST_FORCE else force * (MOST_FORCE / size)
