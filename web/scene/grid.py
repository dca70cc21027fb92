"""A floor and a wall of millimetre paper around what the robot reaches."""

from typing import Literal, NamedTuple

import numpy as np
import viser

from core.robot.robot import Array
from web.scene.lettering import strokes
from web.scene.views import Bounds

FINE, COARSE = 0.01, 0.05  # [m]
#: Neither light nor dark, since the page may be both.
GREY, INK = (128, 134, 140), (128, 137, 146)
#: About as much of the lines is seen where the camera stands at first.
STRENGTH = 0.17
#: Height of a number, and from the grid's edge to its middle, as parts of the longest edge.
LETTER, GAP = 0.018, 0.026


class Grid(NamedTuple):
    """The floor lies at its upper x, the wall stands at its upper y."""

    lower: Array  #: (3,) [m]
    upper: Array  #: (3,) [m]

    @staticmethod
    def around(robot: Bounds) -> "Grid":
        """Ends on coarse lines, with one of them in every middle: viser draws from there on."""
        lower = 2.0 * COARSE * np.floor(robot.lower / (2.0 * COARSE) + 0.1)
        upper = 2.0 * COARSE * np.ceil(robot.upper / (2.0 * COARSE) - 0.1)
        return Grid(lower, np.maximum(upper, lower + 2.0 * COARSE))


def draw_grid(scene: viser.SceneApi, grid: Grid, distance: float, unit: float) -> None:
    """Lines every 10 mm and 50 mm, numbers in millimetres; `distance` of the camera at first [m]."""
    middle, size = 0.5 * (grid.lower + grid.upper), grid.upper - grid.lower
    planes: tuple[tuple[str, Literal["yz", "xz"], float, tuple[float, float, float]], ...] = (
        ("floor", "yz", size[1], (grid.upper[0], middle[1], middle[2])),
        ("wall", "xz", size[0], (middle[0], grid.upper[1], middle[2])),
    )
    far = 1e3 * unit * distance
    for name, plane, width, position in planes:
        scene.add_grid(
            f"/grid/{name}", width=unit * width, height=unit * size[2], plane=plane,
            cell_size=unit * FINE, cell_color=GREY, cell_thickness=0.8,
            section_size=unit * COARSE, section_color=GREY, section_thickness=1.1,
            # Fading with the distance is the one way in which viser's lines can be translucent.
            fade_distance=far, fade_strength=-1e3 * np.log(STRENGTH), fade_from="camera",
            shadow_opacity=0.12, position=tuple(unit * np.array(position)),
        )  # fmt: skip
    scene.add_line_segments(
        "/grid/numbers", np.concatenate(list(_numbers(grid))).astype(np.float32), INK,
        thickness=1.4, thickness_units="screen", scale=unit,
    )  # fmt: skip


def _numbers(grid: Grid) -> list[Array]:
    """Along edges, where the robot seldom comes: z over the wall, x at its left, y at the floor's front."""
    x, y, z = np.eye(3)
    (x0, y0, z0), (x1, y1, z1) = grid.lower, grid.upper
    longest = float(np.max(grid.upper - grid.lower))
    height, gap = LETTER * longest, GAP * longest
    along_z = [(f"{1e3 * at:.0f}", (x0 - gap, y1, at), z, -x) for at in _ticks(z0, z1)]
    along_x = [(f"{1e3 * at:.0f}", (at, y1, z0 - 1.5 * gap), z, -x) for at in _ticks(x0, x1)]
    along_y = [(f"{1e3 * at:.0f}", (x1, at, z1 + 1.5 * gap), z, y) for at in _ticks(y0, y1)[:-1]]
    titles = [
        ("z mm", (x0 - 2.4 * gap, y1, 0.5 * (z0 + z1)), z, -x),
        ("x mm", (0.5 * (x0 + x1), y1, z0 - 4.4 * gap), z, -x),
        ("y mm", (x1, 0.5 * (y0 + y1), z1 + 4.4 * gap), z, y),
    ]
    return [
        strokes(text, np.array(middle), right, up, height)
        for text, middle, right, up in (*along_z, *along_x, *along_y, *titles)
    ]


def _ticks(first: float, last: float) -> Array:
    return COARSE * np.arange(round(first / COARSE), round(last / COARSE) + 1, dtype=float)
