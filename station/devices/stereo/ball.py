"""Finds the coloured ball at the robot's tip in a picture, to a fraction of a pixel."""

import math
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

#: Colour of the ball: the channel that exceeds the two others.
BallColour = Literal["green", "red", "blue"]
#: Index of the channel of each colour in a picture (blue, green, red).
CHANNELS = {"blue": 0, "green": 1, "red": 2}
#: Smallest excess of the ball's channel over the two others, of 255 levels.
MIN_EXCESS = 35
#: Smallest area of a ball [pixel], smallest share of its bounding box that it fills, and largest ratio of the box's
#: sides. A disc fills pi/4 of a square box.
MIN_AREA, MIN_FILL, MAX_ASPECT = 12, 0.5, 1.7
#: A second ball may also be the one at the tip if it has at least this share of the largest ball's area.
RIVAL_AREA = 0.5
#: Pixels around the bounding box that contribute to the centre, because the ball's edge is blurred.
MARGIN = 2


class Ball(NamedTuple):
    """Centre of the ball in a picture."""

    column: float  #: column [pixel]; the centre of the first pixel has the column 0
    row: float  #: row [pixel]; the centre of the first pixel has the row 0
    area: float  #: area of the ball [number of pixels]


def find_ball(picture: NDArray[np.uint8], colour: BallColour = "green") -> Ball | None:
    """Return the largest ball of a colour in a picture (rows, columns, 3); None: there is none.

    The centre is the mean of the pixels, weighted with the excess of the colour. If another ball is nearly as large,
    the picture does not show which one is at the tip, and the centre is infinite.
    """
    channels = cv2.split(picture)
    own = CHANNELS[colour]
    others = [channel for index, channel in enumerate(channels) if index != own]
    excess = cv2.subtract(channels[own], cv2.max(*others))
    _, mask = cv2.threshold(excess, MIN_EXCESS - 1, 255, cv2.THRESH_BINARY)
    number, _, boxes, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    found: Ball | None = None
    for index in sorted(range(1, number), key=lambda one: -boxes[one, cv2.CC_STAT_AREA]):
        left, top, width, height, area = (int(value) for value in boxes[index])
        if area < MIN_AREA or (found and area < RIVAL_AREA * found.area):
            break
        if area < MIN_FILL * width * height or max(width, height) > MAX_ASPECT * min(width, height):
            continue
        if found:
            return Ball(math.inf, math.inf, found.area)
        top, left = max(0, top - MARGIN), max(0, left - MARGIN)
        part = np.asarray(excess[top : top + height + 2 * MARGIN, left : left + width + 2 * MARGIN], np.float64)
        # Half of the threshold removes the noise of the background, but hardly any of the ball's blurred edge.
        weights = np.maximum(part - 0.5 * MIN_EXCESS, 0.0)
        total = float(weights.sum())
        column = left + float(weights.sum(axis=0) @ np.arange(part.shape[1])) / total
        row = top + float(weights.sum(axis=1) @ np.arange(part.shape[0])) / total
        found = Ball(column, row, float(area))
    return found
