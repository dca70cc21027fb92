"""Named views of the scene's camera, fitted to the robot's size and to the aspect ratio of the picture."""

from typing import NamedTuple

import numpy as np

from core.robot.robot import Array

#: Vertical field of view of the camera [rad].
FIELD_OF_VIEW_RAD = np.deg2rad(35.0)
#: Aspect ratio (width by height) that is assumed for a picture of unknown size.
DEFAULT_ASPECT = 1.4
#: Factor on the camera's distance that leaves a margin around the bounds.
VIEW_MARGIN = 1.06
#: Half the edge length of the cube around the tip that the view "Tip" shows [m].
TIP_VIEW_HALF_EDGE_M = 0.03

#: Fraction of the robot's lateral reach that the overview shows, because the tip is seldom at the limit of its reach.
LATERAL_SHARE = 0.45

#: Direction in the world frame that points up on the screen. Gravity acts along +x, so up is -x.
_UP = (-1.0, 0.0, 0.0)
#: Two vectors of each view, world frame: from the picture's centre to the camera (any length), and up on the screen.
DIRECTIONS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "Overview": ((-0.42, -0.85, 0.42), _UP),
    "Side": ((0.0, -1.0, 0.0), _UP),
    "Above": ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "Front": ((0.0, 0.0, 1.0), _UP),
    "Tip": ((-0.35, -0.65, 0.68), _UP),
}
VIEWS = tuple(DIRECTIONS)


class ViewBounds(NamedTuple):
    """A box in the world frame that a view shows."""

    lower: Array  #: smallest coordinates (3,) [m]
    upper: Array  #: largest coordinates (3,) [m]

    @staticmethod
    def around(points: Array) -> "ViewBounds":
        """Return the smallest box around points (k, 3) [m]."""
        return ViewBounds(points.min(axis=0), points.max(axis=0))

    @property
    def middle(self) -> Array:
        """Centre of the box (3,) [m]."""
        return 0.5 * (self.lower + self.upper)

    @property
    def corners(self) -> Array:
        """Corners of the box (8, 3) [m]."""
        ends = np.stack((self.lower, self.upper))
        return np.stack([axis.ravel() for axis in np.meshgrid(*ends.T, indexing="ij")], axis=1)


class Camera(NamedTuple):
    """Position and orientation of a camera."""

    eye: Array  #: position (3,) [m]
    centre: Array  #: point at the centre of the picture (3,) [m]
    up: Array  #: direction (3,) that points up in the picture, world frame


def camera(view: str, robot: ViewBounds, tip: Array, aspect: float) -> Camera:
    """Return the camera as near as possible to the robot such that the picture contains all bounds of the view.

    Args:
        view: one of `VIEWS`.
        robot: bounds of the robot's reach.
        tip: present tip (3,) [m].
        aspect: aspect ratio of the picture (width by height).
    """
    shown = robot
    if view == "Tip":
        shown = ViewBounds(tip - TIP_VIEW_HALF_EDGE_M, tip + TIP_VIEW_HALF_EDGE_M)
    elif view == "Overview":
        middle, along = robot.middle, robot.upper - robot.lower == np.max(robot.upper - robot.lower)
        shown = ViewBounds(*(middle + np.where(along, 1.0, LATERAL_SHARE) * (end - middle) for end in robot))
    direction, up = (np.array(vector) for vector in DIRECTIONS[view])
    toward = direction / np.linalg.norm(direction)
    right = np.cross(up, toward)
    right /= np.linalg.norm(right)
    corners = shown.corners - shown.middle
    half = np.tan(0.5 * FIELD_OF_VIEW_RAD)
    sideways = np.abs(corners @ right) / (half * aspect)
    upward = np.abs(corners @ np.cross(toward, right)) / half
    distance = float(np.max(corners @ toward + VIEW_MARGIN * np.maximum(sideways, upward)))
    return Camera(shown.middle + distance * toward, shown.middle, up)
