"""What stands still around the robot, as large as it needs: front plate, guide, rail, the carriages behind."""

import numpy as np
import viser
from viser.transforms import SO3

from core.robot.robot import Array, Robot
from station.config import palette

Place = tuple[float, float, float]

METAL: palette.Colour = (206, 211, 217)
DARK: palette.Colour = (120, 128, 138)
#: The rail goes on behind the last place of a carriage [m].
BEYOND = 0.02


class Stage:
    """Plate and guide, and one carriage for every tube that slides; in the plate's frame."""

    def __init__(self, scene: viser.SceneApi, robot: Robot, rear: float, unit: float) -> None:
        """`rear` is the hindmost place of a tube's proximal end along the plate's z [m], never positive."""
        self._unit = unit
        base = robot.base
        scene.add_frame(
            "/bench", show_axes=False, wxyz=SO3.from_matrix(base.rotation).wxyz, position=unit * np.array(base.position)
        )

        def box(name: str, low: Place, high: Place, colour: palette.Colour) -> None:
            a, b = unit * np.array(low), unit * np.array(high)
            scene.add_box(f"/bench/{name}", color=colour, dimensions=tuple(b - a), position=tuple((a + b) / 2))

        box("plate", (-0.022, -0.022, -0.004), (0.026, 0.022, 0.0), METAL)
        box("guide", (-0.008, -0.008, -0.030), (0.008, 0.008, -0.004), DARK)
        box("rail", (0.018, -0.010, rear - BEYOND), (0.026, 0.010, -0.004), METAL)
        sliding = {joint.tube for joint in robot.joints if joint.motion == "translation"}
        self._carriages = {
            tube: scene.add_box(
                f"/bench/carriage_{robot.tubes[tube].name}", color=DARK,
                dimensions=tuple(unit * np.array((0.026, 0.018, 0.012))),
                position=tuple(unit * np.array((0.005, 0.0, rear))),
            )
            for tube in sorted(sliding)
        }  # fmt: skip

    def move(self, beta: Array) -> None:
        """Put the carriages where the tubes' proximal ends `beta` (q,) [m] are."""
        for tube, carriage in self._carriages.items():
            carriage.position = self._unit * np.array((0.005, 0.0, beta[tube]))
