"""Two arrows at the tip in the scene: the measured and the desired direction of the tip."""

import numpy as np
import viser

from core.robot.robot import Array
from station.config import palette

#: Length of each direction arrow [m].
ARROW_LENGTH_M = 0.030


class PointingMark:
    """Scene objects that show the measured and the desired direction of the tip."""

    def __init__(self, scene: viser.SceneApi, unit: float) -> None:
        def arrow(name: str, colour: palette.Colour, thickness: float) -> viser.ArrowsHandle:
            return scene.add_arrows(
                f"/pointing/{name}", np.zeros((1, 2, 3)), colour, shaft_radius=thickness, head_radius=2.5 * thickness,
                head_length=0.008, scale=unit, visible=False,
            )  # fmt: skip

        # The arrow of the desired direction is wider, so that it stays visible where it coincides with the other arrow.
        self._desired = arrow("desired", palette.DESIRED, 1.1e-3)
        self._observed = arrow("observed", palette.ESTIMATED, 0.7e-3)

    def draw(self, tip: Array | None, observed: Array | None, desired: Array | None) -> None:
        """Draw arrows from `tip` (3,) [m] along the directions (3,); an arrow whose direction is None is hidden."""
        for arrow, direction in ((self._observed, observed), (self._desired, desired)):
            arrow.visible = tip is not None and direction is not None
            if tip is not None and direction is not None:
                arrow.points = np.array([[tip, tip + ARROW_LENGTH_M * direction]], dtype=np.float32)
