"""Stability of a robot's shape, from the Morse index of its energy: the number of independent negative directions.

A shape is stable if every small change of the shape increases the energy: the second variation Q of the energy is
positive. A change with Q < 0 is a negative direction. The largest number of linearly independent negative directions
is the Morse index; by Jacobi's condition it is the number of conjugate points between tip and plate. A stable shape has
the index 0. The sign of the stability margin `Solution.stability` (a determinant) only shows whether the index is even
or odd. This module therefore counts the negative directions, for the whole length of the robot in one matrix.

A change of the shape rotates each cross-section by a d1 + b d2, equally for all tubes because they share one curve, and
twists each tube i by psi_i about the tangent t. (d1, d2, t) is the frame of `propagation`, which does not twist. In
this frame k is the curvature, w_i the precurvature of tube i, M the moment, n the force, and c = b k_x - a k_y. Then

    2 Q = int  sum EI_i ((a')^2 + (b')^2) + 2 sum EI_i psi_i (a' w_iy - b' w_ix) + sum EI_i psi_i^2 k . w_i
             + sum GJ_i (psi_i' + c)^2 + c (M_y a - M_x b) - M_z (a b' - b a') + n_t (a^2 + b^2)  ds
          + sum GJ_i psi_i(0)^2 / -beta_i,        a = b = 0 at the plate.

The last sum is the energy of the twist of the tubes behind the plate. The functions a, b and psi_i are linear between
neighbouring cross-sections, so 2 Q becomes a quadratic form with a banded matrix. A moment at the tip has no potential
energy; only the symmetric part of its contribution is used. Under such a moment, a shape without a negative direction
is still stable, but a shape with a negative direction is not necessarily unstable.
"""

import numpy as np

from core.robot.robot import Array, Robot

#: Stiffness of the spring that represents a clamped end, divided by the stiffness EI or GJ of the tubes [1/m].
CLAMP_STIFFNESS = 1e9
#: Smallest energy drop of a negative direction, as a fraction of (EI / length^2 + force) times the square of the
#: change. The threshold excludes discretisation errors, and neutral directions, in which the energy does not change: a
#: straight tube, for example, bends equally to any side.
MIN_ENERGY_DROP = 2e-3


def precurvature(robot: Robot, beta: Array, lengths: Array) -> tuple[Array, Array]:
    """Return the tubes' EI (m, q) [N m^2] and precurvature (m, q, 2) [1/m] at arc lengths (m,) [m]; 0 beyond a tube."""
    stiffness, curvature = np.zeros((lengths.size, beta.size)), np.zeros((lengths.size, beta.size, 2))
    for i, count in enumerate(robot.layout.counts):
        section = np.searchsorted(beta[i] + robot.layout.ends[i, :count], lengths, side="right")
        present = section < count
        stiffness[present, i] = robot.layout.stiffness[i, 0]
        curvature[present, i] = robot.layout.curvatures[i, section[present]]
    return stiffness, curvature


def negative_directions(robot: Robot, joints: Array, wrench: Array, contact: float, path: Array) -> int:
    """Return the number of independent shape changes that lower the energy: 0 if the shape is stable.

    Args:
        robot: the tubes.
        joints: the pose (n,) [rad or m].
        wrench: load (6,), world frame [N, N m].
        contact: arc length at which the force acts [m]; inf for the tip.
        path: cross-sections (m, 16 + 2q) as `propagate` writes them.

    """
    from scipy.linalg import LinAlgError, cholesky_banded, eigvals_banded  # pyright: ignore  - slow to import

    matrix = _matrix(robot, joints, wrench, contact, path)
    try:
        cholesky_banded(matrix, check_finite=False)
    except LinAlgError:
        negative: Array = eigvals_banded(matrix, select="v", select_range=(-np.inf, 0.0))  # pyright: ignore
        return max(1, negative.size)
    return 0


def _matrix(robot: Robot, joints: Array, wrench: Array, contact: float, path: Array) -> Array:
    """Return the matrix of the quadratic form 2 Q of a, b, psi_i at all cross-sections, as upper bands."""
    q = len(robot.tubes)
    beta, ratio = robot.tube_poses(joints)[1], robot.layout.stiffness[:, 1]
    path = path[np.append(np.diff(path[:, 0]) > 1e-9, True)]
    h = np.diff(path[:, 0])
    middle = 0.5 * (path[1:] + path[:-1])
    bend, free = precurvature(robot, beta, middle[:, 0])
    twist = bend / ratio
    frame, theta = middle[:, 1:10].reshape(-1, 3, 3), middle[:, 13 : 13 + q]
    moment = np.einsum("mji,mj->mi", frame, middle[:, 13 + 2 * q :])
    pull = np.where(middle[:, 0] < contact, frame[:, :, 2] @ wrench[:3], 0.0)
    cos, sin = np.cos(theta), np.sin(theta)
    w = np.stack((cos * free[..., 0] - sin * free[..., 1], sin * free[..., 0] + cos * free[..., 1]), axis=-1)
    total = bend.sum(axis=1)
    k = (np.einsum("mi,mik->mk", bend, w) + moment[:, :2]) / total[:, None]

    # Integrand of 2 Q in the middle of each element: a form of the values (a, b, psi) and slopes (da, db, dpsi).
    size = q + 2
    form = np.zeros((h.size, 2 * size, 2 * size))
    a, b, da, db = 0, 1, size, size + 1
    form[:, da, da] = form[:, db, db] = total
    level = MIN_ENERGY_DROP * (total / path[-1, 0] ** 2 + np.linalg.norm(wrench[:3]))
    form[:, a, a] = pull - k[:, 1] * moment[:, 1] + level
    form[:, b, b] = pull - k[:, 0] * moment[:, 0] + level
    form[:, a, b] = form[:, b, a] = 0.5 * (k[:, 0] * moment[:, 1] + k[:, 1] * moment[:, 0])
    form[:, a, db] = form[:, db, a] = -0.5 * moment[:, 2]
    form[:, b, da] = form[:, da, b] = 0.5 * moment[:, 2]
    for i in range(q):
        psi, dpsi = 2 + i, size + 2 + i
        form[:, psi, psi] = bend[:, i] * (np.einsum("mk,mk->m", k, w[:, i]) + MIN_ENERGY_DROP / path[-1, 0] ** 2)
        form[:, da, psi] = form[:, psi, da] = bend[:, i] * w[:, i, 1]
        form[:, db, psi] = form[:, psi, db] = -bend[:, i] * w[:, i, 0]
        strain = np.zeros((h.size, 2 * size))
        strain[:, dpsi], strain[:, b], strain[:, a] = 1.0, k[:, 0], -k[:, 1]
        form += twist[:, i, None, None] * strain[:, :, None] * strain[:, None, :]

    values, slopes, across = form[:, :size, :size], form[:, size:, size:], form[:, :size, size:]
    length = h[:, None, None]
    even, odd = 0.25 * length * values + slopes / length, 0.5 * across
    blocks = np.zeros((h.size + 1, size, size))
    blocks[:-1] += even - odd - odd.transpose(0, 2, 1)
    blocks[1:] += even + odd + odd.transpose(0, 2, 1)
    coupling = 0.25 * length * values - slopes / length + odd - odd.transpose(0, 2, 1)

    blocks[0, a, a] += CLAMP_STIFFNESS * total[0]
    blocks[0, b, b] += CLAMP_STIFFNESS * total[0]
    for i in range(q):
        blocks[0, 2 + i, 2 + i] += twist[0, i] * min(CLAMP_STIFFNESS, 1.0 / max(-beta[i], 1.0 / CLAMP_STIFFNESS))
        absent = np.flatnonzero(bend[:, i] == 0.0) + 1
        blocks[absent, 2 + i, 2 + i] = total[0]
    tip = path[-1, 1:10].reshape(3, 3).T @ wrench[3:]
    blocks[-1, [2, b], [b, 2]] -= 0.5 * tip[0]
    blocks[-1, [2, a], [a, 2]] += 0.5 * tip[1]

    bands = np.zeros((2 * size, size * (h.size + 1)))
    for i in range(size):
        for j in range(size):
            if i <= j:
                bands[2 * size - 1 + i - j, j::size] = blocks[:, i, j]
            bands[size - 1 + i - j, size + j :: size] = coupling[:, i, j]
    return bands
