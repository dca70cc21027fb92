"""The model in the paper's variables, eqs. (6)-(16) with Euler angles, only for comparison with `cross_section`.

R = Rx(theta_1) Ry(theta_2) Rz(theta_i3), with theta_1 and theta_2 common to all tubes. The angles are singular where
the tangent points along +-x: cos(theta_2) = 0. The model that the solver uses (`cross_section`) has no singularity.
`euler_tip` integrates once, from the base unknowns of a solution of `cross_section`. The tips of both models agree to
the order of the integrator.
"""

import numpy as np

from core.compiled import compiled
from core.errors import NoSolution
from core.model.solution import Solution
from core.robot.robot import Array, Layout, Robot

#: Smallest cos(theta_2) at which the Euler angles are used; at 0 they are singular.
MIN_COSINE = 0.02


def euler_tip(robot: Robot, solution: Solution, sublink: float) -> Array:
    """Return the tip (3,) [m] in the paper's variables from the base unknowns of a solution under a tip load.

    Raises:
        NoSolution: the tangent points along +-x of the plate, where the angles are singular.

    """
    base = robot.base.rotation
    q = len(robot.tubes)
    alpha, beta = robot.tube_poses(solution.joints)
    force, moment = base.T @ solution.wrench[:3], base.T @ solution.unknowns[q:]
    position = np.zeros(3)
    cosine = _pass(robot.layout, alpha, beta, force, moment, solution.unknowns[:q].copy(), sublink, position)
    if not cosine > MIN_COSINE:
        raise NoSolution(
            f"cos(theta_2) {cosine:.3g} is below {MIN_COSINE:g}: the paper's Euler angles are singular"
            " where the tangent points along x"
        )
    return base @ position + robot.base.position


@compiled
def _pass(
    layout: Layout, alpha: Array, beta: Array, force: Array, moment: Array, twist: Array, sublink: float, r: Array
) -> float:
    """Integrate to the tip `r` and return the smallest cos(theta_2) along the tubes."""
    q = layout.counts.shape[0]
    theta_1, theta_2 = 0.0, 0.0
    theta = alpha - beta * twist  # theta_i3
    section = np.zeros(q, np.int64)
    for i in range(q):
        while section[i] < layout.counts[i] and beta[i] + layout.ends[i, section[i]] <= 0.0:
            section[i] += 1
    start, least = 0.0, 1.0
    twist_1, twist_2 = np.zeros(q), np.zeros(q)
    while True:
        end, end_tube, total = np.inf, -1, 0.0
        for i in range(q):
            if section[i] < layout.counts[i]:
                section_end = beta[i] + layout.ends[i, section[i]]
                if section_end < end:
                    end, end_tube = section_end, i
                total += layout.stiffness[i, 0]
        if end_tube < 0:
            return least
        span = end - start
        steps = max(1, int(np.ceil(span / sublink)))
        for step in range(steps):
            h = span - (steps - 1) * sublink if step == steps - 1 else sublink
            hh = 0.5 * h * h
            s1, c1, s2, c2 = np.sin(theta_1), np.cos(theta_1), np.sin(theta_2), np.cos(theta_2)
            s3, c3 = np.sin(theta[0]), np.cos(theta[0])
            least = min(least, c2)
            # r' = R e_z, (10)-(12), M' of (13), and R^T M, R^T M' in the frame of tube 1
            dx, dy, dz = s2, -s1 * c2, c1 * c2
            mx, my, mz = moment[0], moment[1], moment[2]
            nx = -(dy * force[2] - dz * force[1])
            ny = -(dz * force[0] - dx * force[2])
            nz = -(dx * force[1] - dy * force[0])
            bx, by, bz = _to_frame(mx, my, mz, s1, c1, s2, c2, s3, c3)
            ex, ey, _ = _to_frame(nx, ny, nz, s1, c1, s2, c2, s3, c3)
            # Curvature of eq. (14) of the paper in the frame of tube 1, and its derivative along the tube.
            ux, uy, vx, vy = bx / total, by / total, 0.0, 0.0
            for i in range(q):
                if section[i] < layout.counts[i]:
                    a = theta[i] - theta[0]
                    hx, hy = layout.curvatures[i, section[i], 0], layout.curvatures[i, section[i], 1]
                    share = layout.stiffness[i, 0] / total
                    px, py = np.cos(a) * hx - np.sin(a) * hy, np.sin(a) * hx + np.cos(a) * hy
                    ux += share * px
                    uy += share * py
                    vx -= share * py * (twist[i] - twist[0])
                    vy += share * px * (twist[i] - twist[0])
            vx += (ex - (uy * bz - twist[0] * by)) / total
            vy += (ey - (twist[0] * bx - ux * bz)) / total
            # (6) of every tube, and its rate
            for i in range(q):
                twist_1[i], twist_2[i] = 0.0, 0.0
                if section[i] < layout.counts[i]:
                    a = theta[i] - theta[0]
                    hx, hy = layout.curvatures[i, section[i], 0], layout.curvatures[i, section[i], 1]
                    c, s, turn = np.cos(a), np.sin(a), twist[i] - twist[0]
                    uix, uiy = c * ux + s * uy, c * uy - s * ux
                    vix, viy = c * vx + s * vy + turn * uiy, c * vy - s * vx - turn * uix
                    twist_1[i] = layout.stiffness[i, 1] * (uix * hy - uiy * hx)
                    twist_2[i] = layout.stiffness[i, 1] * (vix * hy - viy * hx)
            # (7)-(9) and their rates
            a1, b1 = ux * c3 - uy * s3, ux * s3 + uy * c3
            t1, t2 = a1 / c2, b1
            t3 = twist[0] - t1 * s2
            a2, b2 = vx * c3 - vy * s3 - t3 * b1, vx * s3 + vy * c3 + t3 * a1
            t11, t22 = a2 / c2 + a1 * s2 * t2 / (c2 * c2), b2
            ddx = c2 * t2
            ddy = -c1 * c2 * t1 + s1 * s2 * t2
            ddz = -s1 * c2 * t1 - c1 * s2 * t2
            # (16)
            r[0] += h * dx + hh * ddx
            r[1] += h * dy + hh * ddy
            r[2] += h * dz + hh * ddz
            moment[0] += h * nx - hh * (ddy * force[2] - ddz * force[1])
            moment[1] += h * ny - hh * (ddz * force[0] - ddx * force[2])
            moment[2] += h * nz - hh * (ddx * force[1] - ddy * force[0])
            for i in range(q):
                if section[i] < layout.counts[i]:
                    theta[i] += h * (twist[i] - t1 * s2) + hh * (twist_1[i] - t11 * s2 - t1 * c2 * t2)
                    twist[i] += h * twist_1[i] + hh * twist_2[i]
            theta_1 += h * t1 + hh * t11
            theta_2 += h * t2 + hh * t22
        start = end
        section[end_tube] += 1


@compiled
def _to_frame(
    x: float, y: float, z: float, s1: float, c1: float, s2: float, c2: float, s3: float, c3: float
) -> tuple[float, float, float]:
    """Return (Rx Ry Rz)^T (x, y, z)."""
    y, z = c1 * y + s1 * z, c1 * z - s1 * y
    x, z = c2 * x - s2 * z, s2 * x + c2 * z
    return c3 * x + s3 * y, c3 * y - s3 * x, z
