"""Where the camera may stand: views that are fitted to the robot's size and to the shape of the picture."""

from typing import NamedTuple

import numpy as np

from core.robot.robot import Array

#: Of the camera, from top to bottom [rad].
FIELD = np.deg2rad(35.0)
#: Width by height of a picture whose shape is not known yet.
ASPECT = 1.4
#: Room around what is seen.
MARGIN = 1.06
#: What the view of the tip holds: half an edge of a cube around it [m].
NEAR = 0.03

#: Of the room beside the axis so much is looked at in the overview: the tip is seldom as far out as it can be.
ASIDE = 0.45

_DOWN = (-1.0, 0.0, 0.0)  # the screen's up; gravity is +x
#: From what is looked at to the eye, of any length, and the screen's upward direction.
DIRECTIONS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "Overview": ((-0.42, -0.85, 0.42), _DOWN),
    "Side": ((0.0, -1.0, 0.0), _DOWN),
    "Above": ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "Front": ((0.0, 0.0, 1.0), _DOWN),
    "Tip": ((-0.35, -0.65, 0.68), _DOWN),
}
VIEWS = tuple(DIRECTIONS)


class Bounds(NamedTuple):
    """A box in the world."""

    lower: Array  #: (3,) [m]
    upper: Array  #: (3,) [m]

    @staticmethod
    def around(points: Array) -> "Bounds":
        """The least that holds points (k, 3) [m]."""
        return Bounds(points.min(axis=0), points.max(axis=0))

    @property
    def middle(self) -> Array:
        """(3,) [m]."""
        return 0.5 * (self.lower + self.upper)

    @property
    def corners(self) -> Array:
        """(8, 3) [m]."""
        ends = np.stack((self.lower, self.upper))
        return np.stack([axis.ravel() for axis in np.meshgrid(*ends.T, indexing="ij")], axis=1)


class Camera(NamedTuple):
    """Where it stands, what it looks at and what is up."""

    eye: Array  #: (3,) [m]
    centre: Array  #: (3,) [m]
    up: Array  #: (3,)


def camera(view: str, robot: Bounds, tip: Array, aspect: float) -> Camera:
    """The nearest place from which a view shows all that it is to show.

    Args:
        view: one of `VIEWS`.
        robot: everything that the robot reaches.
        tip: where the tip is (3,) [m].
        aspect: width of the picture by its height.
    """
    seen = robot
    if view == "Tip":
        seen = Bounds(tip - NEAR, tip + NEAR)
    elif view == "Overview":
        middle, along = robot.middle, robot.upper - robot.lower == np.max(robot.upper - robot.lower)
        seen = Bounds(*(middle + np.where(along, 1.0, ASIDE) * (end - middle) for end in robot))
    direction, up = (np.array(vector) for vector in DIRECTIONS[view])
    toward = direction / np.linalg.norm(direction)
    right = np.cross(up, toward)
    right /= np.linalg.norm(right)
    corners = seen.corners - seen.middle
    half = np.tan(0.5 * FIELD)
    sideways = np.abs(corners @ right) / (half * aspect)
    upward = np.abs(corners @ np.cross(toward, right)) / half
    distance = float(np.max(corners @ toward + MARGIN * np.maximum(sideways, upward)))
    return Camera(seen.middle + distance * toward, seen.middle, up)
