"""The robot's stages in the scene, scaled to the robot: front plate, guide, rail and carriages."""

import numpy as np
import viser
from viser.transforms import SO3

from core.robot.robot import Array, Robot
from station.config import palette

Point = tuple[float, float, float]

METAL_COLOUR: palette.Colour = (206, 211, 217)
DARK_COLOUR: palette.Colour = (120, 128, 138)
#: Length of the rail behind the rearmost position of a carriage [m].
RAIL_OVERHANG_M = 0.02


class StageMesh:
    """Scene objects of plate, guide, rail, and one carriage for each sliding tube, in the plate's frame."""

    def __init__(self, scene: viser.SceneApi, robot: Robot, rear: float, unit: float) -> None:
        """`rear`: rearmost position of any tube's proximal end along the plate's z axis [m], never positive."""
        self._unit = unit
        base = robot.base
        scene.add_frame(
            "/bench", show_axes=False, wxyz=SO3.from_matrix(base.rotation).wxyz, position=unit * np.array(base.position)
        )

        def box(name: str, low: Point, high: Point, colour: palette.Colour) -> None:
            a, b = unit * np.array(low), unit * np.array(high)
            scene.add_box(f"/bench/{name}", color=colour, dimensions=tuple(b - a), position=tuple((a + b) / 2))

        box("plate", (-0.022, -0.022, -0.004), (0.026, 0.022, 0.0), METAL_COLOUR)
        box("guide", (-0.008, -0.008, -0.030), (0.008, 0.008, -0.004), DARK_COLOUR)
        box("rail", (0.018, -0.010, rear - RAIL_OVERHANG_M), (0.026, 0.010, -0.004), METAL_COLOUR)
        sliding = {joint.tube for joint in robot.joints if joint.motion == "translation"}
        self._carriages = {
            tube: scene.add_box(
                f"/bench/carriage_{robot.tubes[tube].name}", color=DARK_COLOUR,
                dimensions=tuple(unit * np.array((0.026, 0.018, 0.012))),
                position=tuple(unit * np.array((0.005, 0.0, rear))),
            )
            for tube in sorted(sliding)
        }  # fmt: skip

    def move(self, beta: Array) -> None:
        """Move the carriages to the tubes' proximal ends `beta` (q,) [m]."""
        for tube, carriage in self._carriages.items():
            carriage.position = self._unit * np.array((0.005, 0.0, beta[tube]))
