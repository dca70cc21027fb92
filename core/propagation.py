"""One pass along the tubes: the loaded model, eqs. (6)-(16), and its derivatives, eqs. (17)-(19).

The cross-section is carried by a frame R that does not twist (a Bishop frame) and every tube by
its angle theta_i in it, instead of the paper's Euler angles. The equations are the same,

    R' = R [kappa x],      kappa = (sum_i EI_i v_i + (R^T M)_xy) / sum_i EI_i        (14)
    theta_i' = u_iz,       u_iz' = (EI_i / GJ_i) (kappa x v_i)_z                  (6), (9)
    r' = R e_z,            M = M(0) - r x F                                 (10)-(12), (13)

with v_i the precurvature of tube i turned by theta_i, but no orientation is singular and no tube
is special. A sub-link is the paper's second-order closed form (15)-(16); its rotation is applied
as a rotation, so that R stays one.

Derivatives travel with the state as columns: of the base unknowns (u_iz(0), M(0)), of the joints
and of the force. Only the last sub-link of a link changes its length with a joint (H in (19)).
"""

import numpy as np

from core.compiled import compiled
from core.robot import Array, Layout

#: Rows of a derivative column before the tubes': rotation (3) and position (3), world frame.
FRAME_ROWS = 6


@compiled
def propagate(
    layout: Layout,
    alpha: Array,
    beta: Array,
    force: Array,
    unknowns: Array,
    sublink: float,
    tubes: tuple[float, ...],
    columns: tuple[float, ...],
    state: Array,
    rates: Array,
    path: Array,
) -> int:
    """Integrate from the plate to the tip.

    Args:
        layout: the robot.
        alpha, beta: rotation [rad] and proximal end [m] of each tube (q,).
        force: tip force (3,), world frame [N].
        unknowns: u_iz(0) of each tube (q) [1/m], then M(0) (3) [N m].
        sublink: length of a sub-link [m]; the last of each link takes the remainder.
        tubes, columns: tuples whose lengths, q and the number of derivative columns (0 for none,
            else padded to a multiple of 4), are constants to the compiler.
        state: out (12 + 2q): R by rows, r [m], theta_i [rad], u_iz [1/m] at the end of each tube.
        rates: out (rows x columns, flat): derivatives of rotation (3, world), r (3), theta_i,
            u_iz by unknowns (q + 3), joints (n), force (3).
        path: out (m, 13 + 2q): arc length and `state` at every sub-link, as far as m reaches.

    Returns:
        Number of cross-sections passed, the plate's included.

    """
    q = len(tubes)
    width = len(columns)
    n = layout.joint_tube.shape[0]
    first_joint, first_force = q + 3, q + 3 + n
    theta_row, uz_row = FRAME_ROWS, FRAME_ROWS + q

    # Local arrays: tubes now present, and the precurvature of each, free and turned.
    section = np.zeros(q, np.int64)
    length_rate = np.zeros(q)
    theta, uz = np.empty(q), np.empty(q)
    vx, vy = np.zeros(q), np.zeros(q)
    uz_1, uz_2 = np.zeros(q), np.zeros(q)
    stiff, ratio = np.zeros(q), np.zeros(q)
    slide = np.zeros(max(width, 1))
    moment_x, moment_y, moment_z = np.zeros(max(width, 1)), np.zeros(max(width, 1)), np.zeros(max(width, 1))
    force_x, force_y, force_z = np.zeros(max(width, 1)), np.zeros(max(width, 1)), np.zeros(max(width, 1))

    r11, r12, r13, r21, r22, r23, r31, r32, r33 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    x, y, z = 0.0, 0.0, 0.0
    fx, fy, fz = force[0], force[1], force[2]
    m0x, m0y, m0z = unknowns[q], unknowns[q + 1], unknowns[q + 2]
    for i in range(q):
        uz[i] = unknowns[i]
        theta[i] = alpha[i] - beta[i] * uz[i]  # the hidden part twists too

    if width > 0:
        for index in range((FRAME_ROWS + 2 * q) * width):
            rates[index] = 0.0
        for i in range(q):
            rates[(theta_row + i) * width + i] = -beta[i]
            rates[(uz_row + i) * width + i] = 1.0
        for j in range(n):
            i = layout.joint_tube[j]
            rates[(theta_row + i) * width + first_joint + j] = -uz[i] if layout.joint_slides[j] else 1.0
        moment_x[q], moment_y[q + 1], moment_z[q + 2] = 1.0, 1.0, 1.0
        force_x[first_force], force_y[first_force + 1], force_z[first_force + 2] = 1.0, 1.0, 1.0

    # Sections that lie wholly behind the plate are passed before the start.
    for i in range(q):
        while section[i] < layout.counts[i] and beta[i] + layout.ends[i, section[i]] <= 0.0:
            section[i] += 1

    start = 0.0
    start_tube = -1  # the tube whose beta moves the start of this link; none moves the plate
    passed = 0
    while True:
        # The next place where a section ends closes this link.
        end = np.inf
        end_tube = -1
        total = 0.0
        for i in range(q):
            stiff[i] = 0.0
            if section[i] < layout.counts[i]:
                place = beta[i] + layout.ends[i, section[i]]
                if place < end:
                    end, end_tube = place, i
                stiff[i] = layout.stiffness[i, 0]
                total += stiff[i]
        if end_tube < 0:
            break
        for i in range(q):
            ratio[i] = layout.stiffness[i, 1] if stiff[i] > 0.0 else 0.0
            stiff[i] /= total
        flexibility = 1.0 / total
        span = end - start
        steps = max(1, int(np.ceil(span / sublink)))
        if width > 0:
            for i in range(q):
                length_rate[i] = 0.0
            length_rate[end_tube] += 1.0
            if start_tube >= 0:
                length_rate[start_tube] -= 1.0
            for j in range(n):
                slide[first_joint + j] = length_rate[layout.joint_tube[j]] if layout.joint_slides[j] else 0.0

        for step in range(steps):
            last = step == steps - 1
            h = span - (steps - 1) * sublink if last else sublink
            if passed < path.shape[0]:
                _record(path[passed], start + step * sublink, r11, r12, r13, r21, r22, r23, r31, r32, r33, x, y, z)
                for i in range(q):
                    path[passed, 13 + i] = theta[i]
                    path[passed, 13 + q + i] = uz[i]
            passed += 1
            hh = 0.5 * h * h

            # State and its first two derivatives along s.
            mwx, mwy, mwz = m0x - (y * fz - z * fy), m0y - (z * fx - x * fz), m0z - (x * fy - y * fx)
            mx = r11 * mwx + r21 * mwy + r31 * mwz
            my = r12 * mwx + r22 * mwy + r32 * mwz
            mz = r13 * mwx + r23 * mwy + r33 * mwz
            bx = r11 * fx + r21 * fy + r31 * fz
            by = r12 * fx + r22 * fy + r32 * fz
            kx, ky = flexibility * mx, flexibility * my
            k1x, k1y = 0.0, 0.0
            for i in range(q):
                ux, uy = 0.0, 0.0
                if ratio[i] > 0.0:
                    ux, uy = layout.curvatures[i, section[i], 0], layout.curvatures[i, section[i], 1]
                c, s = np.cos(theta[i]), np.sin(theta[i])
                vx[i], vy[i] = c * ux - s * uy, s * ux + c * uy
                kx += stiff[i] * vx[i]
                ky += stiff[i] * vy[i]
                k1x -= stiff[i] * uz[i] * vy[i]
                k1y += stiff[i] * uz[i] * vx[i]
            k1x += flexibility * (by - ky * mz)
            k1y += flexibility * (kx * mz - bx)
            for i in range(q):
                uz_1[i] = ratio[i] * (kx * vy[i] - ky * vx[i])
                uz_2[i] = ratio[i] * (k1x * vy[i] - k1y * vx[i] + uz[i] * (kx * vx[i] + ky * vy[i]))

            # Rotation by phi, E = exp[phi x], and T, the left Jacobian of the exponential.
            px, py = h * kx + hh * k1x, h * ky + hh * k1y
            pp = px * px + py * py
            a, b, c3 = _series(pp)
            e11, e12, e13 = 1.0 - b * py * py, b * px * py, a * py
            e22, e23 = 1.0 - b * px * px, -a * px
            e31, e32, e33 = -a * py, a * px, 1.0 - b * pp
            # R p, the step of the position; d3' = ky d1 - kx d2.
            sx = h * r13 + hh * (ky * r11 - kx * r12)
            sy = h * r23 + hh * (ky * r21 - kx * r22)
            sz = h * r33 + hh * (ky * r31 - kx * r32)

            if width > 0:
                # G = R T, its columns for phi_x and phi_y.
                t11, t21, t31 = 1.0 - c3 * py * py, c3 * px * py, -b * py
                t22, t32 = 1.0 - c3 * px * px, b * px
                g11, g12 = r11 * t11 + r12 * t21 + r13 * t31, r11 * t21 + r12 * t22 + r13 * t32
                g21, g22 = r21 * t11 + r22 * t21 + r23 * t31, r21 * t21 + r22 * t22 + r23 * t32
                g31, g32 = r31 * t11 + r32 * t21 + r33 * t31, r31 * t21 + r32 * t22 + r33 * t32
                sliding = 1.0 if last else 0.0
                for col in range(width):
                    n1, n2, n3 = rates[col], rates[width + col], rates[2 * width + col]
                    d1, d2, d3 = rates[3 * width + col], rates[4 * width + col], rates[5 * width + col]
                    f1, f2, f3 = force_x[col], force_y[col], force_z[col]
                    dh = sliding * slide[col]
                    # change of the moment seen from the turning frame, and of the force
                    a1 = moment_x[col] - (d2 * fz - d3 * fy) - (y * f3 - z * f2) - (n2 * mwz - n3 * mwy)
                    a2 = moment_y[col] - (d3 * fx - d1 * fz) - (z * f1 - x * f3) - (n3 * mwx - n1 * mwz)
                    a3 = moment_z[col] - (d1 * fy - d2 * fx) - (x * f2 - y * f1) - (n1 * mwy - n2 * mwx)
                    b1, b2, b3 = f1 - (n2 * fz - n3 * fy), f2 - (n3 * fx - n1 * fz), f3 - (n1 * fy - n2 * fx)
                    dkx = flexibility * (r11 * a1 + r21 * a2 + r31 * a3)
                    dky = flexibility * (r12 * a1 + r22 * a2 + r32 * a3)
                    dmz = r13 * a1 + r23 * a2 + r33 * a3
                    dk1x = flexibility * (r12 * b1 + r22 * b2 + r32 * b3 - ky * dmz)
                    dk1y = flexibility * (kx * dmz - r11 * b1 - r21 * b2 - r31 * b3)
                    for i in range(q):
                        turn = rates[(theta_row + i) * width + col]
                        twist = rates[(uz_row + i) * width + col]
                        dkx -= stiff[i] * turn * vy[i]
                        dky += stiff[i] * turn * vx[i]
                        dk1x -= stiff[i] * (twist * vy[i] + uz[i] * turn * vx[i])
                        dk1y += stiff[i] * (twist * vx[i] - uz[i] * turn * vy[i])
                    dk1x -= flexibility * mz * dky
                    dk1y += flexibility * mz * dkx
                    for i in range(q):
                        turn = rates[(theta_row + i) * width + col]
                        twist = rates[(uz_row + i) * width + col]
                        along = kx * vx[i] + ky * vy[i]
                        d_uz_1 = ratio[i] * (dkx * vy[i] - dky * vx[i] + turn * along)
                        d_uz_2 = ratio[i] * (
                            dk1x * vy[i]
                            - dk1y * vx[i]
                            + turn * (k1x * vx[i] + k1y * vy[i])
                            + twist * along
                            + uz[i] * (dkx * vx[i] + dky * vy[i] + turn * (ky * vx[i] - kx * vy[i]))
                        )
                        present = 1.0 if ratio[i] > 0.0 else 0.0
                        rates[(theta_row + i) * width + col] = turn + present * (
                            h * twist + hh * d_uz_1 + dh * (uz[i] + h * uz_1[i])
                        )
                        rates[(uz_row + i) * width + col] = (
                            twist + h * d_uz_1 + hh * d_uz_2 + dh * (uz_1[i] + h * uz_2[i])
                        )
                    dpx = h * dkx + hh * dk1x + dh * (kx + h * k1x)
                    dpy = h * dky + hh * dk1y + dh * (ky + h * k1y)
                    qx, qy = hh * dky + dh * h * ky, -hh * dkx - dh * h * kx
                    rates[3 * width + col] = d1 + n2 * sz - n3 * sy + r11 * qx + r12 * qy + dh * r13
                    rates[4 * width + col] = d2 + n3 * sx - n1 * sz + r21 * qx + r22 * qy + dh * r23
                    rates[5 * width + col] = d3 + n1 * sy - n2 * sx + r31 * qx + r32 * qy + dh * r33
                    rates[col] = n1 + g11 * dpx + g12 * dpy
                    rates[width + col] = n2 + g21 * dpx + g22 * dpy
                    rates[2 * width + col] = n3 + g31 * dpx + g32 * dpy

            x, y, z = x + sx, y + sy, z + sz
            r11, r12, r13 = (
                r11 * e11 + r12 * e12 + r13 * e31,
                r11 * e12 + r12 * e22 + r13 * e32,
                r11 * e13 + r12 * e23 + r13 * e33,
            )
            r21, r22, r23 = (
                r21 * e11 + r22 * e12 + r23 * e31,
                r21 * e12 + r22 * e22 + r23 * e32,
                r21 * e13 + r22 * e23 + r23 * e33,
            )
            r31, r32, r33 = (
                r31 * e11 + r32 * e12 + r33 * e31,
                r31 * e12 + r32 * e22 + r33 * e32,
                r31 * e13 + r32 * e23 + r33 * e33,
            )
            for i in range(q):
                if ratio[i] > 0.0:
                    theta[i] += h * uz[i] + hh * uz_1[i]
                    uz[i] += h * uz_1[i] + hh * uz_2[i]

        start, start_tube = end, end_tube
        section[end_tube] += 1

    if passed < path.shape[0]:
        _record(path[passed], start, r11, r12, r13, r21, r22, r23, r31, r32, r33, x, y, z)
        for i in range(q):
            path[passed, 13 + i] = theta[i]
            path[passed, 13 + q + i] = uz[i]
    state[0], state[1], state[2] = r11, r12, r13
    state[3], state[4], state[5] = r21, r22, r23
    state[6], state[7], state[8] = r31, r32, r33
    state[9], state[10], state[11] = x, y, z
    for i in range(q):
        state[12 + i] = theta[i]
        state[12 + q + i] = uz[i]
    return passed + 1


@compiled
def _series(pp: float) -> tuple[float, float, float]:
    """sin(p)/p, (1 - cos(p))/p^2, (p - sin(p))/p^3 as functions of p^2.

    Taylor series up to p = 0.5 (error below 1e-17), closed form beyond.
    """
    if pp > 0.25:
        p = np.sqrt(pp)
        return np.sin(p) / p, (1.0 - np.cos(p)) / pp, (p - np.sin(p)) / (p * pp)
    b = 0.5 * (1.0 - pp / 12.0 * (1.0 - pp / 30.0 * (1.0 - pp / 56.0 * (1.0 - pp / 90.0 * (1.0 - pp / 132.0)))))
    c = (1.0 - pp / 20.0 * (1.0 - pp / 42.0 * (1.0 - pp / 72.0 * (1.0 - pp / 110.0 * (1.0 - pp / 156.0))))) / 6.0
    return 1.0 - pp * c, b, c


@compiled
def _record(
    row: Array,
    s: float,
    r11: float,
    r12: float,
    r13: float,
    r21: float,
    r22: float,
    r23: float,
    r31: float,
    r32: float,
    r33: float,
    x: float,
    y: float,
    z: float,
) -> None:
    row[0] = s
    row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9] = r11, r12, r13, r21, r22, r23, r31, r32, r33
    row[10], row[11], row[12] = x, y, z
