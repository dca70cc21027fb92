"""Rigid transforms between frames, and the best rigid fit between two point clouds."""

import math
from typing import NamedTuple

import numpy as np

from core.errors import DescriptionError
from core.robot.robot import Array


class RigidTransform(NamedTuple):
    """Rigid transform of points: x_there = rotation @ x_here + position."""

    rotation: Array  #: (3, 3) rotation matrix
    position: Array  #: (3,) translation [m]

    def apply(self, points: Array) -> Array:
        """Return points (..., 3) [m] in the target frame."""
        return points @ self.rotation.T + self.position

    def inverse(self) -> "RigidTransform":
        """Return the inverse transform."""
        return RigidTransform(self.rotation.T.copy(), -self.rotation.T @ self.position)

    def after(self, first: "RigidTransform") -> "RigidTransform":
        """Return the composition that applies `first`, then this transform."""
        return RigidTransform(self.rotation @ first.rotation, self.rotation @ first.position + self.position)


def cross_matrix(vector: Array) -> Array:
    """Return the matrix [v x] (3, 3) with [v x] w = v x w."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_from_vector(vector: Array) -> Array:
    """Return the rotation (3, 3) about a vector (3,) by its length [rad] (Rodrigues' formula)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3) + cross_matrix(vector)
    turn = cross_matrix(vector / angle)
    return np.eye(3) + math.sin(angle) * turn + (1.0 - math.cos(angle)) * turn @ turn


def vector_from_rotation(rotation: Array) -> Array:
    """Return the rotation vector (axis times angle, 0 ... pi rad) of a matrix: inverse of `rotation_from_vector`."""
    skew = 0.5 * np.array([
        rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1],
    ])  # fmt: skip
    sine, cosine = float(np.linalg.norm(skew)), 0.5 * (float(np.trace(rotation)) - 1.0)
    if sine > 1e-6 or cosine > 0.0:
        return skew * (math.atan2(sine, cosine) / sine if sine > 1e-12 else 1.0)
    # For half a turn, the axis is the direction of the longest column of R + 1.
    columns = rotation + np.eye(3)
    axis = columns[:, int(np.argmax(np.linalg.norm(columns, axis=0)))]
    return math.pi * axis / float(np.linalg.norm(axis))


def kabsch(here: Array, there: Array) -> RigidTransform:
    """Return the least-squares rigid transform from points `here` (m, 3) to `there` (m, 3), in closed form.

    The rotation follows from the singular vectors of the clouds' covariance (Arun, Huang, Blostein 1987; Kabsch 1976).
    A reflection is replaced by a proper rotation.

    Raises:
        DescriptionError: the point clouds have fewer than three points or different shapes.

    """
    if here.shape != there.shape or here.ndim != 2 or here.shape[0] < 3:
        raise DescriptionError(f"point clouds of shapes {here.shape} and {there.shape}; at least (3, 3) of each needed")
    centre_here, centre_there = here.mean(axis=0), there.mean(axis=0)
    u, _, vt = np.linalg.svd((here - centre_here).T @ (there - centre_there))
    mirror = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(vt.T @ u.T)))])
    rotation = vt.T @ mirror @ u.T
    return RigidTransform(rotation, centre_there - rotation @ centre_here)


#: Largest plausible angle between the coil's axis and the tip's axis [rad]; beyond this angle the mounting is wrong.
MAX_MISALIGNMENT_RAD = math.radians(45.0)
COIL_HINT = "the coil is mounted backwards, or the reported joint positions are wrong"
#: Largest accepted spread of the axis over single poses [rad]; beyond this spread the model's error dominates.
MAX_SPREAD_RAD = math.radians(2.0)
MODEL_HINT = "the model does not bend like the robot"


class CoilAxis(NamedTuple):
    """The estimated axis of the coil."""

    direction: Array  #: (3,) unit vector in the frame of the innermost tube's tip
    spread: float  #: root mean square deviation of single poses, per perpendicular axis [rad]
    refused: str = ""  #: reason why the result must not be used; empty if the result may be used

    @property
    def misalignment(self) -> float:
        """Angle between the coil's axis and the tip's axis [rad]."""
        return math.atan2(math.hypot(self.direction[0], self.direction[1]), self.direction[2])


def coil_axis(turns: Array, measured: Array) -> CoilAxis:
    """Estimate the coil axis from tip frames (m, 3, 3) and measured coil axes (m, 3) of m poses, robot's frame.

    The tip frames come from an earlier fit to positions alone. In the tip frame the measured axis should be the same at
    all poses, so the result is the mean over the poses. A model whose tubes bend too much causes nearly the same error
    in the tip frame at all poses, which cannot be distinguished from a misaligned coil. The deviation of single poses
    from the mean shows how good the model is.
    """
    there = np.einsum("mji,mj->mi", turns, measured)
    there /= np.linalg.norm(there, axis=1, keepdims=True)
    mean = there.mean(axis=0)
    direction = mean / float(np.linalg.norm(mean))
    across = there - (there @ direction)[:, None] * direction
    spread = math.sqrt(float(np.sum(across**2)) / (2.0 * max(len(there) - 1, 1)))
    found = CoilAxis(direction, spread)
    if found.misalignment > MAX_MISALIGNMENT_RAD:
        return found._replace(refused=f"more than {math.degrees(MAX_MISALIGNMENT_RAD):.0f} deg: {COIL_HINT}")
    if spread > MAX_SPREAD_RAD:
        return found._replace(refused=f"single poses deviate by {math.degrees(spread):.1f} deg: {MODEL_HINT}")
    return found
