"""Projection of points in the world to a camera's picture: OpenCV's lens model, computed without OpenCV."""

from typing import NamedTuple

import numpy as np

from core.robot.robot import Array
from station.devices.cameras import CameraFile, LensFile, SimulationFile
from station.devices.config import Mount

#: Smallest distance in front of a camera at which a point is projected [m].
NEAREST_M = 1e-3
#: Passes of the fixed-point iteration that removes the lens's distortion from a pixel.
STRAIGHTENING_PASSES = 12


class CameraView(NamedTuple):
    """Lens and pose of a camera."""

    matrix: Array  #: (3, 3) camera matrix [pixel]
    distortion: Array  #: (5,) k1, k2, p1, p2, k3
    rotation: Array  #: (3, 3) from the world's axes to the camera's
    position: Array  #: (3,) optical centre in the world [m]

    @classmethod
    def of(cls, lens: LensFile, pose: Mount) -> "CameraView":
        """Return the view of a lens at a pose in the world."""
        (fx, fy), (cx, cy) = lens.focal, lens.centre
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        return cls(matrix, np.array(lens.distortion), pose.rotation.T, np.array(pose.position))

    def in_camera(self, points: Array) -> Array:
        """Return points (n, 3) of the world in the camera's frame (n, 3) [m]; z is the distance along the axis."""
        return (points - self.position) @ self.rotation.T

    def project(self, points: Array) -> Array:
        """Return the pixels (n, 2), column and row, of points (n, 3) of the world [m]; NaN behind the camera.

        The centre of the first pixel is (0, 0).
        """
        x, y, z = self.in_camera(points).T
        z = np.where(z > NEAREST_M, z, np.nan)
        x, y = x / z, y / z
        k1, k2, p1, p2, k3 = self.distortion
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        across = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
        down = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
        fx, fy, cx, cy = self.matrix[0, 0], self.matrix[1, 1], self.matrix[0, 2], self.matrix[1, 2]
        return np.column_stack((fx * across + cx, fy * down + cy))

    def straightened(self, pixel: Array) -> tuple[float, float]:
        """Return x/z and y/z, in the camera's frame, of every point that appears at a pixel (2,): column and row."""
        (fx, fy), (cx, cy) = self.matrix[[0, 1], [0, 1]].tolist(), self.matrix[:2, 2].tolist()
        seen_x, seen_y = (float(pixel[0]) - cx) / fx, (float(pixel[1]) - cy) / fy
        k1, k2, p1, p2, k3 = self.distortion.tolist()
        x, y = seen_x, seen_y
        for _ in range(STRAIGHTENING_PASSES if any(self.distortion) else 0):
            square = x * x + y * y
            radial = 1.0 + square * (k1 + square * (k2 + square * k3))
            x, y = (
                (seen_x - 2.0 * p1 * x * y - p2 * (square + 2.0 * x * x)) / radial,
                (seen_y - p1 * (square + 2.0 * y * y) - 2.0 * p2 * x * y) / radial,
            )
        return x, y


def view_of(camera: CameraFile) -> CameraView | None:
    """Return the view of a camera; None if lens or pose are not known."""
    return None if camera.view is None else CameraView.of(*camera.view)


def true_view_of(camera: CameraFile) -> CameraView | None:
    """Return the view of a simulated camera with its errors, which only the virtual lab knows."""
    view, errors = view_of(camera), camera.simulation or SimulationFile()
    if view is None:
        return None
    matrix = view.matrix.copy()
    matrix[[0, 1], [0, 1]] *= 1.0 + errors.focal_error
    turn = Mount(rotation_vector=errors.rotation_error).rotation
    return CameraView(matrix, view.distortion, turn.T @ view.rotation, view.position + np.array(errors.position_error))
