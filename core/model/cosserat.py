"""The exact rod model, the reference for the fast model.

The exact rod is a geometrically exact Cosserat rod model (Rucker, Jones, Webster 2010) in the frame of the innermost
tube. A quaternion is the orientation; moment and force are in the moving frame:

    m' = -u x m - e_z x n,   n = R^T F,   m_z = sum_i GJ_i u_iz,   psi_i' = u_iz - u_1z,

Classical Runge-Kutta steps integrate these equations with negligible truncation error. A shooting method with Newton
steps satisfies the conditions at the tip. The exact rod shares only the description of the robot with `propagation`,
not its variables, frames, integrator or derivatives. The virtual lab also uses it to simulate the real robot.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.errors import NoSolution, NotFinite
from core.robot.robot import Array, Indices, Layout, Robot, positive


class Rod(NamedTuple):
    """An exactly solved robot; world frame."""

    tip: Array  #: (3,) position of the tip [m]
    rotation: Array  #: (3, 3) frame of the innermost tube at the tip
    torsion: Array  #: (q,) torsion u_iz of each tube at the plate [1/m]
    unknowns: Array  #: (q + 2,) m_x, m_y [N m] and u_iz [1/m] at the plate, the start values of a warm start
    chord: Array  #: (q + 2, q + 2) inverse of the end conditions' derivative, for the next Newton solve
    iterations: int


@dataclass(frozen=True)
class ExactRod:
    """Solver of the exact rod for one robot."""

    robot: Robot
    step: float = 0.002  #: longest Runge-Kutta step [m]; the error at 2 mm is below 1e-9 m
    tolerance: float = 1e-9  #: largest violation of the end conditions [1/m and N m]

    def __post_init__(self) -> None:
        positive("step", self.step, "m")

    def solve(self, joints: Array, wrench: Array, near: Rod | None = None, contact: float | None = None) -> Rod:
        """Solve for joints (n,) [rad or m] under a force and a tip moment (6,), world frame [N, N m].

        The force acts at arc length `contact` from the plate [m]; None is the tip.

        Raises:
            PoseError: the pose is invalid, or `contact` is beyond the tubes.
            NotFinite: the wrench is not finite.
            NoSolution: no solution was reached, not even with the load applied in 64 steps.

        """
        self.robot.check_pose(joints)
        alpha, beta = self.robot.tube_poses(joints)
        return self.solve_tubes(alpha, beta, wrench, near, self.robot.check_contact(joints, contact))

    def solve_tubes(
        self, alpha: Array, beta: Array, wrench: Array, near: Rod | None = None, contact: float = math.inf
    ) -> Rod:
        """Solve for the tubes' rotations (q,) [rad] and proximal ends (q,) [m]."""
        if wrench.shape != (6,) or not np.isfinite(wrench).all():
            raise NotFinite(f"tip wrench {wrench.tolist()} [N, N m] must be six finite numbers")
        size = len(self.robot.tubes) + 2
        if near is not None:
            rod = self._shoot(alpha, beta, wrench, contact, near.unknowns, near.chord)
            if rod is not None:
                return rod
        for increments in (1, 4, 16, 64):
            unknowns, rod = np.zeros(size), None
            for number in range(1, increments + 1):
                part = wrench * (number / increments)
                rod = self._shoot(alpha, beta, part, contact, unknowns, np.zeros((size, size)))
                if rod is None:
                    break
                unknowns = rod.unknowns
            if rod is not None:
                return rod
        raise NoSolution(f"the exact rod found no shape under {wrench[:3].tolist()} N, {wrench[3:].tolist()} N m")

    def stability(self, joints: Array, wrench: Array, rod: Rod, contact: float | None = None) -> float:
        """Return the determinant of the end conditions by the unknowns at a solution, by central differences.

        This number corresponds to `Solution.stability`: 1 for straight tubes without load, 0 where the tubes snap.
        """
        alpha, beta = self.robot.tube_poses(joints)
        position = self.robot.check_contact(joints, contact)
        size = len(self.robot.tubes) + 2
        columns: list[Array] = []
        for k in range(size):
            ends = np.empty((2, size))
            half = 1e-4 * np.eye(size)[k] * (self.robot.layout.stiffness[0, 0] if k < 2 else 1.0)
            for row, unknowns in zip(ends, (rod.unknowns + half, rod.unknowns - half), strict=True):
                _integrate(
                    self.robot.layout, alpha, beta, to_plate(self.robot.layout, wrench), position, unknowns, self.step,
                    np.empty(9 + 2 * (size - 2)), row, np.empty((0, 7)),
                )  # fmt: skip
            columns.append((ends[0] - ends[1]) / (2.0 * half[k]))
        return float(np.linalg.det(np.column_stack(columns)))

    def _shoot(
        self, alpha: Array, beta: Array, wrench: Array, contact: float, guess: Array, chord: Array
    ) -> Rod | None:
        unknowns, inverse, tip, rotation, iterations, residual = shoot(
            self.robot.layout, alpha, beta, wrench, contact, guess, chord, self.step, self.tolerance
        )
        if not residual <= self.tolerance:
            return None
        return Rod(tip, rotation, unknowns[2:], unknowns, inverse, iterations)


@compiled
def to_plate(layout: Layout, wrench: Array) -> Array:
    """Return force and moment (6,) of a world-frame wrench in the plate's axes, the axes of the rod equations."""
    result = np.zeros(6)
    for i in range(3):
        for k in range(3):
            result[i] += layout.base[3 * k + i] * wrench[k]
            result[3 + i] += layout.base[3 * k + i] * wrench[3 + k]
    return result


@compiled
def to_world(layout: Layout, y: Array) -> tuple[Array, Array]:
    """Return tip (3,) [m] and tip frame (3, 3) in world coordinates from the state `y` at the tip."""
    own, tip, rotation = np.empty((3, 3)), np.empty(3), np.zeros((3, 3))
    _rotation(y, own)
    for i in range(3):
        tip[i] = layout.base[9 + i]
        for k in range(3):
            tip[i] += layout.base[3 * i + k] * y[4 + k]
            for j in range(3):
                rotation[i, j] += layout.base[3 * i + k] * own[k, j]
    return tip, rotation


@compiled
def _rotation(y: Array, out: Array) -> None:
    """Write the rotation matrix of the quaternion y[:4] = (w, x, y, z), of any nonzero length, to `out`."""
    w, a, b, c = y[0], y[1], y[2], y[3]
    scale = 2.0 / (w * w + a * a + b * b + c * c)
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - scale * (b * b + c * c), scale * (a * b - w * c), scale * (a * c + w * b)
    out[1, 0], out[1, 1], out[1, 2] = scale * (a * b + w * c), 1.0 - scale * (a * a + c * c), scale * (b * c - w * a)
    out[2, 0], out[2, 1], out[2, 2] = scale * (a * c - w * b), scale * (b * c + w * a), 1.0 - scale * (a * a + b * b)


@compiled
def slope(
    y: Array, out: Array, turn: Array, bend: Array, twist: Array, ratio: Array, curvature: Array, softness: float,
    force: Array,
) -> None:  # fmt: skip
    """Write the derivative of y = quaternion (4), r (3), m_x, m_y, u_iz (q), psi_i (q) along the arc length.

    `bend` is EI and `twist` GJ of each tube (q,), 0 for a tube that is absent at this cross-section. `ratio` is EI /
    GJ, 0 for an absent tube. `softness` is 1 / sum EI. `force` is the force (3,) beyond the cross-section, plate's
    axes. `turn` (q, 2) is scratch memory for cosine and sine of psi_i; psi of the innermost tube is 0.
    """
    q = bend.shape[0]
    w, a, b, c = y[0], y[1], y[2], y[3]
    scale = 2.0 / (w * w + a * a + b * b + c * c)
    dx, dy, dz = scale * (a * c + w * b), scale * (b * c - w * a), 1.0 - scale * (a * a + b * b)
    fx, fy, fz = force[0], force[1], force[2]
    nx = fx + scale * (-fx * (b * b + c * c) + fy * (a * b + w * c) + fz * (a * c - w * b))
    ny = fy + scale * (fx * (a * b - w * c) - fy * (a * a + c * c) + fz * (b * c + w * a))
    uz = y[9]
    ux, uy, mz = y[7] + bend[0] * curvature[0, 0], y[8] + bend[0] * curvature[0, 1], twist[0] * uz
    for i in range(1, q):
        if ratio[i] > 0.0:
            cos, sin = np.cos(y[9 + q + i]), np.sin(y[9 + q + i])
            turn[i, 0], turn[i, 1] = cos, sin
            ux += bend[i] * (cos * curvature[i, 0] - sin * curvature[i, 1])
            uy += bend[i] * (sin * curvature[i, 0] + cos * curvature[i, 1])
            mz += twist[i] * y[9 + i]
    ux, uy = softness * ux, softness * uy
    out[0] = 0.5 * (-a * ux - b * uy - c * uz)
    out[1] = 0.5 * (w * ux + b * uz - c * uy)
    out[2] = 0.5 * (w * uy - a * uz + c * ux)
    out[3] = 0.5 * (w * uz + a * uy - b * ux)
    out[4], out[5], out[6] = dx, dy, dz
    out[7] = -(uy * mz - uz * y[8]) + ny
    out[8] = -(uz * y[7] - ux * mz) - nx
    out[9], out[9 + q] = ratio[0] * (ux * curvature[0, 1] - uy * curvature[0, 0]), 0.0
    for i in range(1, q):
        out[9 + i], out[9 + q + i] = 0.0, 0.0
        if ratio[i] > 0.0:
            cos, sin = turn[i, 0], turn[i, 1]
            uix, uiy = cos * ux + sin * uy, cos * uy - sin * ux
            out[9 + i] = ratio[i] * (uix * curvature[i, 1] - uiy * curvature[i, 0])
            out[9 + q + i] = y[9 + i] - uz


@compiled
def start_state(layout: Layout, alpha: Array, beta: Array, unknowns: Array, y: Array, section: Indices) -> float:
    """Set the state `y` and each tube's section index at the plate; return the innermost tube's angle there [rad]."""
    q = layout.counts.shape[0]
    theta = float(alpha[0] - beta[0] * unknowns[2])
    y[:] = 0.0
    y[0], y[3] = np.cos(0.5 * theta), np.sin(0.5 * theta)
    # The unknown moment is in the plate's axes, so a rotation of the innermost tube does not change it.
    y[7] = np.cos(theta) * unknowns[0] + np.sin(theta) * unknowns[1]
    y[8] = np.cos(theta) * unknowns[1] - np.sin(theta) * unknowns[0]
    section[:] = 0
    for i in range(q):
        y[9 + i] = unknowns[2 + i]
        y[9 + q + i] = alpha[i] - beta[i] * unknowns[2 + i] - theta
        while section[i] < layout.counts[i] and beta[i] + layout.ends[i, section[i]] <= 0.0:
            section[i] += 1
    return theta


@compiled
def present(layout: Layout, beta: Array, section: Indices, bend: Array, twist: Array, ratio: Array, curvature: Array,
    ) -> tuple[float, int, float]:  # fmt: skip
    """Set stiffness and curvature of the tubes present; return the next section end [m], its tube, and sum EI."""
    end, end_tube, total = np.inf, -1, 0.0
    for i in range(bend.shape[0]):
        bend[i] = twist[i] = ratio[i] = 0.0
        if section[i] < layout.counts[i]:
            section_end = beta[i] + layout.ends[i, section[i]]
            if section_end < end:
                end, end_tube = section_end, i
            bend[i], ratio[i] = layout.stiffness[i, 0], layout.stiffness[i, 1]
            twist[i] = bend[i] / ratio[i]
            curvature[i, 0] = layout.curvatures[i, section[i], 0]
            curvature[i, 1] = layout.curvatures[i, section[i], 1]
            total += bend[i]
    return end, end_tube, total


@compiled
def put_point(path: Array, at: int, arc: float, y: Array) -> int:
    """Write arc length, position and tangent of state `y` to row `at` of `path` (m, 7); return the next row.

    A path without a free row is left unchanged.
    """
    if at >= path.shape[0]:
        return at
    w, a, b, c = y[0], y[1], y[2], y[3]
    scale = 2.0 / (w * w + a * a + b * b + c * c)
    path[at, 0] = arc
    path[at, 1], path[at, 2], path[at, 3] = y[4], y[5], y[6]
    path[at, 4], path[at, 5] = scale * (a * c + w * b), scale * (b * c - w * a)
    path[at, 6] = 1.0 - scale * (a * a + b * b)
    return at + 1


def path_rows(robot: Robot, step: float) -> Array:
    """Return NaN rows (m, 7) that suffice for the centre line of a robot with integration steps of `step` [m]."""
    steps = sum(int(tube.length / step) + 1 for tube in robot.tubes)
    return np.full((steps + robot.layout.ends.size + 2, 7), np.nan)


def world_path(robot: Robot, path: Array) -> Array:
    """Return the rows of a centre line in the plate's axes that are not NaN, in the world frame (k, 7)."""
    rows = path[np.isfinite(path[:, 0])].copy()
    base, rotation = np.array(robot.base.position), robot.base.rotation
    rows[:, 1:4] = rows[:, 1:4] @ rotation.T + base
    rows[:, 4:7] = rows[:, 4:7] @ rotation.T
    return rows


@compiled
def trace(
    layout: Layout, alpha: Array, beta: Array, world_wrench: Array, contact: float, unknowns: Array, step: float,
    path: Array,
) -> None:  # fmt: skip
    """Write the centre line of solved `unknowns` to `path` (m, 7), in the plate's axes."""
    q = layout.counts.shape[0]
    wrench = to_plate(layout, world_wrench)
    y, ends = np.empty(9 + 2 * q), np.empty(q + 2)
    _integrate(layout, alpha, beta, wrench, contact, unknowns, step, y, ends, path)


@compiled
def _integrate(
    layout: Layout, alpha: Array, beta: Array, wrench: Array, contact: float, unknowns: Array, step: float,
    y: Array, ends: Array, path: Array,
) -> None:  # fmt: skip
    """Integrate from the plate to the tip, in the plate's axes; `ends` (q + 2) receives the end conditions.

    `path` (m, 7) receives the centre line as `put_point` writes it; it may have no rows.
    """
    force = wrench.copy()  # force beyond the current cross-section; only the first three elements are used
    q = layout.counts.shape[0]
    section, memory = np.zeros(q, np.int64), np.zeros((3, q))
    bend, twist, ratio = memory[0], memory[1], memory[2]
    curvature, turn = np.zeros((q, 2)), np.empty((q, 2))
    start_state(layout, alpha, beta, unknowns, y, section)
    stages = np.empty((5, y.size))
    k1, k2, k3, k4, at = stages[0], stages[1], stages[2], stages[3], stages[4]
    start = 0.0
    count = put_point(path, 0, 0.0, y)
    while True:
        end, end_tube, total = present(layout, beta, section, bend, twist, ratio, curvature)
        if end_tube < 0:
            break
        if contact < end:
            end, end_tube = contact, -1
        steps = int(np.ceil((end - start) / step))
        h = (end - start) / max(steps, 1)
        softness = 1.0 / total
        for number in range(steps):
            slope(y, k1, turn, bend, twist, ratio, curvature, softness, force)
            for i in range(y.size):
                at[i] = y[i] + 0.5 * h * k1[i]
            slope(at, k2, turn, bend, twist, ratio, curvature, softness, force)
            for i in range(y.size):
                at[i] = y[i] + 0.5 * h * k2[i]
            slope(at, k3, turn, bend, twist, ratio, curvature, softness, force)
            for i in range(y.size):
                at[i] = y[i] + h * k3[i]
            slope(at, k4, turn, bend, twist, ratio, curvature, softness, force)
            for i in range(y.size):
                y[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
            count = put_point(path, count, start + (number + 1) * h, y)
        start = end
        if end_tube >= 0:
            section[end_tube] += 1
        else:
            contact = np.inf
            force[:3] = 0.0
    rotation = np.empty((3, 3))
    _rotation(y, rotation)
    for i in range(2):
        moment = rotation[0, i] * wrench[3] + rotation[1, i] * wrench[4] + rotation[2, i] * wrench[5]
        ends[i] = y[7 + i] - moment
    for i in range(q):
        ends[2 + i] = y[9 + i]
    axial = rotation[0, 2] * wrench[3] + rotation[1, 2] * wrench[4] + rotation[2, 2] * wrench[5]
    ends[2] -= axial * layout.stiffness[0, 1] / layout.stiffness[0, 0]


@compiled
def shoot(
    layout: Layout, alpha: Array, beta: Array, world_wrench: Array, contact: float, guess: Array, chord: Array,
    step: float, tolerance: float,
) -> tuple[Array, Array, Array, Array, int, float]:  # fmt: skip
    """Solve for the unknowns with the chord method: Newton steps that reuse the inverse derivative (the chord).

    The derivative is computed by differences, and recomputed when convergence is slow.

    Returns unknowns, chord, tip, frame, number of integrations and the residual of the end conditions at that tip. A
    residual above `tolerance` means failure. The returned unknowns include one more chord step, so that later guesses
    computed from them do not contain the tolerated error.
    """
    q = layout.counts.shape[0]
    size = q + 2
    wrench = to_plate(layout, world_wrench)
    y, ends, moved, correction = np.empty(9 + 2 * q), np.empty(size), np.empty(size), np.empty(size)
    unknowns, trial, inverse, nowhere = guess.copy(), guess.copy(), chord.copy(), np.empty((0, 7))
    _integrate(layout, alpha, beta, wrench, contact, unknowns, step, y, ends, nowhere)
    residual = largest(ends)
    iterations = 1
    recompute = not inverse.any()
    while residual > tolerance and iterations < 60:
        if recompute:
            matrix = np.empty((size, size))
            for k in range(size):
                copy(unknowns, trial)
                trial[k] += 1e-6
                _integrate(layout, alpha, beta, wrench, contact, trial, step, y, moved, nowhere)
                for i in range(size):
                    matrix[i, k] = (moved[i] - ends[i]) / 1e-6
            if not 1e-30 <= abs(_determinant(matrix.copy())) < np.inf:
                return unknowns, inverse, *to_world(layout, y), iterations, np.inf
            renewed = np.linalg.inv(matrix)
            for k in range(size):
                copy(renewed[k], inverse[k])
        times(inverse, ends, correction)
        fraction = 1.0
        while True:
            for i in range(size):
                trial[i] = unknowns[i] - fraction * correction[i]
            _integrate(layout, alpha, beta, wrench, contact, trial, step, y, moved, nowhere)
            iterations += 1
            after = largest(moved)
            if after < residual or (not recompute) or fraction < 1e-3:
                break
            fraction *= 0.5
        if after < residual:
            recompute = after > 0.1 * residual
            copy(trial, unknowns)
            copy(moved, ends)
            residual = after
        elif recompute:
            break
        else:
            recompute = True
    times(inverse, ends, correction)
    for i in range(size):
        unknowns[i] -= correction[i]
    return unknowns, inverse, *to_world(layout, y), iterations, residual


@compiled
def _determinant(matrix: Array) -> float:
    """Return the determinant by elimination, which overwrites the matrix; NaN if the matrix contains one."""
    size, determinant = matrix.shape[0], 1.0
    for k in range(size):
        pivot = k
        for i in range(k + 1, size):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if matrix[pivot, k] == 0.0:
            return 0.0
        for j in range(k, size):
            matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        determinant *= matrix[k, k] if pivot == k else -matrix[k, k]
        for i in range(k + 1, size):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, size):
                matrix[i, j] -= factor * matrix[k, j]
    return determinant


@compiled
def largest(values: Array) -> float:
    """Return the largest magnitude; NaN if any value is NaN."""
    largest = 0.0
    for i in range(values.size):
        if not abs(values[i]) <= largest:
            largest = abs(values[i])
        if np.isnan(largest):
            break
    return largest


@compiled
def times(matrix: Array, vector: Array, out: Array) -> None:
    """Write matrix times vector to `out`; the loop is faster than a library call for small matrices."""
    for i in range(out.size):
        out[i] = 0.0
        for k in range(vector.size):
            out[i] += matrix[i, k] * vector[k]
