"""Two grids around the robot's reach in the scene, a floor and a wall, labelled in millimetres."""

from typing import Literal, NamedTuple

import numpy as np
import viser

from core.robot.robot import Array
from web.scene.cameras import ViewBounds

#: Named end points of the strokes in a cell of width 1 and height 2, as in a seven-segment display.
_AT = {
    "a": (0.0, 2.0), "b": (1.0, 2.0), "c": (0.0, 1.0), "d": (1.0, 1.0), "e": (0.0, 0.0), "f": (1.0, 0.0),
    "g": (0.5, 0.4), "h": (0.5, 1.0), "i": (0.5, 0.0),
}  # fmt: skip
_GLYPHS: dict[str, tuple[str, ...]] = {
    "0": ("abfea",), "1": ("bf",), "2": ("abdcef",), "3": ("abfe", "cd"), "4": ("acd", "bf"), "5": ("bacdfe",),
    "6": ("baefdc",), "7": ("abf",), "8": ("abfea", "cd"), "9": ("dcabfe",), "-": ("cd",),
    "x": ("cf", "de"), "y": ("cg", "de"), "z": ("cdef",), "m": ("ecdf", "hi"), " ": (),
}  # fmt: skip
#: Distance between the left edges of two neighbouring characters, in character widths.
_STEP = 1.6


def strokes(text: str, middle: Array, right: Array, up: Array, height: float) -> Array:
    """Return the segments (k, 2, 3) [m] of a line of text.

    Args:
        text: text of digits, minus, x, y, z, m and spaces.
        middle: centre of the text (3,) [m].
        right, up: directions of the text's line and of its height, unit vectors (3,).
        height: height of a digit [m].
    """
    size = 0.5 * height
    start = -0.5 * (_STEP * (len(text) - 1) + 1.0)
    segments: list[Array] = []
    for number, letter in enumerate(text):
        for line in _GLYPHS[letter]:
            across, above = np.array([_AT[corner] for corner in line]).T[..., None]
            points = middle + size * ((start + _STEP * number + across) * right + (above - 1.0) * up)
            segments.append(np.stack((points[:-1], points[1:]), axis=1))
    return np.concatenate(segments) if segments else np.empty((0, 2, 3))


FINE_SPACING_M, COARSE_SPACING_M = 0.01, 0.05  # [m]
#: Colours of the lines and of the numbers: medium greys, visible on light and dark pages.
GREY, INK = (128, 134, 140), (128, 137, 146)
#: Approximate opacity of the grid's lines at the distance of the camera's first position.
OPACITY = 0.17
#: Height of a number, and its distance from the grid's edge, as parts of the longest edge.
LABEL_HEIGHT, LABEL_DISTANCE = 0.018, 0.026


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
    """Draw grid lines every 10 mm and 50 mm, and numbers in mm; `distance`: the camera's first distance [m]."""
    middle, size = 0.5 * (grid.lower + grid.upper), grid.upper - grid.lower
    planes: tuple[tuple[str, Literal["yz", "xz"], float, tuple[float, float, float]], ...] = (
        ("floor", "yz", size[1], (grid.upper[0], middle[1], middle[2])),
        ("wall", "xz", size[0], (middle[0], grid.upper[1], middle[2])),
    )
    far = 1e3 * unit * distance
    for name, plane, width, position in planes:
        scene.add_grid(
            f"/grid/{name}", width=unit * width, height=unit * size[2], plane=plane,
            cell_size=unit * FINE_SPACING_M, cell_color=GREY, cell_thickness=0.8,
            section_size=unit * COARSE_SPACING_M, section_color=GREY, section_thickness=1.1,
            # viser's lines become translucent only by fading with distance.
            fade_distance=far, fade_strength=-1e3 * np.log(OPACITY), fade_from="camera",
            shadow_opacity=0.12, position=tuple(unit * np.array(position)),
        )  # fmt: skip
    scene.add_line_segments(
        "/grid/numbers", np.concatenate(list(_numbers(grid))).astype(np.float32), INK,
        thickness=1.4, thickness_units="screen", scale=unit,
    )  # fmt: skip


def _numbers(grid: Grid) -> list[Array]:
    """Return the strokes of the labels, at edges that the robot seldom reaches: z above, x left, y in front."""
    x, y, z = np.eye(3)
    (x0, y0, z0), (x1, y1, z1) = grid.lower, grid.upper
    longest = float(np.max(grid.upper - grid.lower))
    height, gap = LABEL_HEIGHT * longest, LABEL_DISTANCE * longest
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
    return COARSE_SPACING_M * np.arange(
        round(first / COARSE_SPACING_M), round(last / COARSE_SPACING_M) + 1, dtype=float
    )
