"""Rotation matrices of rotation vectors, without trigonometric functions for short vectors."""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled, inlined
from core.robot.robot import Array


@compiled
def series(pp: float) -> tuple[float, float, float]:
    """Return sin(p)/p, (1 - cos(p))/p^2, (p - sin(p))/p^3 as functions of p^2.

    Taylor series up to p = 0.5 (error below 1e-17), closed form beyond.
    """
    if pp > 0.25:
        p = np.sqrt(pp)
        return np.sin(p) / p, (1.0 - np.cos(p)) / pp, (p - np.sin(p)) / (p * pp)
    b = 0.5 * (1.0 - pp / 12.0 * (1.0 - pp / 30.0 * (1.0 - pp / 56.0 * (1.0 - pp / 90.0 * (1.0 - pp / 132.0)))))
    c = (1.0 - pp / 20.0 * (1.0 - pp / 42.0 * (1.0 - pp / 72.0 * (1.0 - pp / 110.0 * (1.0 - pp / 156.0))))) / 6.0
    return 1.0 - pp * c, b, c


class Matrix(NamedTuple):
    """A 3 x 3 matrix whose elements the compiler keeps in registers."""

    m11: float
    m12: float
    m13: float
    m21: float
    m22: float
    m23: float
    m31: float
    m32: float
    m33: float


@inlined
def exponential(px: float, py: float, pz: float) -> tuple[Matrix, Matrix]:
    """Return the rotation matrix E = exp[p x] of a rotation vector p, and its left Jacobian T.

    T gives the change of the rotation: E(p + dp) = [1 + T dp x] E(p).
    """
    xx, yy, zz = px * px, py * py, pz * pz
    a, b, c = series(xx + yy + zz)
    xy, xz, yz = px * py, px * pz, py * pz
    return (
        Matrix(
            1.0 - b * (yy + zz), b * xy - a * pz, b * xz + a * py,
            b * xy + a * pz, 1.0 - b * (xx + zz), b * yz - a * px,
            b * xz - a * py, b * yz + a * px, 1.0 - b * (xx + yy),
        ),
        Matrix(
            1.0 - c * (yy + zz), c * xy - b * pz, c * xz + b * py,
            c * xy + b * pz, 1.0 - c * (xx + zz), c * yz - b * px,
            c * xz - b * py, c * yz + b * px, 1.0 - c * (xx + yy),
        ),
    )  # fmt: skip


@inlined
def product(a: Matrix, b: Matrix) -> Matrix:
    """Return the matrix product A B."""
    return Matrix(
        a.m11 * b.m11 + a.m12 * b.m21 + a.m13 * b.m31,
        a.m11 * b.m12 + a.m12 * b.m22 + a.m13 * b.m32,
        a.m11 * b.m13 + a.m12 * b.m23 + a.m13 * b.m33,
        a.m21 * b.m11 + a.m22 * b.m21 + a.m23 * b.m31,
        a.m21 * b.m12 + a.m22 * b.m22 + a.m23 * b.m32,
        a.m21 * b.m13 + a.m22 * b.m23 + a.m23 * b.m33,
        a.m31 * b.m11 + a.m32 * b.m21 + a.m33 * b.m31,
        a.m31 * b.m12 + a.m32 * b.m22 + a.m33 * b.m32,
        a.m31 * b.m13 + a.m32 * b.m23 + a.m33 * b.m33,
    )


@inlined
def load_matrix(numbers: Array) -> Matrix:
    """Return the 3 x 3 matrix whose rows are the first nine numbers of an array."""
    return Matrix(
        numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5], numbers[6], numbers[7], numbers[8]
    )
