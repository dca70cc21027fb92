"""Handles that an operator drags in the scene: a target for the tip, and the force on the simulated tip."""

import threading
import time

import numpy as np
import viser

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

    def __init__(self, scene: viser.SceneApi, name: str, unit: float, size: float) -> None:
        self._unit = unit
        self._handle = scene.add_transform_controls(
            name, scale=unit * size, disable_rotations=True, depth_test=False, visible=False
        )
        self._lock = threading.Lock()
        self._place = np.zeros(3)
        self._dragged = -np.inf
        self._fresh = False

        # On viser's own thread: no more than taking the place down.
        async def moved(event: viser.TransformControlsEvent) -> None:
            with self._lock:
                self._place = np.array(event.target.position) / unit
                self._dragged, self._fresh = time.monotonic(), True

        self._handle.on_update(moved)

    def show(self, visible: bool) -> None:
        """Have it there or not."""
        self._handle.visible = visible

    def put(self, place: Array) -> None:
        """Move it to (3,) [m], unless somebody has it in hand."""
        with self._lock:
            if time.monotonic() - self._dragged < HELD:
                return
            self._place = place
        self._handle.position = self._unit * place

    @property
    def place(self) -> Array:
        """Where it is (3,) [m]."""
        with self._lock:
            return self._place.copy()

    def taken(self) -> Array | None:
        """Where it was dragged to since the last look (3,) [m]; None when nobody did."""
        with self._lock:
            fresh, self._fresh = self._fresh, False
            return self._place.copy() if fresh else None


def pull(place: Array, tip: Array, arrow: float) -> Array:
    """Force (3,) [N] of a handle at `place` (3,) [m] whose arrow has `arrow` [m/N], from `tip` (3,) [m]; bounded."""
    force = (place - tip) / arrow
    size = float(np.linalg.norm(force))
    return force if size <= MOST_FORCE else force * (MOST_FORCE / size)
