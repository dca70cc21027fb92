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

from core.compiled import inlined, replaced
from core.model.rotations import Matrix
from core.robot.robot import Array

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
