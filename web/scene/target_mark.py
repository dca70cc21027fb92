"""A target that moves, in the scene, and the line from it to where the tip should be beside it."""

import numpy as np
import viser

from core.robot.robot import Array
from station.config import palette

#: Larger than a tip's mark, so that a tip on it is seen [m].
RADIUS = 3.4e-3


class TargetMark:
    """Handles of what shows a target."""

    def __init__(self, scene: viser.SceneApi, unit: float) -> None:
        self._unit = unit
        self._marker = scene.add_icosphere(
            "/target/place", radius=RADIUS * unit, color=palette.TARGET, cast_shadow=False, visible=False
        )
        self._line = scene.add_line_segments(
            "/target/offset", np.zeros((1, 2, 3)), palette.STEEL, thickness=2.5, thickness_units="screen",
            scale=unit, visible=False,
        )  # fmt: skip

    def draw(self, place: Array | None, offset: Array | None) -> None:
        """Show it at `place` (3,) [m], None: not at all; a run that follows it keeps the tip at `offset` from it."""
        self._marker.visible = place is not None
        self._line.visible = place is not None and offset is not None
        if place is None:
            return
        self._marker.position = self._unit * place
        if offset is not None:
            self._line.points = np.array([[place, place + offset]], dtype=np.float32)
