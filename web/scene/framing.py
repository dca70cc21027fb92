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


#: Smallest angle between a path's plane and the ray to the path [rad]. Then step and limit of the angle between this
#: plane and the view direction [rad]; the two angles differ, because a path is seldom in the middle of the picture.
LEAST_TILT_RAD, TILT_STEP_RAD, MOST_TILT_RAD = np.deg2rad((30.0, 5.0, 75.0))
#: Width of a path relative to its length below which it counts as a line, without a plane; and least length [m].
LINE_WIDTH, LEAST_LENGTH_M = 0.05, 1e-3


def plane_normal(path: Array) -> Array | None:
    """Return the unit normal (3,) of the plane of a path (k, 3) [m]; None for a short or a straight path."""
    if len(path) < 3 or np.ptp(path, axis=0).max() < LEAST_LENGTH_M:
        return None
    _, sizes, axes = np.linalg.svd(path - path.mean(axis=0), full_matrices=False)
    return None if sizes[1] < LINE_WIDTH * sizes[0] else axes[2]


def tilted(direction: Array, normal: Array, tilt: float) -> Array:
    """Return the unit vector nearest to `direction` (3,) that has at least the angle `tilt` to a plane [rad]."""
    toward = direction / np.linalg.norm(direction)
    normal = normal if normal @ toward >= 0.0 else -normal
    if (now := float(normal @ toward)) >= np.sin(tilt):
        return toward
    within = toward - now * normal
    return np.cos(tilt) * within / np.linalg.norm(within) + np.sin(tilt) * normal


class Window(NamedTuple):
    """Part of a picture: distances of its edges from the picture's centre, as fractions of half the picture's size."""

    left: float = 0.94
    right: float = 0.94
    below: float = 0.94
    above: float = 0.94


def fit(points: Array, direction: Vector, up: Vector, aspect: float, window: Window | None = None) -> Camera:
    """Return the camera nearest to `points` (k, 3) [m] that shows all of them inside a window of the picture.

    Let a point be at x across and z toward the camera, and the camera at a across and d toward. The point is inside an
    edge of slope s if x - a <= s (d - z). This is linear in a and d, so two opposite edges determine d, then a.

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


def fit_next_to_close_up(points: Array, direction: Vector, up: Vector, aspect: float, path: Array) -> Camera:
    """Return the nearest camera that shows all points in one of the free parts of the page's scene.

    The camera turns from `direction` until it sees the plane of the `path` (k, 3) [m] at `LEAST_TILT_RAD` or more.
    """
    toward, normal = np.array(direction), plane_normal(path)
    tilt, best = LEAST_TILT_RAD, _nearest(points, direction, up, aspect)
    while normal is not None and _seen_tilt(best, path, normal) < LEAST_TILT_RAD and tilt <= MOST_TILT_RAD:
        x, y, z = tilted(toward, normal, tilt).tolist()
        if abs(np.dot((x, y, z), up)) > np.cos(0.5 * LEAST_TILT_RAD):
            break  # the camera would look along the direction that points up
        tilt, best = tilt + TILT_STEP_RAD, _nearest(points, (x, y, z), up, aspect)
    return best


def _nearest(points: Array, direction: Vector, up: Vector, aspect: float) -> Camera:
    cameras = [fit(points, direction, up, aspect, window) for window in free_windows(aspect)]
    return min(cameras, key=lambda camera: float(np.linalg.norm(camera.eye - camera.centre)))


def _seen_tilt(camera: Camera, path: Array, normal: Array) -> float:
    """Return the angle between the plane of a path and the ray to its middle [rad]."""
    ray = camera.eye - path.mean(axis=0)
    return float(np.arcsin(min(1.0, abs(normal @ ray) / float(np.linalg.norm(ray)))))
