"""Position of a point that two or more calibrated cameras see, with its covariance."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array
from station.devices.projection import CameraView

#: Passes of the weighted least squares; the weights depend on the distances from the cameras.
PASSES = 3


class Triangulated(NamedTuple):
    """A triangulated point."""

    position: Array  #: (3,) in the world [m]
    covariance: Array  #: (3, 3) if each pixel coordinate has a standard deviation of 1 pixel [m^2]
    residual: float  #: largest distance between a pixel and the projected point [pixel]


def triangulate(views: Sequence[CameraView], pixels: Array) -> Triangulated | None:
    """Return the point with the smallest distances from the pixels (k, 2), column and row, of k cameras.

    Each pixel gives two planes through the optical centre that contain the point. The distances from the planes,
    divided by the distance from the camera, are minimised (weighted linear least squares).

    Returns:
        None if the lines of sight are parallel or meet behind a camera.
    """
    rows, offsets = np.empty((2 * len(views), 3)), np.empty(2 * len(views))
    for number, (view, pixel) in enumerate(zip(views, pixels, strict=True)):
        x, y = view.straightened(pixel)
        both = slice(2 * number, 2 * number + 2)
        rows[both] = view.rotation[:2] - np.outer((x, y), view.rotation[2])
        rows[both] *= view.matrix[[0, 1], [0, 1]][:, None]
        offsets[both] = rows[both] @ view.position
    weights = np.ones(len(views))
    position, covariance = np.zeros(3), np.zeros((3, 3))
    for _ in range(PASSES):
        weighted = rows * np.repeat(weights, 2)[:, None]
        normal = weighted.T @ weighted
        if np.linalg.cond(normal) > 1e12:
            return None
        covariance = np.asarray(np.linalg.inv(normal), np.float64)
        position = covariance @ (weighted.T @ (offsets * np.repeat(weights, 2)))
        depths = np.array([view.rotation[2] @ (position - view.position) for view in views])
        if not (depths > 0.0).all():
            return None
        weights = 1.0 / depths
    projected = np.vstack([view.project(position[None]) for view in views])
    return Triangulated(position, covariance, float(np.linalg.norm(projected - pixels, axis=1).max()))
