"""The loaded model solved: base unknowns by Newton, then J and C of the solved problem, eq. (20).

Unknown at the plate are u_iz of every tube and M(0). Known at the far end: u_iz = 0 at each
tube's own end (the innermost carries the axial part of a tip moment) and M = the tip moment.
The derivative columns of the pass give the Newton step, and by the implicit function theorem the
way the unknowns themselves move with joints and load; J and C contain both parts, so that they
are the derivatives of the *solved* tip.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.errors import NoSolution, NotFinite
from core.propagation import FRAME_ROWS, propagate
from core.robot import Array, Layout, Robot, positive, tube_poses

#: A pose counts as solved when the end conditions hold to this, in 1/m and N m.
TOLERANCE = 1e-9
#: Newton passes before a solve gives up; a warm start takes two or three.
MAX_PASSES = 40
#: The paper's sub-link [m].
PAPER_SUBLINK = 0.010


class Solution(NamedTuple):
    """The loaded robot at one pose. World frame; rows of J and C: position, then rotation."""

    tip: Array  #: (3,) [m]
    rotation: Array  #: (3, 3) frame of the innermost tube at the tip
    jacobian: Array  #: (6, n) by the joints [m or rad per rad or m]
    compliance: Array  #: (6, 6) by tip force and tip moment [m or rad per N or N m]
    unknowns: Array  #: (q + 3,) u_iz(0) [1/m] and M(0) [N m]; the next warm start
    sensitivity: Array  #: (q + 3, n + 6) of the unknowns by joints, force and moment
    joints: Array  #: (n,) the pose solved for
    wrench: Array  #: (6,) the load solved for [N, N m]
    iterations: int
    residual: float  #: largest violation of an end condition [1/m or N m]


@dataclass(frozen=True)
class Statics:
    """The paper's model of one robot at one sub-link length."""

    robot: Robot
    sublink: float = PAPER_SUBLINK  #: [m]

    def __post_init__(self) -> None:
        positive("sublink", self.sublink, "m")

    def solve(self, joints: Array, wrench: Array, near: Solution | None = None) -> Solution:
        """Shape under a tip wrench.

        Args:
            joints: positions (n,) [rad or m], in the order of `robot.joints`.
            wrench: force and moment at the tip (6,), world frame [N, N m].
            near: a solution nearby, whose branch is followed; without it the load is applied
                in steps when the direct way fails.

        Raises:
            PoseError: the tubes cannot stand so.
            NotFinite: the wrench is not finite.
            NoSolution: no solution was reached.

        """
        # The compiled code does not look at lengths; what else is wrong fails to converge and is named below.
        if near is not None and wrench.shape == (6,) and joints.shape == near.joints.shape:
            solution = self._newton(joints, wrench, near)
            if solution is not None:
                return solution
        self.robot.check_pose(joints)
        if wrench.shape != (6,) or not np.isfinite(wrench).all():
            raise NotFinite(f"tip wrench {wrench.tolist()} [N, N m] must be six finite numbers")
        for increments in (1, 4, 16, 64):
            solution = self._straight(joints)
            for number in range(1, increments + 1):
                solution = self._newton(joints, wrench * (number / increments), solution)
                if solution is None:
                    break
            if solution is not None:
                return solution
        raise NoSolution(
            f"no shape found for {dict(zip(self.robot.joint_names, joints.tolist(), strict=True))}"
            f" under {wrench[:3].tolist()} N, {wrench[3:].tolist()} N m; is the load within reach of the tubes?"
        )

    def shape(self, solution: Solution) -> Array:
        """Cross-sections from the plate to the tip (m, 13 + 2q).

        A row holds arc length [m], the frame by rows (9), position (3) [m], theta_i [rad], u_iz [1/m].
        """
        q = len(self.robot.tubes)
        alpha, beta = self.robot.tube_poses(solution.joints)
        length = float(beta[0]) + self.robot.tubes[0].length
        rows = int(length / self.sublink) + 2 + int(self.robot.layout.counts.sum())
        path = np.empty((rows, 13 + 2 * q))
        state, rates = np.empty(12 + 2 * q), np.empty(0)
        passed = propagate(
            self.robot.layout, alpha, beta, solution.wrench[:3], solution.unknowns, self.sublink,
            (0.0,) * q, (), state, rates, path,
        )  # fmt: skip
        return path[:passed]

    def _straight(self, joints: Array) -> Solution:
        """Where a cold start begins: no twist, no moment, no load."""
        q, n = len(self.robot.tubes), len(self.robot.joints)
        empty = np.zeros(0)
        return Solution(
            empty, empty, empty, empty, np.zeros(q + 3), np.zeros((q + 3, n + 6)), joints, np.zeros(6), 0, 0.0
        )

    def _newton(self, joints: Array, wrench: Array, near: Solution) -> Solution | None:
        tubes, columns = self._widths
        tip, rotation, jacobian, compliance, unknowns, sensitivity, iterations, residual = _newton(
            self.robot.layout, joints, wrench, near.joints, near.wrench, near.unknowns, near.sensitivity,
            self.sublink, tubes, columns, TOLERANCE,
        )  # fmt: skip
        if not residual <= TOLERANCE:
            return None
        return Solution(
            tip, rotation, jacobian, compliance, unknowns, sensitivity,
            joints.copy(), wrench.copy(), iterations, residual,
        )  # fmt: skip

    @cached_property
    def _widths(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Numbers of tubes and of derivative columns (in whole vector registers), for the compiler."""
        q, n = len(self.robot.tubes), len(self.robot.joints)
        return (0.0,) * q, (0.0,) * (-(-(q + 3 + n + 3) // 4) * 4)


@compiled
def _newton(
    layout: Layout, joints: Array, wrench: Array,
    near_joints: Array, near_wrench: Array, near_unknowns: Array, near_sensitivity: Array,
    sublink: float, tubes: tuple[float, ...], columns: tuple[float, ...], tolerance: float,
) -> tuple[Array, Array, Array, Array, Array, Array, int, float]:  # fmt: skip
    """Newton on the base unknowns with a step check: a step that does not help is halved.

    It starts from the unknowns nearby, moved on to this pose and load by their sensitivity.
    """
    q, width, n = len(tubes), len(columns), layout.joint_tube.shape[0]
    size = q + 3
    alpha, beta, stands = tube_poses(layout, joints)
    state, rates = np.empty(12 + 2 * q), np.empty((FRAME_ROWS + 2 * q) * width)
    path = np.empty((0, 13 + 2 * q))
    tip, rotation = np.empty(3), np.empty((3, 3))
    jacobian, compliance, sensitivity = np.empty((6, n)), np.empty((6, 6)), np.empty((size, n + 6))
    force = wrench[:3]
    unknowns, trial = near_unknowns.copy(), near_unknowns.copy()
    for i in range(size):
        for j in range(n):
            trial[i] += near_sensitivity[i, j] * (joints[j] - near_joints[j])
        for j in range(6):
            trial[i] += near_sensitivity[i, n + j] * (wrench[j] - near_wrench[j])
    matrix, right = np.empty((size, size)), np.empty((size, n + 7))
    best, iterations, fraction = np.inf, 0, 1.0
    step = np.zeros(size)
    twist = layout.stiffness[0, 1] / layout.stiffness[0, 0]  # 1 / GJ of the tube that carries the tip
    if not stands:
        return tip, rotation, jacobian, compliance, unknowns, sensitivity, 0, np.inf
    while iterations < MAX_PASSES:
        propagate(layout, alpha, beta, force, trial, sublink, tubes, columns, state, rates, path)
        iterations += 1
        # End conditions: u_iz at each tube's end, and M(0) - r x F - M_tip.
        x, y, z = state[9], state[10], state[11]
        right[:q, 0] = state[12 + q :]
        right[0, 0] -= twist * (state[2] * wrench[3] + state[5] * wrench[4] + state[8] * wrench[5])
        right[q, 0] = trial[q] - (y * force[2] - z * force[1]) - wrench[3]
        right[q + 1, 0] = trial[q + 1] - (z * force[0] - x * force[2]) - wrench[4]
        right[q + 2, 0] = trial[q + 2] - (x * force[1] - y * force[0]) - wrench[5]
        residual = np.abs(right[:, 0]).max()
        if not np.isfinite(residual) or (residual > best and residual > tolerance):
            fraction *= 0.5
            if fraction < 1e-4:
                break
            for i in range(size):
                trial[i] = unknowns[i] - fraction * step[i]
            continue
        best, fraction = residual, 1.0
        unknowns[:] = trial
        _end_condition_rates(rates, wrench, state, twist, q, n, width, matrix, right)
        if not _solve_in_place(matrix, right):
            break
        if residual <= tolerance:
            for i in range(size):
                for j in range(n + 6):
                    sensitivity[i, j] = -right[i, j + 1]
            _tip_derivatives(rates, state, sensitivity, q, n, width, jacobian, compliance)
            cos, sin = np.cos(state[12]), np.sin(state[12])
            for i in range(3):
                tip[i] = state[9 + i]
                rotation[i, 0] = cos * state[3 * i] + sin * state[3 * i + 1]
                rotation[i, 1] = cos * state[3 * i + 1] - sin * state[3 * i]
                rotation[i, 2] = state[3 * i + 2]
            return tip, rotation, jacobian, compliance, unknowns, sensitivity, iterations, residual
        step[:] = right[:, 0]
        for i in range(size):
            trial[i] = unknowns[i] - step[i]
    return tip, rotation, jacobian, compliance, unknowns, sensitivity, iterations, np.inf


@compiled
def _tip_derivatives(
    rates: Array, state: Array, sensitivity: Array, q: int, n: int, width: int, jacobian: Array, compliance: Array
) -> None:
    """J and C of the solved problem: the direct part and the part through the base unknowns."""
    size = q + 3
    theta = FRAME_ROWS * width
    for row in range(6):
        out = row + 3 if row < 3 else row - 3  # the pass has rotation first
        axis = state[2 + 3 * row] if row < 3 else 0.0  # the tube turns about it in that frame
        for col in range(n + 6):
            value = 0.0
            if col < n + 3:
                value = rates[row * width + size + col] + axis * rates[theta + size + col]
            for k in range(size):
                value += (rates[row * width + k] + axis * rates[theta + k]) * sensitivity[k, col]
            if col < n:
                jacobian[out, col] = value
            else:
                compliance[out, col - n] = value


@compiled
def _end_condition_rates(
    rates: Array, wrench: Array, state: Array, twist: float, q: int, n: int, width: int, matrix: Array, right: Array
) -> None:
    """Derivatives of the end conditions by the unknowns (`matrix`) and by joints and load (`right`)."""
    size = q + 3
    force, tip, tangent, moment = wrench[:3], state[9:12], state[2:9:3], wrench[3:]
    ax = twist * (tangent[1] * moment[2] - tangent[2] * moment[1])
    ay = twist * (tangent[2] * moment[0] - tangent[0] * moment[2])
    az = twist * (tangent[0] * moment[1] - tangent[1] * moment[0])
    for col in range(size + n + 3):
        dx, dy, dz = rates[3 * width + col], rates[4 * width + col], rates[5 * width + col]
        target, place = (matrix, col) if col < size else (right, col - size + 1)
        for i in range(q):
            target[i, place] = rates[(FRAME_ROWS + q + i) * width + col]
        target[0, place] -= ax * rates[col] + ay * rates[width + col] + az * rates[2 * width + col]
        target[q, place] = -(dy * force[2] - dz * force[1])
        target[q + 1, place] = -(dz * force[0] - dx * force[2])
        target[q + 2, place] = -(dx * force[1] - dy * force[0])
    for k in range(3):
        matrix[q + k, q + k] += 1.0
        right[:, n + 4 + k] = 0.0
        right[0, n + 4 + k] = -twist * tangent[k]
        right[q + k, n + 4 + k] = -1.0
    # -r x dF
    right[q, n + 2] += tip[2]
    right[q, n + 3] -= tip[1]
    right[q + 1, n + 1] -= tip[2]
    right[q + 1, n + 3] += tip[0]
    right[q + 2, n + 1] += tip[1]
    right[q + 2, n + 2] -= tip[0]


@compiled
def _solve_in_place(matrix: Array, right: Array) -> bool:
    """Gaussian elimination with row pivoting; `right` becomes the solution. False when singular."""
    size, count = right.shape
    for k in range(size):
        pivot = k
        for i in range(k + 1, size):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if not abs(matrix[pivot, k]) > 1e-300:
            return False
        if pivot != k:
            for j in range(size):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            for j in range(count):
                right[k, j], right[pivot, j] = right[pivot, j], right[k, j]
        inverse = 1.0 / matrix[k, k]
        for i in range(size):
            if i != k:
                factor = matrix[i, k] * inverse
                if factor != 0.0:
                    for j in range(k, size):
                        matrix[i, j] -= factor * matrix[k, j]
                    for j in range(count):
                        right[i, j] -= factor * right[k, j]
    for k in range(size):
        inverse = 1.0 / matrix[k, k]
        for j in range(count):
            right[k, j] *= inverse
    return True
