"""Bending of one cross-section: eqs. (6), (13) and (14), their rates along s, and their derivatives.

A frame R that does not twist (a Bishop frame) describes the orientation of the cross-section. An angle theta_i in this
frame describes the rotation of each tube. Frame and angles replace the paper's Euler angles in the same equations,

    R' = R [kappa x],      kappa = (sum_i EI_i v_i + (R^T M)_xy) / sum_i EI_i        (14)
    theta_i' = u_iz,       u_iz' = (EI_i / GJ_i) (kappa x v_i)_z                  (6), (9)
    r' = R e_z,            M = M(0) - r x F                                 (10)-(12), (13)

with v_i the precurvature of tube i rotated by theta_i. The description has no singular orientation and treats all tubes
equally.
"""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled, inlined, replaced
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


Numbers = tuple[float, ...]


class Bend(NamedTuple):
    """A cross-section and its bending; vectors are in the world frame unless stated otherwise."""

    r: Matrix  #: rotation matrix R of the cross-section's frame
    x: float  #: x, y and z: position from the plate [m]
    y: float
    z: float
    fx: float  #: fx, fy and fz: force [N]
    fy: float
    fz: float
    mx: float  #: mx, my and mz: moment [N m]
    my: float
    mz: float
    axial: float  #: moment about the tangent [N m]
    flexibility: float  #: one over the sum of all bending stiffnesses EI [1/(N m^2)]
    kx: float  #: kx and ky: curvature kappa in the frame R [1/m]
    ky: float
    k1x: float  #: k1x and k1y: rate of the curvature along the tubes, in the frame R [1/m^2]
    k1y: float
    share: Numbers  #: share of each tube in the bending stiffness, EI_i / sum EI; 0 for an absent tube
    ratio: Numbers  #: bending over torsional stiffness of each tube, EI_i / GJ_i; 0 for an absent tube
    vx: Numbers  #: vx and vy: rotated precurvature of each tube [1/m]
    vy: Numbers
    uz: Numbers  #: torsion u_iz of each tube [1/m]; 0 for an absent tube
    uz1: Numbers  #: first derivative of the torsion along the tube [1/m^2]
    uz2: Numbers  #: second derivative of the torsion along the tube [1/m^3]


class BendRate(NamedTuple):
    """Derivative of a `Bend` by the variable of one derivative column (an unknown, a joint or a force component)."""

    kx: float
    ky: float
    k1x: float
    k1y: float
    uz1: Numbers
    uz2: Numbers


@inlined
def bend(
    link: Array,
    load: Array,
    r: Matrix,
    x: float, y: float, z: float,
    theta: Numbers,
    twist: Numbers,
) -> Bend:  # fmt: skip
    """Return the bending of a cross-section.

    Args:
        link: share, ratio, precurvature x and y, and 1 / sum EI for each tube (q, 5).
        load: force and moment at the plate (6,) [N, N m].
        r: rotation matrix R of the cross-section's frame.
        x, y, z: position from the plate [m].
        theta, twist: theta_i [rad] and u_iz [1/m].

    """
    fx, fy, fz = load[0], load[1], load[2]
    mx, my, mz = load[3] - (y * fz - z * fy), load[4] - (z * fx - x * fz), load[5] - (x * fy - y * fx)
    axial = r.m13 * mx + r.m23 * my + r.m33 * mz
    flexibility = link[0, 4]
    kx = flexibility * (r.m11 * mx + r.m21 * my + r.m31 * mz)
    ky = flexibility * (r.m12 * mx + r.m22 * my + r.m32 * mz)
    k1x, k1y = 0.0, 0.0
    share, ratio, vx, vy, uz, uz1, uz2 = theta, theta, theta, theta, theta, theta, theta
    for i in range(len(theta)):
        c, s = np.cos(theta[i]), np.sin(theta[i])
        share = replaced(share, i, link[i, 0])
        ratio = replaced(ratio, i, link[i, 1])
        vx = replaced(vx, i, c * link[i, 2] - s * link[i, 3])
        vy = replaced(vy, i, s * link[i, 2] + c * link[i, 3])
        uz = replaced(uz, i, twist[i] if link[i, 1] > 0.0 else 0.0)
        kx += share[i] * vx[i]
        ky += share[i] * vy[i]
        k1x -= share[i] * uz[i] * vy[i]
        k1y += share[i] * uz[i] * vx[i]
    k1x += flexibility * (r.m12 * fx + r.m22 * fy + r.m32 * fz) - flexibility * axial * ky
    k1y += flexibility * axial * kx - flexibility * (r.m11 * fx + r.m21 * fy + r.m31 * fz)
    for i in range(len(theta)):
        uz1 = replaced(uz1, i, ratio[i] * (kx * vy[i] - ky * vx[i]))
        along = kx * vx[i] + ky * vy[i]
        uz2 = replaced(uz2, i, ratio[i] * (k1x * vy[i] - k1y * vx[i] + uz[i] * along))
    return Bend(
        r, x, y, z, fx, fy, fz, mx, my, mz, axial, flexibility,
        kx, ky, k1x, k1y, share, ratio, vx, vy, uz, uz1, uz2,
    )  # fmt: skip


@inlined
def bend_rate(
    at: Bend,
    n1: float, n2: float, n3: float,
    d1: float, d2: float, d3: float,
    f1: float, f2: float, f3: float,
    m1: float, m2: float, m3: float,
    turn: Numbers,
    twist: Numbers,
) -> BendRate:  # fmt: skip
    """Return the change of curvature and torsion rates, computed by `bend`, for small changes of its inputs.

    Args:
        at: the cross-section.
        n1, n2, n3: rotation of the cross-section, world frame [rad].
        d1, d2, d3: displacement of the cross-section, world frame [m].
        f1, f2, f3, m1, m2, m3: change of the force [N] and of the moment at the plate [N m].
        turn, twist: change of theta_i [rad] and u_iz [1/m].

    """
    # changes of the moment (a) and of the force (b), in world axes, less their rotation with the frame
    a1 = m1 - (d2 * at.fz - d3 * at.fy) - (at.y * f3 - at.z * f2) - (n2 * at.mz - n3 * at.my)
    a2 = m2 - (d3 * at.fx - d1 * at.fz) - (at.z * f1 - at.x * f3) - (n3 * at.mx - n1 * at.mz)
    a3 = m3 - (d1 * at.fy - d2 * at.fx) - (at.x * f2 - at.y * f1) - (n1 * at.my - n2 * at.mx)
    b1, b2, b3 = f1 - (n2 * at.fz - n3 * at.fy), f2 - (n3 * at.fx - n1 * at.fz), f3 - (n1 * at.fy - n2 * at.fx)
    kx = at.flexibility * (at.r.m11 * a1 + at.r.m21 * a2 + at.r.m31 * a3)
    ky = at.flexibility * (at.r.m12 * a1 + at.r.m22 * a2 + at.r.m32 * a3)
    axial = at.r.m13 * a1 + at.r.m23 * a2 + at.r.m33 * a3
    k1x = at.flexibility * (at.r.m12 * b1 + at.r.m22 * b2 + at.r.m32 * b3 - at.ky * axial)
    k1y = at.flexibility * (at.kx * axial - at.r.m11 * b1 - at.r.m21 * b2 - at.r.m31 * b3)
    for i in range(len(turn)):
        kx -= at.share[i] * turn[i] * at.vy[i]
        ky += at.share[i] * turn[i] * at.vx[i]
        k1x -= at.share[i] * (twist[i] * at.vy[i] + at.uz[i] * turn[i] * at.vx[i])
        k1y += at.share[i] * (twist[i] * at.vx[i] - at.uz[i] * turn[i] * at.vy[i])
    k1x -= at.flexibility * at.axial * ky
    k1y += at.flexibility * at.axial * kx
    uz1, uz2 = turn, turn
    for i in range(len(turn)):
        along = at.kx * at.vx[i] + at.ky * at.vy[i]
        across = at.ky * at.vx[i] - at.kx * at.vy[i]
        uz1 = replaced(uz1, i, at.ratio[i] * (kx * at.vy[i] - ky * at.vx[i] + turn[i] * along))
        uz2 = replaced(
            uz2, i,
            at.ratio[i] * (
                k1x * at.vy[i] - k1y * at.vx[i] + turn[i] * (at.k1x * at.vx[i] + at.k1y * at.vy[i])
                + twist[i] * along + at.uz[i] * (kx * at.vx[i] + ky * at.vy[i] + turn[i] * across)
            ),
        )  # fmt: skip
    return BendRate(kx, ky, k1x, k1y, uz1, uz2)
