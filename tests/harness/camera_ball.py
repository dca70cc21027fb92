"""The green ball that a simulated camera draws at the tip, found in a picture."""

import numpy as np
from numpy.typing import NDArray


def ball_centre(picture: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the centre of the ball (column, row) [pixel] in a picture of blue, green and red."""
    blue, green, red = (picture[..., channel].astype(float) for channel in range(3))
    weight = np.clip(green - np.maximum(blue, red) - 40.0, 0.0, None)
    rows, columns = np.indices(weight.shape)
    return np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
