"""Rigid motions: where one frame stands in another, and the one that fits two clouds of points best."""

import math
from typing import NamedTuple

import numpy as np

from core.errors import DescriptionError
from core.robot.robot import Array


class Rigid(NamedTuple):
    """x_there = rotation @ x_here + position."""

    rotation: Array  #: (3, 3)
    position: Array  #: (3,) [m]

    def apply(self, points: Array) -> Array:
        """Points (..., 3) [m] carried over."""
        return points @ self.rotation.T + self.position

    def inverse(self) -> "Rigid":
        """The way back."""
        return Rigid(self.rotation.T.copy(), -self.rotation.T @ self.position)

    def after(self, first: "Rigid") -> "Rigid":
        """`first`, then this one."""
        return Rigid(self.rotation @ first.rotation, self.rotation @ first.position + self.position)


def cross_matrix(vector: Array) -> Array:
    """The matrix [v x] (3, 3) that makes v x w of w."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_of(vector: Array) -> Array:
    """Rotation (3, 3) about a vector (3,) by its length [rad], by Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3) + cross_matrix(vector)
    turn = cross_matrix(vector / angle)
    return np.eye(3) + math.sin(angle) * turn + (1.0 - math.cos(angle)) * turn @ turn


def vector_of(rotation: Array) -> Array:
    """Inverse of `rotation_of`: axis times angle (3,), 0 ... pi [rad]."""
    skew = 0.5 * np.array([
        rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1],
    ])  # fmt: skip
    sine, cosine = float(np.linalg.norm(skew)), 0.5 * (float(np.trace(rotation)) - 1.0)
    if sine > 1e-6 or cosine > 0.0:
        return skew * (math.atan2(sine, cosine) / sine if sine > 1e-12 else 1.0)
    # Half a turn: the axis is the column of R + 1 that is longest.
    columns = rotation + np.eye(3)
    axis = columns[:, int(np.argmax(np.linalg.norm(columns, axis=0)))]
    return math.pi * axis / float(np.linalg.norm(axis))


def kabsch(here: Array, there: Array) -> Rigid:
    """Motion that carries points `here` (m, 3) onto `there` (m, 3) with the least squares, in closed form.

    Arun, Huang, Blostein 1987; Kabsch 1976: the singular vectors of the clouds' covariance, turned into a
    proper rotation where a mirror image would fit better.

    Raises:
        DescriptionError: fewer than three points.

    """
    if here.shape != there.shape or here.ndim != 2 or here.shape[0] < 3:
        raise DescriptionError(f"point clouds of shapes {here.shape} and {there.shape}; at least (3, 3) of each needed")
    centre_here, centre_there = here.mean(axis=0), there.mean(axis=0)
    u, _, vt = np.linalg.svd((here - centre_here).T @ (there - centre_there))
    mirror = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(vt.T @ u.T)))])
    rotation = vt.T @ mirror @ u.T
    return Rigid(rotation, centre_there - rotation @ centre_here)
