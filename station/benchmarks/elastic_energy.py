"""Stability of a shape by finite differences of its elastic energy. Only the shape itself comes from the solver.

The shape is divided into elements. Each element has a frame at each end, and the rotations of the tubes there. The
logarithm of the rotation between both frames gives curvature and torsion, and these give the elastic energy. Small
changes of all variables give the second derivatives of the energy. This computation uses no equation of equilibrium and
no analytic second variation, and its discretisation differs from that of the solver.
"""

import math

import numpy as np

from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array, Robot

#: Half step of the finite differences of the energy [rad].
HALF_STEP_RAD = 2e-3
#: Numerical error of an eigenvalue whose exact value is zero; elements and finite differences cause this error.
ZERO_EIGENVALUE = 1e-6


def lowest(robot: Robot, solution: Solution, longest: float = 0.005) -> float:
    """Return the smallest eigenvalue of the energy's second derivatives, divided by their largest diagonal entry.

    A negative value means that the shape is unstable.

    Args:
        robot: robot with the tubes.
        solution: shape under a force at the tip; a moment is ignored, because it has no potential energy.
        longest: length of the longest element [m].

    """
    from scipy.linalg import eigvals_banded  # pyright: ignore  - slow to import

    bands, stiffest = _bands(robot, solution, longest)
    return float(eigvals_banded(bands, select="i", select_range=(0, 0))[0]) / stiffest  # pyright: ignore


def _bands(robot: Robot, solution: Solution, longest: float) -> tuple[Array, float]:
    """Return the upper bands of the second derivatives by (x, y, psi_1 ... psi_q) of the nodes, and the largest."""
    q = len(robot.tubes)
    size = q + 2
    path = Statics(robot, longest, "fourth_order").shape(solution)
    path = path[np.append(np.diff(path[:, 0]) > 1e-9, True)]
    nodes, h = path[:, 0], np.diff(path[:, 0])
    frames = np.array([_quaternion(row[1:10].reshape(3, 3)) for row in path])
    theta = path[:, 13 : 13 + q]
    beta = robot.tube_poses(solution.joints)[1]
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    bend, free = _tubes(robot, beta, middle)
    force = np.where(middle[:, None] < solution.contact, solution.wrench[:3], 0.0)

    def energy(change: Array) -> Array:
        """Return the energy of each element (..., m) after changes (..., 2 size) of the variables at its two ends."""
        start = _product(frames[:-1], _turn(change[..., 0], change[..., 1]))
        end = _product(frames[1:], _turn(change[..., size], change[..., size + 1]))
        first, second = theta[:-1] + change[..., 2:size], theta[1:] + change[..., size + 2 :]
        between = _logarithm(_product(_conjugate(start), end))
        strain = between / h[:, None]
        turned = 0.5 * (first + second)
        cos, sin = np.cos(turned), np.sin(turned)
        x = strain[..., None, 0] - (cos * free[..., 0] - sin * free[..., 1])
        y = strain[..., None, 1] - (sin * free[..., 0] + cos * free[..., 1])
        torsion = (second - first) / h[:, None] + strain[..., None, 2]
        stored = 0.5 * (bend[0] * (x * x + y * y) + bend[1] * torsion * torsion).sum(axis=-1)
        tangent = _tangent(_product(start, _exponential(0.5 * between)))
        return h * (stored - (force * tangent).sum(axis=-1))

    count = 2 * size
    local = np.empty((h.size, count, count))
    unit = HALF_STEP_RAD * np.eye(count)[:, None, :]
    for i in range(count):
        up, down = energy(unit + unit[i]), energy(-unit + unit[i])
        up2, down2 = energy(unit - unit[i]), energy(-unit - unit[i])
        local[:, i, :] = ((up - down - up2 + down2) / (4.0 * HALF_STEP_RAD * HALF_STEP_RAD)).T

    bands = np.zeros((2 * size, size * nodes.size))
    for i in range(count):
        for j in range(i, count):
            bands[2 * size - 1 + i - j, j : j + size * h.size : size] += local[:, i, j]
    stiffest = float(bands[-1].max())
    for i in range(q):
        hidden = -beta[i]
        bands[-1, 2 + i] += min(bend[1][0, i] / max(hidden, 1e-12), 1e3 * stiffest)
        beyond = np.flatnonzero(bend[0][:, i] == 0.0) + 1
        bands[-1, size * beyond + 2 + i] = stiffest
    bands[-1, :2] += 1e3 * stiffest  # a stiff spring clamps the shape at the plate
    return bands, stiffest


def _tubes(robot: Robot, beta: Array, arc_lengths: Array) -> tuple[Array, Array]:
    """Return EI and GJ (2, m, q), and precurvature (m, q, 2), of the tubes at arc lengths (m,)."""
    stiffness, curvature = np.zeros((2, arc_lengths.size, beta.size)), np.zeros((arc_lengths.size, beta.size, 2))
    for i, tube in enumerate(robot.tubes):
        end = beta[i]
        for section in tube.sections:
            there = (arc_lengths >= end) & (arc_lengths < end + section.length)
            stiffness[0, there, i] = tube.bending_stiffness
            stiffness[1, there, i] = tube.bending_stiffness / tube.stiffness_ratio
            curvature[there, i] = section.curvature
            end += section.length
    return stiffness, curvature


def _quaternion(rotation: Array) -> Array:
    """Return the quaternion (w, x, y, z) of a rotation matrix."""
    from scipy.spatial.transform import Rotation  # pyright: ignore  - slow to import

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])


def _product(p: Array, q: Array) -> Array:
    a, b, c, d = (p[..., i] for i in range(4))
    e, f, g, h = (q[..., i] for i in range(4))
    return np.stack(
        (
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ),
        axis=-1,
    )


def _conjugate(p: Array) -> Array:
    return p * np.array([1.0, -1.0, -1.0, -1.0])


def _turn(x: Array, y: Array) -> Array:
    """Return the quaternion of the rotation vector (x, y, 0)."""
    return _exponential(np.stack((x, y, np.zeros_like(x)), axis=-1))


def _exponential(vector: Array) -> Array:
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate((np.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / math.pi) * vector), axis=-1)


def _logarithm(p: Array) -> Array:
    """Return the rotation vector (..., 3) of a quaternion; its angle is at most half a turn."""
    p = np.where(p[..., :1] < 0.0, -p, p)
    size = np.linalg.norm(p[..., 1:], axis=-1, keepdims=True)
    return 2.0 * np.arctan2(size, p[..., :1]) / np.maximum(size, 1e-300) * p[..., 1:]


def _tangent(p: Array) -> Array:
    w, x, y, z = (p[..., i] for i in range(4))
    return np.stack((2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)), axis=-1)
