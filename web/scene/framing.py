"""Smallest camera distance at which a picture contains given points, with room for the overlays of the page."""

from typing import NamedTuple

import numpy as np

from core.robot.robot import Array

#: Vertical field of view of the camera [rad].
FIELD_OF_VIEW_RAD = np.deg2rad(35.0)

Vector = tuple[float, float, float]


class Camera(NamedTuple):
    """Position and orientation of a camera."""

    eye: Array  #: position (3,) [m]
    centre: Array  #: point at the centre of the picture (3,) [m]
    up: Array  #: direction (3,) that points up in the picture, world frame

    def distance_to(self, other: "Camera") -> float:
        """Return how far two cameras differ, relative to the distance of this camera from its picture's centre."""
        size = float(np.linalg.norm(self.eye - self.centre))
        moved = (np.linalg.norm(self.eye - other.eye), np.linalg.norm(self.centre - other.centre))
        return float(max(moved)) / size

    def toward(self, other: "Camera", share: float) -> "Camera":
        """Return a camera between this one (`share` 0) and another one (1)."""
        eye = self.eye + share * (other.eye - self.eye)
        return Camera(eye, self.centre + share * (other.centre - self.centre), other.up)


class Window(NamedTuple):
    """Part of a picture: distances of its edges from the picture's centre, as fractions of half the picture's size."""

    left: float = 0.94
    right: float = 0.94
    below: float = 0.94
    above: float = 0.94


def fit(points: Array, direction: Vector, up: Vector, aspect: float, window: Window | None = None) -> Camera:
    """Return the camera nearest to `points` (k, 3) [m] that shows all of them inside a window of the picture.

    An edge of the window bounds the camera's position linearly: for a point at (x, z) across and toward the camera and
    an edge with the slope s, x - a <= s (d - z) for a camera at (a, d). The two opposite edges determine d, then a.

    Args:
        points: points in the world frame (k, 3) [m].
        direction: vector from the picture's centre to the camera, of any length.
        up: direction that points up in the picture.
        aspect: aspect ratio of the picture (width by height).
        window: part of the picture that contains the points; None: the picture without a small margin.
    """
    window = window or Window()
    toward = np.array(direction) / np.linalg.norm(direction)
    right = np.cross(up, toward)
    right /= np.linalg.norm(right)
    above = np.cross(toward, right)
    depth, half = points @ toward, np.tan(0.5 * FIELD_OF_VIEW_RAD)
    bounds = []
    for axis, low, high in (
        (right, half * aspect * window.left, half * aspect * window.right),
        (above, half * window.below, half * window.above),
    ):
        along = points @ axis
        bounds.append((low, high, float(np.max(low * depth - along)), float(np.max(high * depth + along))))
    distance = max((lowest + highest) / (low + high) for low, high, lowest, highest in bounds)
    a, b = (0.5 * (highest - lowest + (low - high) * distance) for low, high, lowest, highest in bounds)
    eye = a * right + b * above + distance * toward
    middle = 0.5 * float(depth.min() + depth.max())
    return Camera(eye, eye - (distance - middle) * toward, np.array(up))


#: Width of the close-up of the tip and of its margins, as a fraction of the scene's width (`static/scene/scene.css`).
CLOSE_UP_WIDTH = 0.37
#: Height of the close-up without its picture, as a fraction of the scene's height.
CLOSE_UP_TEXT_HEIGHT = 0.12


def free_windows(aspect: float) -> tuple[Window, Window]:
    """Return the two parts of the page's scene that the close-up leaves free: to its left, and below it."""
    height = min(0.8 * CLOSE_UP_WIDTH * aspect + CLOSE_UP_TEXT_HEIGHT, 0.6)
    return (
        Window(left=0.9, right=1.0 - 2.0 * CLOSE_UP_WIDTH, below=0.8, above=0.8),
        Window(left=0.9, right=0.9, below=0.8, above=1.0 - 2.0 * height),
    )


def fit_next_to_close_up(points: Array, direction: Vector, up: Vector, aspect: float) -> Camera:
    """Return the nearest camera that shows all points in one of the free parts of the page's scene."""
    cameras = [fit(points, direction, up, aspect, window) for window in free_windows(aspect)]
    return min(cameras, key=lambda camera: float(np.linalg.norm(camera.eye - camera.centre)))
