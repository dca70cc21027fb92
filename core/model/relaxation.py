"""Elastic energy of the robot: whether a shape is stable, and relaxation to a stable shape.

**Stability.** A shape is stable if every small change of the shape increases the energy: the second variation Q of the
energy is positive. A change with Q < 0 is a negative direction. The largest number of linearly independent negative
directions is the Morse index; by Jacobi's condition it is the number of conjugate points between tip and plate. A
stable shape has the index 0. The sign of the stability margin `Solution.stability` (a determinant) only shows whether
the index is even or odd. This module therefore counts the negative directions, for the whole length of the robot in one
matrix.

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

**Relaxation.** Newton's method for the base unknowns (torsion and moment at the plate) fails where tubes snap, after a
loss of stability, and for long tubes whose distal ends depend on the last digit of the base torsion. In these cases
minimising the energy still finds a shape. The energy has a minimum for every pose and every force, so a stable shape
always exists. The tubes are cut into elements of length h with curvature k_e (2) about axes that do not twist. Tube i
has the rotation theta_i at the elements' ends and the rotated precurvature w_i. The energy E, for a force F at the
position r, is

    E = sum_e h (1/2 sum_i EI_i |k_e|^2 - k_e . sum_i EI_i w_i(theta_i)) + sum 1/2 GJ_i (d theta_i)^2 / h
        + sum_i 1/2 GJ_i (theta_i(0) - alpha_i)^2 / -beta_i - F . r(k).

The minimisation takes Newton steps. Near a saddle of the energy, stiffness is added until the step decreases the
energy; each step is shortened until the energy falls. The violation of the end conditions is of second order in the
elements' length. The relaxed shape is accurate enough as a start for Newton's method.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from core.robot.robot import FLUSH_TOLERANCE_M, Array, Indices, Robot

#: Stiffness of the spring that represents a clamped end, divided by the stiffness EI or GJ of the tubes [1/m].
CLAMP_STIFFNESS = 1e9
#: Smallest energy drop of a negative direction, as a fraction of (EI / length^2 + force) times the square of the
#: change. The threshold excludes discretisation errors and neutral directions, in which the energy does not change. For
#: example, a straight tube bends equally to any side.
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

    if path[-1, 0] <= FLUSH_TOLERANCE_M:
        return 0  # all tubes are flush with the plate: nothing can bend
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
    ends = robot.tube_ends(joints)
    pull = np.where(middle[:, 0] < (contact if contact < np.inf else ends[0]), frame[:, :, 2] @ wrench[:3], 0.0)
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
        absent = np.flatnonzero(np.append(bend[0, i], bend[:, i]) == 0.0)  # also at the plate if the tube is flush
        blocks[absent, 2 + i, 2 + i] = total[0]
    last = int(np.argmin(np.abs(path[:, 0] - ends[0])))
    tip = path[last, 1:10].reshape(3, 3).T @ wrench[3:]
    blocks[last, [2, b], [b, 2]] -= 0.5 * tip[0]
    blocks[last, [2, a], [a, 2]] += 0.5 * tip[1]

    bands = np.zeros((2 * size, size * (h.size + 1)))
    for i in range(size):
        for j in range(size):
            if i <= j:
                bands[2 * size - 1 + i - j, j::size] = blocks[:, i, j]
            bands[size - 1 + i - j, size + j :: size] = coupling[:, i, j]
    return bands


#: Largest number of steps of the minimisation, and largest rotation or bend in one step [rad].
MAX_STEPS, MAX_STEP_RAD = 50, 0.6
#: The minimisation has converged when its step is shorter than this [rad].
REST_STEP_RAD = 1e-4
#: Largest number of steps of a motion under a moment, and of pushes away from a saddle.
MAX_MOTION_STEPS, MAX_PUSHES = 100, 3
#: Size of the perturbation that moves the tubes away from an unstable equilibrium [rad].
PERTURBATION_RAD = 1e-2


class ElementChain(NamedTuple):
    """A robot at a pose and under a force as m elements, in the plate's axes."""

    ends: Array  #: (m + 1,) arc lengths [m]
    bend: Array  #: (m, q) bending stiffness EI of the tubes, 0 where a tube is absent [N m^2]
    twist: Array  #: (m, q) torsional stiffness GJ of the tubes [N m^2]
    free: Array  #: (m, q, 2) precurvature in the tubes' axes [1/m]
    alpha: Array  #: (q,) rotations at the proximal ends [rad]
    hidden: Array  #: (q,) length of each tube behind the plate [m]
    force: Array  #: (3,) force on the robot [N]
    moment: Array  #: (3,) moment at the tip [N m]
    pulled: int  #: number of elements between the plate and the point at which the force acts
    last: Indices  #: (q,) the node at which each tube ends


def cut(robot: Robot, joints: Array, wrench: Array, contact: float, longest: float) -> ElementChain:
    """Return the robot under a wrench (6,), world frame [N, N m], as elements of at most `longest` [m].

    Element ends are at the ends of all tube sections and at the point where the force acts.
    """
    alpha, beta = robot.tube_poses(joints)
    ends = np.concatenate([beta[i] + robot.layout.ends[i, :count] for i, count in enumerate(robot.layout.counts)])
    reach = max(contact if contact < np.inf else float(robot.tube_ends(joints)[0]), 0.0)
    marks = np.unique(np.concatenate(([0.0, reach], ends[ends > 0.0])))
    marks = marks[np.append(np.diff(marks) > 1e-9, True)]
    parts: list[Array] = [
        np.linspace(start, end, max(1, int(np.ceil((end - start) / longest))) + 1)[1:]
        for start, end in pairwise(marks.tolist())
    ]
    nodes = np.concatenate((marks[:1], *parts))
    bend, free = precurvature(robot, beta, 0.5 * (nodes[1:] + nodes[:-1]))
    base = robot.layout.base[:9].reshape(3, 3)
    return ElementChain(
        nodes, bend, bend / robot.layout.stiffness[:, 1], free, alpha, -beta, base.T @ wrench[:3], base.T @ wrench[3:],
        int(np.argmin(np.abs(nodes - reach))), np.count_nonzero(bend, axis=0),
    )  # fmt: skip


def settle(chain: ElementChain, theta: Array, moment: Array) -> tuple[Array, Array] | None:
    """Simulate the motion of a viscously damped robot from a given shape to rest; arguments and result as in `relax`.

    A moment at the tip has no potential energy, so no minimum exists to search for. The motion is D x' = -g(x), where g
    is the gradient of the energy minus the work of the load. The implicit steps grow near rest, where they become
    Newton steps. At an unstable equilibrium the shape is pushed away, so the motion does not end there.
    """
    h, moved = np.diff(chain.ends), _moved(chain)
    k = (np.einsum("mi,mik->mk", chain.bend, _turned(chain, theta)) + moment) / chain.bend.sum(axis=1)[:, None]
    at = np.concatenate(((k * h[:, None]).ravel(), theta.ravel()[moved]))
    duration, drag, before, pushes = 1.0, np.empty(0), np.inf, 0
    for _ in range(MAX_MOTION_STEPS):
        _, slope, curve = _energy(chain, at, theta, moved)
        push, stiffening = _tip_moment(chain, at, moved)
        slope, curve = slope - push, curve - stiffening
        drag = np.maximum(np.abs(np.diag(curve)), 1e-12) if not drag.size else drag
        size = float(np.linalg.norm(slope / drag))
        duration = min(duration * min(max(before / max(size, 1e-300), 0.5), 4.0), 1e9)
        before = size
        step = np.linalg.solve(curve + np.diag(drag / duration), -slope)
        longest = float(np.abs(step).max())
        if longest > MAX_STEP_RAD:
            duration *= 0.5
            step *= MAX_STEP_RAD / longest
        elif longest < REST_STEP_RAD and duration > 1e3:
            values, directions = np.linalg.eig(curve / drag[:, None])
            rates: Array = np.real(values)
            if rates.min() > 0.0:
                theta = theta.copy()
                theta.ravel()[moved] = at[2 * h.size :]
                return at[: 2 * h.size].reshape(-1, 2) / h[:, None], theta
            # At rest on a saddle: push the shape away, and let it move slowly.
            if (pushes := pushes + 1) > MAX_PUSHES:
                return None
            weakest: Array = np.real(directions[:, int(np.argmin(rates))])
            step, duration, before = weakest * (PERTURBATION_RAD / np.abs(weakest).max()), 1.0, np.inf
        at = at + step
    return None


def relax(chain: ElementChain, theta: Array, moment: Array) -> tuple[Array, Array] | None:
    """Minimise the elastic energy, starting from a given shape.

    Args:
        chain: the robot.
        theta: rotations of the tubes at the nodes (m + 1, q) [rad].
        moment: bending moment of the elements (m, 2), in axes that do not twist [N m].

    Returns:
        Curvature (m, 2) [1/m] and theta (m + 1, q) at the minimum; None without convergence.

    """
    h = np.diff(chain.ends)
    moved = _moved(chain)
    k = (np.einsum("mi,mik->mk", chain.bend, _turned(chain, theta)) + moment) / chain.bend.sum(axis=1)[:, None]
    # Bending is measured in radians per element, like twist, so that all steps have the same unit.
    at = np.concatenate(((k * h[:, None]).ravel(), theta.ravel()[moved]))
    energy, slope, curve = _energy(chain, at, theta, moved)
    for _ in range(MAX_STEPS):
        step, firm = _down(slope, curve)
        if np.abs(step).max() < REST_STEP_RAD:
            weakest = step if firm else np.linalg.eigh(curve)[1][:, 0]
            step = weakest * (PERTURBATION_RAD / np.abs(weakest).max(initial=1e-300))
            # In a neutral direction the energy does not fall. For example, a straight tube bends equally to any side.
            if firm or not _energy(chain, at + step, theta, moved)[0] < energy - 1e-9 * abs(energy):
                theta = theta.copy()
                theta.ravel()[moved] = at[2 * h.size :]
                return at[: 2 * h.size].reshape(-1, 2) / h[:, None], theta
        step *= min(1.0, MAX_STEP_RAD / float(np.abs(step).max()))
        fraction = 1.0
        while True:
            trial = _energy(chain, at + fraction * step, theta, moved)
            # Near the minimum, differences in the energy's last digits are rounding.
            if trial[0] <= energy + 1e-13 * abs(energy):
                break
            fraction *= 0.5
            if fraction < 1e-6:
                return None
        at = at + fraction * step
        energy, slope, curve = trial
    return None


def _down(slope: Array, curve: Array) -> tuple[Array, bool]:
    """Return Newton's step, and whether the Hessian `curve` is positive definite; if not, add stiffness until it is."""
    from scipy.linalg import LinAlgError, cho_factor, cho_solve  # pyright: ignore  - slow to import

    added = 0.0
    while True:
        stiffened = curve + added * np.eye(slope.size)
        try:
            return -cho_solve(cho_factor(stiffened), slope), added == 0.0  # pyright: ignore
        except LinAlgError:
            added = max(4.0 * added, 1e-7 * float(np.abs(curve).max()))


def base_unknowns(robot: Robot, chain: ElementChain, k: Array, theta: Array) -> Array:
    """Return start values for Newton's method from a relaxed shape: u_iz(0) [1/m], M(0) [N m], world frame (q + 3,)."""
    h = np.diff(chain.ends)
    # The torsion at the plate is the sum of the torques from bending along the tube.
    twisted = chain.bend * h[:, None] * np.einsum("mk,mik->mi", k, _sideways(chain, theta))
    positions, frames, _ = _curve(k * h[:, None], h)
    twist = robot.layout.stiffness[:, 0] / robot.layout.stiffness[:, 1]
    torsion = twisted.sum(axis=0) / twist
    torsion[0] += frames[chain.last[0], :, 2] @ chain.moment / twist[0]
    base = robot.layout.base[:9].reshape(3, 3)
    return np.concatenate((torsion, base @ (_cross(positions[chain.pulled], chain.force) + chain.moment)))


def tip(robot: Robot, chain: ElementChain, k: Array) -> Array:
    """Return the tip's position (3,), world frame [m], at curvatures `k` (m, 2) of the elements [1/m]."""
    h = np.diff(chain.ends)
    base = robot.layout.base
    return base[:9].reshape(3, 3) @ _curve(k * h[:, None], h)[0][chain.last[0]] + base[9:]


def _moved(chain: ElementChain) -> Indices:
    """Return the indices of the free values in theta: all but those clamped at the plate or beyond a tube's end."""
    node = np.arange(chain.ends.size)[:, None]
    free = (node <= chain.last) & ((node > 0) | ((chain.hidden > 0.0) & (chain.last > 0)))
    return np.flatnonzero(free.ravel())


def _turned(chain: ElementChain, theta: Array) -> Array:
    """Return the rotated precurvatures w_i (m, q, 2) in the elements."""
    middle = 0.5 * (theta[1:] + theta[:-1])
    cos, sin = np.cos(middle), np.sin(middle)
    x, y = chain.free[..., 0], chain.free[..., 1]
    return np.stack((cos * x - sin * y, sin * x + cos * y), axis=-1)


def _sideways(chain: ElementChain, theta: Array) -> Array:
    """Return the derivative of w_i by theta_i (m, q, 2)."""
    w = _turned(chain, theta)
    return np.stack((-w[..., 1], w[..., 0]), axis=-1)


def _curve(bent: Array, h: Array) -> tuple[Array, Array, Array]:
    """Return positions (m + 1, 3) and frames (m + 1, 3, 3) of the nodes, and the chords, for bends (m, 2) [rad]."""
    positions, frames, middles = np.zeros((h.size + 1, 3)), np.empty((h.size + 1, 3, 3)), np.empty((h.size, 3))
    frames[0] = np.eye(3)
    whole, half = _rotations(bent), _rotations(0.5 * bent)
    for e in range(h.size):
        middles[e] = frames[e] @ half[e][:, 2] * h[e]
        positions[e + 1] = positions[e] + middles[e]
        frames[e + 1] = frames[e] @ whole[e]
    return positions, frames, middles


def _rotations(bent: Array) -> Array:
    """Return the rotations (m, 3, 3) by vectors (x, y, 0) [rad]."""
    cross, size = _crosses(bent)
    first = np.sinc(size / np.pi)
    second = 0.5 * np.sinc(0.5 * size / np.pi) ** 2
    return np.eye(3) + first[:, None, None] * cross + second[:, None, None] * cross @ cross


def _spins(bent: Array) -> Array:
    """Return the left Jacobians (m, 3, 2) of the rotations by vectors (x, y, 0): rotation per change of x and y."""
    cross, size = _crosses(bent)
    second = 0.5 * np.sinc(0.5 * size / np.pi) ** 2
    third = np.where(size < 1e-3, 1.0 / 6.0, (1.0 - np.sinc(size / np.pi)) / np.maximum(size, 1e-3) ** 2)
    whole = np.eye(3) + second[:, None, None] * cross + third[:, None, None] * cross @ cross
    return whole[:, :, :2]


def _crosses(bent: Array) -> tuple[Array, Array]:
    cross = np.zeros((bent.shape[0], 3, 3))
    cross[:, 0, 2], cross[:, 2, 0] = bent[:, 1], -bent[:, 1]
    cross[:, 1, 2], cross[:, 2, 1] = -bent[:, 0], bent[:, 0]
    return cross, np.hypot(bent[:, 0], bent[:, 1])


def _energy(chain: ElementChain, at: Array, rest: Array, moved: Indices) -> tuple[float, Array, Array]:
    """Return the energy, its gradient and its Hessian by the bends (2 m) and the free values of theta."""
    h = np.diff(chain.ends)
    m, q = chain.bend.shape
    theta = rest.copy()
    theta.ravel()[moved] = at[2 * m :]
    bent = at[: 2 * m].reshape(m, 2)
    w, aside = _turned(chain, theta), _sideways(chain, theta)
    pulls = np.einsum("mi,mik->mk", chain.bend, w)
    total = chain.bend.sum(axis=1)
    turn = np.diff(theta, axis=0)
    energy = float(
        (0.5 * total / h * np.einsum("mk,mk->m", bent, bent) - np.einsum("mk,mk->m", bent, pulls)).sum()
        + (0.5 * chain.twist / h[:, None] * turn * turn).sum()
    )
    count = 2 * m + theta.size
    slope, curve = np.zeros(count), np.zeros((count, count))
    slope[: 2 * m] = (total[:, None] / h[:, None] * bent - pulls).ravel()
    index = np.arange(2 * m, dtype=np.int64)
    curve[index, index] = np.repeat(total / h, 2)
    node = 2 * m + np.arange(theta.size).reshape(m + 1, q)
    stiff = chain.twist / h[:, None]
    push = -chain.bend * np.einsum("mk,mik->mi", bent, aside)
    hard = 0.25 * chain.bend * np.einsum("mk,mik->mi", bent, w)
    np.add.at(slope, node[1:], stiff * turn + 0.5 * push)
    np.add.at(slope, node[:-1], -stiff * turn + 0.5 * push)
    np.add.at(curve, (node[1:], node[1:]), stiff + hard)
    np.add.at(curve, (node[:-1], node[:-1]), stiff + hard)
    np.add.at(curve, (node[1:], node[:-1]), hard - stiff)
    np.add.at(curve, (node[:-1], node[1:]), hard - stiff)
    element = np.arange(m, dtype=np.int64)[:, None]
    for axis in range(2):
        both = -0.5 * chain.bend * aside[..., axis]
        for nodes in (node[1:], node[:-1]):
            curve[2 * element + axis, nodes] += both
            curve[nodes, 2 * element + axis] += both
    elastic = chain.hidden > 0.0
    away = theta[0, elastic] - chain.alpha[elastic]
    spring = chain.twist[0, elastic] / chain.hidden[elastic]
    energy += float((0.5 * spring * away * away).sum())
    slope[node[0, elastic]] += spring * away
    curve[node[0, elastic], node[0, elastic]] += spring
    if chain.force.any():
        lost, arms, forms = _work(chain.force, bent[: chain.pulled], h[: chain.pulled])
        n = 2 * chain.pulled
        energy -= lost
        slope[:n] -= arms
        curve[:n, :n] -= forms
    kept = np.append(index, 2 * m + moved)
    return energy, slope[kept], curve[np.ix_(kept, kept)]


def _work(force: Array, bent: Array, h: Array) -> tuple[float, Array, Array]:
    """Return the work F . r of a force at the end of m elements, and its gradient and Hessian by their bends (2 m)."""
    positions, frames, middles = _curve(bent, h)
    turns = (frames[:-1] @ _spins(bent)).transpose(0, 2, 1)
    halves = (frames[:-1] @ (0.5 * _spins(0.5 * bent))).transpose(0, 2, 1)
    arms = (positions[-1] - positions[1:])[:, None, :]
    levers = _cross(turns, arms) + _cross(halves, middles[:, None, :])
    m = h.size
    turns, lever = turns.reshape(2 * m, 3), levers.reshape(2 * m, 3)
    # Entry (e, f) is F . (turn_e x lever_f) for element f beyond e; for f = e it is the mean of both orders.
    form = _cross(force, turns) @ lever.T
    order = np.repeat(np.arange(m, dtype=np.int64), 2)
    upper = np.where(order[:, None] < order[None, :], form, 0.0)
    within = np.where(order[:, None] == order[None, :], 0.5 * (form + form.T), 0.0)
    return float(force @ positions[-1]), lever @ force, upper + upper.T + within


def _tip_moment(chain: ElementChain, at: Array, moved: Indices) -> tuple[Array, Array]:
    """Return the generalised force (n,) of the moment at the tip, and its derivative (n, n), which is not symmetric.

    A bend of an element, or the twist of the innermost tube, turns the tip about an axis in space; the force is the
    moment's component along this axis. An axis turns with the bends before it.
    """
    h = np.diff(chain.ends)
    m, q = chain.bend.shape
    bent = at[: 2 * m].reshape(m, 2)
    _, frames, _ = _curve(bent, h)
    turns = (frames[:-1] @ _spins(bent)).transpose(0, 2, 1).reshape(2 * m, 3)
    end = int(chain.last[0])
    turns[2 * end :] = 0.0  # bends beyond the tip do not turn it
    twist = np.flatnonzero(moved == end * q)  # the innermost tube's rotation at the tip
    force, derivative = np.zeros(at.size), np.zeros((at.size, at.size))
    force[: 2 * m], force[2 * m + twist] = turns @ chain.moment, frames[end, :, 2] @ chain.moment
    order = np.repeat(np.arange(m, dtype=np.int64), 2)
    # Entry (e, f) is moment . (turn_f x turn_e) for an element f before e; for f = e it is half of that.
    form = -_cross(chain.moment, turns) @ turns.T
    share = np.where(order[:, None] > order[None, :], 1.0, np.where(order[:, None] == order[None, :], 0.5, 0.0))
    derivative[: 2 * m, : 2 * m] = share * form
    derivative[2 * m + twist, : 2 * m] = _cross(turns, frames[end, :, 2]) @ chain.moment
    return force, derivative


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product as floats; the declared type of numpy's function also includes complex numbers."""
    return np.asarray(np.cross(a, b), dtype=np.float64)
