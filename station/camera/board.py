"""The board for the calibration of cameras: a chessboard with a marker in each white square (ChArUco).

The board is a grid of modules, 10 for the side of a square, so that print and simulation are exact.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array
from station.lab.rendering import Picture

#: Squares along the long and the short side, and modules along the side of a square; a marker's side has 7 modules.
COLUMNS, ROWS, MODULES = 7, 5, 10
#: Default side of a square [m]; the board then fits on A4 and on Letter.
SQUARE_M = 0.035
#: Half of the window in which a corner is refined [pixel], and end of the refinement: 30 steps, or one of 0.001 pixels.
REFINED = (5, 5)
REFINEMENT_END = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.001)
#: Length of the line with which the user checks the print [mm].
CHECK_MM = 100
#: Margins of the printed page around the board, and space below it [mm].
MARGIN_MM, FOOT_MM = 12, 18


def charuco(square: float = SQUARE_M) -> cv2.aruco.CharucoBoard:
    """Return OpenCV's model of the board; `square` is the side of its squares [m]."""
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    return cv2.aruco.CharucoBoard((COLUMNS, ROWS), square, 0.7 * square, markers)


def modules() -> NDArray[np.bool_]:
    """Return an array (rows, columns) that is true for the black modules of the board."""
    drawn = np.asarray(charuco().generateImage((COLUMNS * MODULES * 10, ROWS * MODULES * 10), None, 0, 1))
    return drawn[5::10, 5::10] < 128


def board_svg(square: float = SQUARE_M) -> str:
    """Return the board as an SVG page to print in true size; `square` is the side of its squares [m]."""
    side = 1e3 * square / MODULES
    width, height = side * MODULES * COLUMNS, side * MODULES * ROWS
    page = f"{width + 2 * MARGIN_MM:g}", f"{height + 2 * MARGIN_MM + FOOT_MM:g}"
    cells = "".join(
        f"M{MARGIN_MM + side * column:.4g} {MARGIN_MM + side * row:.4g}h{side:.4g}v{side:.4g}h{-side:.4g}z"
        for row, column in np.argwhere(modules()).tolist()
    )
    below = MARGIN_MM + height + 6
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{page[0]}mm" height="{page[1]}mm"'
        f' viewBox="0 0 {page[0]} {page[1]}"><rect width="100%" height="100%" fill="white"/>'
        f'<path shape-rendering="crispEdges" d="{cells}"/>'
        f'<path stroke="black" stroke-width="0.3" d="M{MARGIN_MM} {below}h{CHECK_MM}m0 -2v4m{-CHECK_MM} -4v4"/>'
        f'<text x="{MARGIN_MM}" y="{below + 6}" font-family="sans-serif" font-size="4">Print at 100 %. The line has'
        f" {CHECK_MM} mm; a square has {1e3 * square:g} mm. Glue the print on a flat plate.</text></svg>\n"
    )


class Corners:
    """Finder of the board's inner corners in pictures."""

    def __init__(self) -> None:
        self._detector = cv2.aruco.CharucoDetector(charuco(1.0))

    def find(self, picture: Picture) -> tuple[NDArray[np.int64], Array]:
        """Return numbers (k,) and pixels (k, 2), column and row, of the k corners in a picture; k may be 0."""
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        pixels, numbers, _, _ = self._detector.detectBoard(grey)
        if numbers is None or pixels is None or len(numbers) == 0:
            return np.empty(0, np.int64), np.empty((0, 2))
        # The detector interpolates between markers to half a pixel; the edges of the squares are more accurate.
        found = np.asarray(pixels, np.float32).reshape(-1, 1, 2)
        refined = cv2.cornerSubPix(grey, found.copy(), REFINED, (-1, -1), REFINEMENT_END)
        return np.asarray(numbers, np.int64).ravel(), np.asarray(refined, np.float64).reshape(-1, 2)


def corner_positions(square: float) -> Array:
    """Return the positions (24, 3) of the inner corners on a board whose squares have the side `square` [m]."""
    return np.asarray(charuco(square).getChessboardCorners(), np.float64).reshape(-1, 3)
