"""A moving target in the scene, and the line from it to the desired tip."""

import numpy as np
import viser

from core.robot.robot import Array
from station.config import palette

#: Radius of the target's marker [m].
MARK_RADIUS_M = 3.4e-3


class TargetMark:
    """Scene objects that show a moving target and the tip's desired offset from it."""

    def __init__(self, scene: viser.SceneApi, unit: float) -> None:
        self._unit = unit
        self._marker = scene.add_icosphere(
            "/target/place", radius=MARK_RADIUS_M * unit, color=palette.TARGET, cast_shadow=False, visible=False
        )
        self._line = scene.add_line_segments(
            "/target/offset", np.zeros((1, 2, 3)), palette.STEEL, thickness=2.5, thickness_units="screen",
            scale=unit, visible=False,
        )  # fmt: skip

    def draw(self, position: Array | None, offset: Array | None) -> None:
        """Draw the target and the line to the desired tip.

        Args:
            position: position of the target (3,) [m]; None hides the target.
            offset: desired position of the tip relative to the target (3,) [m]; None hides the line.
        """
        self._marker.visible = position is not None
        self._line.visible = position is not None and offset is not None
        if position is None:
            return
        self._marker.position = self._unit * position
        if offset is not None:
            self._line.points = np.array([[position, position + offset]], dtype=np.float32)
