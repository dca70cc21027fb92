"""The paper's sub-link: the closed form (15)-(16), second order, and its derivative, eqs. (17)-(19).

The rate of each variable is taken as linear along the sub-link, so the variable is a parabola. The orientation R is
multiplied by a rotation matrix, so R stays a rotation.
"""

from core.compiled import compiled, replaced
from core.model.cross_section import bend, bend_rate
from core.model.rotations import exponential, load_matrix, product
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
