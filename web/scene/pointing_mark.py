"""Where the tip points and where it should, in the scene: two arrows at the tip."""

import numpy as np
import viser

from core.robot.robot import Array
from station.config import palette

#: Of an arrow [m].
LENGTH = 0.030


class PointingMark:
    """Handles of what shows directions."""

    def __init__(self, scene: viser.SceneApi, unit: float) -> None:
        def arrow(name: str, colour: palette.Colour, thickness: float) -> viser.ArrowsHandle:
            return scene.add_arrows(
                f"/pointing/{name}", np.zeros((1, 2, 3)), colour, shaft_radius=thickness, head_radius=2.5 * thickness,
                head_length=0.008, scale=unit, visible=False,
            )  # fmt: skip

        # The wider one is seen around the other where both agree.
        self._desired = arrow("desired", palette.DESIRED, 1.1e-3)
        self._observed = arrow("observed", palette.ESTIMATED, 0.7e-3)

    def draw(self, tip: Array | None, observed: Array | None, desired: Array | None) -> None:
        """Arrows from `tip` (3,) [m] along directions (3,); None: not that one."""
        for arrow, direction in ((self._observed, observed), (self._desired, desired)):
            arrow.visible = tip is not None and direction is not None
            if tip is not None and direction is not None:
                arrow.points = np.array([[tip, tip + LENGTH * direction]], dtype=np.float32)
