"""Two grids around the robot's reach in the scene: a floor that shows shadows, and a wall."""

from typing import Literal, NamedTuple

import numpy as np
import viser

from core.robot.robot import Array
from web.scene.cameras import ViewBounds

#: Distances of the fine and of the coarse lines [m].
FINE_SPACING_M, COARSE_SPACING_M = 0.025, 0.05
#: Colour of the lines: a medium grey, visible on light and dark pages.
GREY = (128, 134, 140)
#: Approximate opacity of the grid's lines at the distance of the camera's first position, and of shadows on the planes.
OPACITY, FLOOR_SHADOW, WALL_SHADOW = 0.15, 0.3, 0.0


class Grid(NamedTuple):
    """Bounds of the two grids. The floor is the plane at the largest x, the wall the plane at the largest y."""

    lower: Array  #: smallest coordinates (3,) [m]
    upper: Array  #: largest coordinates (3,) [m]

    @staticmethod
    def around(robot: ViewBounds) -> "Grid":
        """Return bounds around a robot in multiples of twice the coarse spacing, with a coarse line in the middle."""
        lower = 2.0 * COARSE_SPACING_M * np.floor(robot.lower / (2.0 * COARSE_SPACING_M) + 0.1)
        upper = 2.0 * COARSE_SPACING_M * np.ceil(robot.upper / (2.0 * COARSE_SPACING_M) - 0.1)
        return Grid(lower, np.maximum(upper, lower + 2.0 * COARSE_SPACING_M))


def draw_grid(scene: viser.SceneApi, grid: Grid, distance: float, unit: float) -> None:
    """Draw grid lines every 25 mm and 50 mm; `distance`: initial distance of the camera [m]."""
    middle, size = 0.5 * (grid.lower + grid.upper), grid.upper - grid.lower
    planes: tuple[tuple[str, Literal["yz", "xz"], float, tuple[float, float, float], float], ...] = (
        ("floor", "yz", size[1], (grid.upper[0], middle[1], middle[2]), FLOOR_SHADOW),
        ("wall", "xz", size[0], (middle[0], grid.upper[1], middle[2]), WALL_SHADOW),
    )
    far = 1e3 * unit * distance
    for name, plane, width, position, shadow in planes:
        scene.add_grid(
            f"/grid/{name}", width=unit * width, height=unit * size[2], plane=plane,
            cell_size=unit * FINE_SPACING_M, cell_color=GREY, cell_thickness=0.8,
            section_size=unit * COARSE_SPACING_M, section_color=GREY, section_thickness=1.1,
            # viser's lines become translucent only by fading with distance.
            fade_distance=far, fade_strength=-1e3 * np.log(OPACITY), fade_from="camera",
            shadow_opacity=shadow, position=tuple(unit * np.array(position)),
        )  # fmt: skip
