"""Difference between the measured tip and the model's tip, and its mark in the scene."""

import numpy as np
import viser

from core.robot.robot import Array
from station.config import palette
from web.scene.robot_mesh import centre_line

#: Weight of a new difference in the smoothed one, at 30 pictures a second; noise must not shake the drawn tubes.
SMOOTHING = 0.15
#: Differences at which the model's end appears and disappears [m].
SHOW_ERROR_M, HIDE_ERROR_M = 1.0e-3, 0.8e-3
#: Largest difference by which the drawn tubes are bent [m]; beyond it the measured point is not this robot's tip.
MAX_BEND_M = 0.03
#: Length of the drawn end of the model [m], and number of its dashes.
END_M, DASHES = 0.06, 12


class TipOffset:
    """Smoothed displacement from the model's tip to the measured tip."""

    def __init__(self) -> None:
        self._offset: Array | None = None
        self.marked = False  #: whether the difference is large enough to be marked

    def update(self, offset: Array | None) -> Array:
        """Add a measured displacement (3,) [m]; None: the tip is not measured. Return the one to draw (3,) [m]."""
        if offset is None or self._offset is None:
            self._offset = offset
        else:
            self._offset = self._offset + SMOOTHING * (offset - self._offset)
        error = self.error or 0.0
        self.marked = error > (HIDE_ERROR_M if self.marked else SHOW_ERROR_M)
        return np.zeros(3) if self._offset is None or error > MAX_BEND_M else self._offset

    @property
    def error(self) -> float | None:
        """Distance between model and tracker [m]; None: the tip is not measured."""
        return None if self._offset is None else float(np.linalg.norm(self._offset))


class ModelEnd:
    """Dashed end of the model's centre line, while the model misses the measured tip."""

    def __init__(self, scene: viser.SceneApi, unit: float) -> None:
        self._line = scene.add_line_segments(
            "/model/end", np.zeros((DASHES, 2, 3)), palette.ESTIMATED, thickness=2.0, thickness_units="screen",
            scale=unit, visible=False,
        )  # fmt: skip

    def hide(self) -> None:
        """Hide the line."""
        self._line.visible = False

    def draw(self, shape: Array, length: float, offset: TipOffset) -> Array:
        """Show the end of the model's `shape` if it is marked; return its points (k, 3) [m], empty if it is hidden.

        `length` is the arc length of the tip [m].
        """
        self._line.visible = offset.marked
        if not offset.marked:
            return np.empty((0, 3))
        points = centre_line(shape, np.linspace(max(length - END_M, 0.0), length, 2 * DASHES))[0]
        self._line.points = points.reshape(DASHES, 2, 3).astype(np.float32)
        return points
