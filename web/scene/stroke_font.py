"""Font made of line segments for the numbers and axis names of the scene's grid."""

import numpy as np

from core.robot.robot import Array

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
