"""Integrators of one sub-link, a short piece of the tubes.

`second_order` is the paper's closed form (15)-(16) and its derivative, eqs. (17)-(19). The rate of each variable is
taken as linear along the sub-link, so the variable is a parabola. The orientation R is multiplied by a rotation matrix,
so R stays a rotation.

`fourth_order` uses two cross-sections, at the start and in the middle of the sub-link. If a cross-section gives y' = f
and y'' = g, two cross-sections are sufficient for fourth order (Chan, Tsai 2010):

    y(h/2) = y + h/2 f + h^2/8 g,        y(h) = y + h f + h^2 (g / 6 + g(h/2) / 3).

For the rotation this scheme becomes the Magnus series: the same quadrature gives the integral of kappa, and the
commutator is h^3/12 (kappa x kappa') in the middle. The derivative columns are the exact derivatives of this scheme.
"""

from core.compiled import compiled, replaced
from core.model.cross_section import bend, bend_rate, exponential, load_matrix, product
from core.robot.robot import Array


@compiled
def second_order(
    link: Array,
    load: Array,
    h: float,
    sliding: float,
    state: Array,
    rates: Array,
    tubes: tuple[float, ...],
    columns: tuple[float, ...],
) -> None:
    """Integrate one sub-link of length `h` [m]; update `state` and `rates` of `propagation.propagate` in place."""
    q, width = len(tubes), len(columns)
    hh = 0.5 * h * h
    theta, twist = tubes, tubes
    for i in range(q):
        theta, twist = replaced(theta, i, state[12 + i]), replaced(twist, i, state[12 + q + i])
    r = load_matrix(state)
    at = bend(link, load, r, state[9], state[10], state[11], theta, twist)
    turn, along = exponential(h * at.kx + hh * at.k1x, h * at.ky + hh * at.k1y, 0.0)
    # d3' = ky d1 - kx d2
    sx = h * r.m13 + hh * (at.ky * r.m11 - at.kx * r.m12)
    sy = h * r.m23 + hh * (at.ky * r.m21 - at.kx * r.m22)
    sz = h * r.m33 + hh * (at.ky * r.m31 - at.kx * r.m32)

    if width > 0:
        g = product(r, along)
        present = tubes
        for i in range(q):
            present = replaced(present, i, 1.0 if at.ratio[i] > 0.0 else 0.0)
        for col in range(width):
            n1, n2, n3 = rates[col], rates[width + col], rates[2 * width + col]
            d1, d2, d3 = rates[3 * width + col], rates[4 * width + col], rates[5 * width + col]
            turns, twists = theta, theta
            for i in range(q):
                turns = replaced(turns, i, rates[(6 + i) * width + col])
                twists = replaced(twists, i, rates[(6 + q + i) * width + col])
            fixed = (6 + 2 * q) * width + col
            dh = sliding * rates[fixed + 6 * width]
            d = bend_rate(
                at, n1, n2, n3, d1, d2, d3,
                rates[fixed], rates[fixed + width], rates[fixed + 2 * width],
                rates[fixed + 3 * width], rates[fixed + 4 * width], rates[fixed + 5 * width],
                turns, twists,
            )  # fmt: skip
            for i in range(q):
                rates[(6 + i) * width + col] = (
                    turns[i] + h * present[i] * twists[i] + hh * d.uz1[i] + dh * (at.uz[i] + h * at.uz1[i])
                )
                rates[(6 + q + i) * width + col] = (
                    twists[i] + h * d.uz1[i] + hh * d.uz2[i] + dh * (at.uz1[i] + h * at.uz2[i])
                )
            px = h * d.kx + hh * d.k1x + dh * (at.kx + h * at.k1x)
            py = h * d.ky + hh * d.k1y + dh * (at.ky + h * at.k1y)
            qx, qy = hh * d.ky + dh * h * at.ky, -hh * d.kx - dh * h * at.kx
            rates[col] = n1 + g.m11 * px + g.m12 * py
            rates[width + col] = n2 + g.m21 * px + g.m22 * py
            rates[2 * width + col] = n3 + g.m31 * px + g.m32 * py
            rates[3 * width + col] = d1 + n2 * sz - n3 * sy + r.m11 * qx + r.m12 * qy + dh * r.m13
            rates[4 * width + col] = d2 + n3 * sx - n1 * sz + r.m21 * qx + r.m22 * qy + dh * r.m23
            rates[5 * width + col] = d3 + n1 * sy - n2 * sx + r.m31 * qx + r.m32 * qy + dh * r.m33

    r = product(r, turn)
    for k in range(9):
        state[k] = r[k]
    state[9] += sx
    state[10] += sy
    state[11] += sz
    for i in range(q):
        state[12 + i] += h * at.uz[i] + hh * at.uz1[i]
        state[12 + q + i] += h * at.uz1[i] + hh * at.uz2[i]


@compiled
def fourth_order(
    link: Array,
    load: Array,
    h: float,
    sliding: float,
    state: Array,
    rates: Array,
    tubes: tuple[float, ...],
    columns: tuple[float, ...],
) -> None:
    """Integrate one sub-link of length `h` [m]; update `state` and `rates` of `propagation.propagate` in place."""
    q, width = len(tubes), len(columns)
    half, eighth, sixth, third, twelfth = 0.5 * h, h * h / 8.0, h * h / 6.0, h * h / 3.0, h * h * h / 12.0
    theta, twist = tubes, tubes
    for i in range(q):
        theta, twist = replaced(theta, i, state[12 + i]), replaced(twist, i, state[12 + q + i])
    r = load_matrix(state)
    x, y, z = state[9], state[10], state[11]
    at = bend(link, load, r, x, y, z, theta, twist)

    half_turn, half_along = exponential(half * at.kx + eighth * at.k1x, half * at.ky + eighth * at.k1y, 0.0)
    rm = product(r, half_turn)
    # d3' = ky d1 - kx d2, here and in the middle
    ux, uy, uz = at.ky * r.m11 - at.kx * r.m12, at.ky * r.m21 - at.kx * r.m22, at.ky * r.m31 - at.kx * r.m32
    cx, cy, cz = half * r.m13 + eighth * ux, half * r.m23 + eighth * uy, half * r.m33 + eighth * uz
    theta_m, twist_m = theta, twist
    for i in range(q):
        theta_m = replaced(theta_m, i, theta[i] + half * at.uz[i] + eighth * at.uz1[i])
        twist_m = replaced(twist_m, i, twist[i] + half * at.uz1[i] + eighth * at.uz2[i])
    mid = bend(link, load, rm, x + cx, y + cy, z + cz, theta_m, twist_m)

    wx, wy = mid.ky * rm.m11 - mid.kx * rm.m12, mid.ky * rm.m21 - mid.kx * rm.m22
    wz = mid.ky * rm.m31 - mid.kx * rm.m32
    sx, sy, sz = (
        h * r.m13 + sixth * ux + third * wx,
        h * r.m23 + sixth * uy + third * wy,
        h * r.m33 + sixth * uz + third * wz,
    )
    turn, along = exponential(
        h * at.kx + sixth * at.k1x + third * mid.k1x,
        h * at.ky + sixth * at.k1y + third * mid.k1y,
        twelfth * (mid.kx * mid.k1y - mid.ky * mid.k1x),
    )

    if width > 0:
        g, gm = product(r, along), product(r, half_along)
        present = tubes
        for i in range(q):
            present = replaced(present, i, 1.0 if at.ratio[i] > 0.0 else 0.0)
        for col in range(width):
            n1, n2, n3 = rates[col], rates[width + col], rates[2 * width + col]
            d1, d2, d3 = rates[3 * width + col], rates[4 * width + col], rates[5 * width + col]
            turns, twists = theta, theta
            for i in range(q):
                turns = replaced(turns, i, rates[(6 + i) * width + col])
                twists = replaced(twists, i, rates[(6 + q + i) * width + col])
            fixed = (6 + 2 * q) * width + col
            f1, f2, f3 = rates[fixed], rates[fixed + width], rates[fixed + 2 * width]
            m1, m2, m3 = rates[fixed + 3 * width], rates[fixed + 4 * width], rates[fixed + 5 * width]
            dh = sliding * rates[fixed + 6 * width]
            d = bend_rate(at, n1, n2, n3, d1, d2, d3, f1, f2, f3, m1, m2, m3, turns, twists)

            # derivatives at the middle, which moves by dh / 2 when the length changes by dh
            px = half * d.kx + eighth * d.k1x + dh * (0.5 * at.kx + 0.25 * h * at.k1x)
            py = half * d.ky + eighth * d.k1y + dh * (0.5 * at.ky + 0.25 * h * at.k1y)
            qx = eighth * d.ky + 0.25 * dh * h * at.ky
            qy = -eighth * d.kx - 0.25 * dh * h * at.kx
            o1, o2, o3 = (
                n1 + gm.m11 * px + gm.m12 * py,
                n2 + gm.m21 * px + gm.m22 * py,
                n3 + gm.m31 * px + gm.m32 * py,
            )
            e1 = d1 + n2 * cz - n3 * cy + r.m11 * qx + r.m12 * qy + 0.5 * dh * r.m13
            e2 = d2 + n3 * cx - n1 * cz + r.m21 * qx + r.m22 * qy + 0.5 * dh * r.m23
            e3 = d3 + n1 * cy - n2 * cx + r.m31 * qx + r.m32 * qy + 0.5 * dh * r.m33
            turns_m, twists_m = turns, twists
            for i in range(q):
                turns_m = replaced(
                    turns_m, i,
                    turns[i] + half * present[i] * twists[i] + eighth * d.uz1[i]
                    + dh * (0.5 * at.uz[i] + 0.25 * h * at.uz1[i]),
                )  # fmt: skip
                twists_m = replaced(
                    twists_m, i,
                    twists[i] + half * d.uz1[i] + eighth * d.uz2[i] + dh * (0.5 * at.uz1[i] + 0.25 * h * at.uz2[i]),
                )  # fmt: skip
            e = bend_rate(mid, o1, o2, o3, e1, e2, e3, f1, f2, f3, m1, m2, m3, turns_m, twists_m)

            # derivatives at the end of the sub-link
            for i in range(q):
                rates[(6 + i) * width + col] = (
                    turns[i] + h * present[i] * twists[i] + sixth * d.uz1[i] + third * e.uz1[i]
                    + dh * (at.uz[i] + h / 3.0 * (at.uz1[i] + 2.0 * mid.uz1[i]))
                )  # fmt: skip
                rates[(6 + q + i) * width + col] = (
                    twists[i] + h * d.uz1[i] + sixth * d.uz2[i] + third * e.uz2[i]
                    + dh * (at.uz1[i] + h / 3.0 * (at.uz2[i] + 2.0 * mid.uz2[i]))
                )  # fmt: skip
            px = h * d.kx + sixth * d.k1x + third * e.k1x + dh * (at.kx + h / 3.0 * (at.k1x + 2.0 * mid.k1x))
            py = h * d.ky + sixth * d.k1y + third * e.k1y + dh * (at.ky + h / 3.0 * (at.k1y + 2.0 * mid.k1y))
            pz = twelfth * (e.kx * mid.k1y + mid.kx * e.k1y - e.ky * mid.k1x - mid.ky * e.k1x) + dh * (
                0.25 * h * h * (mid.kx * mid.k1y - mid.ky * mid.k1x)
            )
            rates[col] = n1 + g.m11 * px + g.m12 * py + g.m13 * pz
            rates[width + col] = n2 + g.m21 * px + g.m22 * py + g.m23 * pz
            rates[2 * width + col] = n3 + g.m31 * px + g.m32 * py + g.m33 * pz
            # Change of the position: n rotates the step's part from the start, o its part from the middle; the other
            # terms are the changes of both parts in the frames R and Rm.
            qx, qy = sixth * d.ky + dh * h / 3.0 * at.ky, -sixth * d.kx - dh * h / 3.0 * at.kx
            vx, vy = third * e.ky + dh * h / 1.5 * mid.ky, -third * e.kx - dh * h / 1.5 * mid.kx
            tx, ty, tz = sx - third * wx, sy - third * wy, sz - third * wz
            rates[3 * width + col] = (
                d1 + n2 * tz - n3 * ty + third * (o2 * wz - o3 * wy)
                + r.m11 * qx + r.m12 * qy + rm.m11 * vx + rm.m12 * vy + dh * r.m13
            )  # fmt: skip
            rates[4 * width + col] = (
                d2 + n3 * tx - n1 * tz + third * (o3 * wx - o1 * wz)
                + r.m21 * qx + r.m22 * qy + rm.m21 * vx + rm.m22 * vy + dh * r.m23
            )  # fmt: skip
            rates[5 * width + col] = (
                d3 + n1 * ty - n2 * tx + third * (o1 * wy - o2 * wx)
                + r.m31 * qx + r.m32 * qy + rm.m31 * vx + rm.m32 * vy + dh * r.m33
            )  # fmt: skip

    r = product(r, turn)
    for k in range(9):
        state[k] = r[k]
    state[9], state[10], state[11] = x + sx, y + sy, z + sz
    for i in range(q):
        state[12 + i] += h * at.uz[i] + sixth * at.uz1[i] + third * mid.uz1[i]
        state[12 + q + i] += h * at.uz1[i] + sixth * at.uz2[i] + third * mid.uz2[i]
