"""What stands still around the robot: front plate, guide, rail, the carriages behind, and the grid."""

from typing import Literal

import numpy as np
import viser

from core.robot.robot import Array, Robot
from station.config import palette

Place = tuple[float, float, float]

METAL: palette.Colour = (206, 211, 217)
DARK: palette.Colour = (120, 128, 138)
INK: palette.Colour = (70, 76, 84)

#: Planes of the grid [m]: the floor lies at x, the wall stands at y; both reach from z to z.
FLOOR_X, WALL_Y = 0.10, 0.05
X, Y, Z = (-0.10, 0.10), (-0.15, 0.05), (-0.15, 0.25)
FINE, COARSE = 0.01, 0.05  # viser draws lines from a plane's middle on, which must lie on a coarse one


class Stage:
    """Plate and guide, and one carriage for every tube that slides."""

    def __init__(self, scene: viser.SceneApi, robot: Robot, unit: float) -> None:
        self._unit = unit

        def box(name: str, low: Place, high: Place, colour: palette.Colour) -> None:
            a, b = unit * np.array(low), unit * np.array(high)
            scene.add_box(f"/bench/{name}", color=colour, dimensions=tuple(b - a), position=tuple((a + b) / 2))

        box("plate", (-0.022, -0.022, -0.004), (0.026, 0.022, 0.0), METAL)
        box("guide", (-0.008, -0.008, -0.030), (0.008, 0.008, -0.004), DARK)
        box("rail", (0.018, -0.010, -0.140), (0.026, 0.010, -0.004), METAL)
        sliding = {joint.tube for joint in robot.joints if joint.motion == "translation"}
        self._carriages = {
            tube: scene.add_box(
                f"/bench/carriage_{robot.tubes[tube].name}", color=DARK,
                dimensions=tuple(unit * np.array((0.026, 0.018, 0.012))),
                position=tuple(unit * np.array((0.005, 0.0, -0.1))),
            )
            for tube in sorted(sliding)
        }  # fmt: skip

    def move(self, beta: Array) -> None:
        """Put the carriages where the tubes' proximal ends `beta` (q,) [m] are."""
        for tube, carriage in self._carriages.items():
            carriage.position = self._unit * np.array((0.005, 0.0, beta[tube]))


def draw_grid(scene: viser.SceneApi, unit: float) -> None:
    """Lines every 10 mm and 50 mm on a floor and a wall, with numbers in millimetres."""
    # Thin and neither light nor dark: the page's background may be both.
    fine, coarse = (178, 184, 191), (138, 147, 156)
    middle = {"x": sum(X) / 2, "y": sum(Y) / 2, "z": sum(Z) / 2}
    planes: tuple[tuple[str, Literal["yz", "xz"], float, float, Place], ...] = (
        ("floor", "yz", Y[1] - Y[0], Z[1] - Z[0], (FLOOR_X, middle["y"], middle["z"])),
        ("wall", "xz", X[1] - X[0], Z[1] - Z[0], (middle["x"], WALL_Y, middle["z"])),
    )
    for name, plane, width, height, position in planes:
        scene.add_grid(
            f"/grid/{name}", width=unit * width, height=unit * height, plane=plane,
            cell_size=unit * FINE, cell_color=fine, cell_thickness=0.45,
            section_size=unit * COARSE, section_color=coarse, section_thickness=0.7,
            fade_distance=1e3, shadow_opacity=0.15, position=tuple(unit * np.array(position)),
        )  # fmt: skip

    def label(name: str, text: str, x: float, y: float, z: float) -> None:
        scene.add_label(
            f"/grid/{name}", text, position=(unit * x, unit * y, unit * z), anchor="center-center",
            font_screen_scale=0.85,
        )  # fmt: skip

    # Along edges, where the robot seldom comes: z over the wall, x at its left, y at the floor's right.
    for z in _ticks(Z):
        label(f"z/{z:+.2f}", f"{1e3 * z:.0f}", X[0] - 0.007, WALL_Y, z)
    for x in _ticks(X)[1:]:
        label(f"x/{x:+.2f}", f"{1e3 * x:.0f}", x, WALL_Y, Z[0] - 0.010)
    for y in _ticks(Y)[:-1]:
        label(f"y/{y:+.2f}", f"{1e3 * y:.0f}", FLOOR_X, y, Z[1] - 0.012)
    label("z/title", "z [mm]", X[0] - 0.007, WALL_Y, 0.025)
    label("x/title", "x [mm]", -0.025, WALL_Y, Z[0] - 0.014)
    label("y/title", "y [mm]", FLOOR_X, 0.025, Z[1] - 0.012)


def _ticks(ends: tuple[float, float]) -> np.ndarray:
    return np.arange(round(ends[0] / COARSE), round(ends[1] / COARSE) + 1) * COARSE
