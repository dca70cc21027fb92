"""Newton's method for the base unknowns: torsion of each tube and moment at the plate.

A pass along the tubes gives the end conditions and their derivatives, and from these a Newton step. The step is about
as long as the distance to the solution; the error after the step is proportional to the step's square. If a step of a
warm start is below `WARM_STEP_RAD`, the violation of the end conditions after it is below the tolerance. This last step
is applied to tip, frame and unknowns to first order, without another pass. A warm start uses a prediction from a nearby
solution and its sensitivities. If the motion continues in the same direction, the prediction is the cubic through the
last two solutions and their slopes. One pass is then enough.
"""

import numpy as np

from core.compiled import compiled, copy
from core.model.propagation import FIXED_ROWS, FRAME_ROWS, Scheme, propagate
from core.model.solution import CONTACT_POSITION, JOINT_COUNT, PASSES, RESIDUAL, STABILITY, TUBE_COUNT, Parts, fields
from core.robot.robot import Array, Layout, farthest_end, tube_poses, unpack

#: Largest violation of the end conditions of a solved pose [1/m and N m].
RESIDUAL_TOLERANCE = 1e-9
#: Largest number of passes along the tubes in a solve; a warm start takes one or two.
MAX_PASSES = 40
#: Largest final Newton step of a warm start, applied to first order [rad over the whole length].
WARM_STEP_RAD = 1e-6
#: Largest final Newton step of a cold start [rad over the whole length]. It is smaller than that of a warm start
#: because time matters less, and J and C of the last pass are then those of the solution itself.
COLD_STEP_RAD = 1e-8
#: Largest final Newton step in the control loop [rad over the whole length]. This large value saves half of the passes.
#: The error is below 0.1 um at the tip and 0.1 % of J and C; the noise of one force sample moves the tip by 1 mm.
CONTROL_STEP_RAD = 3e-3
#: Upper bound of the end conditions' violation after a Newton step, divided by the step's square [1/m or N m]. The
#: value was measured and includes a reserve.
NEWTON_REMAINDER = 100.0
#: Step of the difference quotients by the moment at the tip [N m].
MOMENT_STEP = 1e-6
#: Largest first Newton step of a careful warm start [rad]: a longer step may lead to another shape of the robot.
MAX_FIRST_STEP_RAD = 0.5


@compiled
def newton(
    packed: Array,
    order: int,
    sublink: float,
    joints: Array,
    wrench: Array,
    near: Array,
    contact: float,
    careful: int,
    close: float,
    tubes: tuple[float, ...],
    columns: tuple[float, ...],
    numbers: Array,
) -> bool:
    """Solve the model with Newton's method and write the solution to `numbers`; return False if there is no solution.

    Args:
        packed: the robot, `Robot.packed`.
        order, sublink: see `propagation.Scheme`.
        joints, wrench, contact: the pose (n,), the load (6,), and the force's arc length from the plate [m].
        near: numbers of a nearby solution, from which the iteration starts.
        careful: 1 to stay on the branch of `near`: a long first step or a sign change of the margin is a failure.
        close: largest final Newton step, applied to first order [rad over the whole length].
        tubes, columns: see `propagate`.
        numbers: out, the numbers of the `Solution`.

    A step that does not reduce the residual is halved.
    """
    layout = unpack(packed)
    q, width, n = len(tubes), len(columns), layout.joint_tube.shape[0]
    size, last = q + 3, q + n + 9
    numbers[TUBE_COUNT], numbers[JOINT_COUNT], numbers[PASSES] = q, n, -1.0
    found, before = fields(numbers), fields(near)
    alpha, beta, valid = tube_poses(layout, joints)
    tip, length = beta[0] + layout.ends[0, layout.counts[0] - 1], farthest_end(layout, beta)
    if not valid or joints.shape[0] != n or not (contact == np.inf or 0.0 <= contact <= length):
        return False
    beyond = tip <= contact < np.inf  # the force acts on the outer tubes, beyond the tip
    scheme = Scheme(order, sublink)
    state, rates = np.empty(18 + 2 * q), np.empty((FRAME_ROWS + 2 * q + FIXED_ROWS) * width)
    table = np.zeros((size + 6, width + 8))
    unknowns, step = np.empty(size), np.zeros(size)
    trial = found.unknowns
    _predict(before, near[CONTACT_POSITION] == contact, joints, wrench, layout.stiffness[0, 0], trial, found.move)
    twist = layout.stiffness[0, 1] / layout.stiffness[0, 0]  # 1 / GJ of the tube that carries the tip
    best, fraction = np.inf, 1.0
    for iterations in range(1, MAX_PASSES + 1):
        propagate(layout, scheme, alpha, beta, wrench, contact, trial, tubes, columns, state, rates, table[:0])
        residual = _end_conditions(rates, wrench, state, twist, tubes, columns, n, table)
        if beyond:
            _add_moment_columns(
                layout, scheme, alpha, beta, wrench, contact, trial, tubes, columns, state, rates, n, table
            )
        if not np.isfinite(residual) or (residual > best and residual > RESIDUAL_TOLERANCE):
            fraction *= 0.5
            if fraction < 1e-4:
                return False
            for i in range(size):
                trial[i] = unknowns[i] - fraction * step[i]
            continue
        best, fraction = residual, 1.0
        determinant = eliminate(table, tubes, columns)
        if determinant == 0.0:
            return False
        distance = 0.0
        for i in range(size):
            step[i] = table[i, last]
            distance = max(distance, abs(step[i]) * (length if i < q else length / layout.stiffness[0, 0]))
        if careful and iterations == 1 and not distance < MAX_FIRST_STEP_RAD:
            return False
        for i in range(size):
            unknowns[i] = trial[i]
            trial[i] -= step[i]
        if distance < close:
            if careful and determinant * near[STABILITY] < 0.0:
                return False
            _finish(layout.base, state, table, q, n, found)
            _path_curvature(before, near[PASSES] > 0.0 and near[CONTACT_POSITION] == contact, found)
            copy(joints, found.joints)
            copy(wrench, found.wrench)
            numbers[CONTACT_POSITION], numbers[STABILITY] = contact, determinant
            numbers[RESIDUAL], numbers[PASSES] = min(residual, NEWTON_REMAINDER * distance * distance), iterations
            return True
    return False


@compiled
def _predict(
    near: Parts, same_contact: bool, joints: Array, wrench: Array, stiffness: float, trial: Array, move: Array
) -> None:
    """Predict the unknowns at the new pose and load (`trial`); `move` receives the change of pose and load."""
    n, size = joints.shape[0], trial.shape[0]
    for j in range(n):
        move[j] = joints[j] - near.joints[j]
    for j in range(6):
        move[n + j] = wrench[j] - near.wrench[j]
    square, before, along = 0.0, 0.0, 0.0
    for i in range(size):
        now, last = 0.0, 0.0
        for j in range(n + 6):
            rate = near.sensitivity[i, j]
            now += rate * move[j]
            last += rate * near.move[j]
        trial[i] = near.unknowns[i] + now
        scale = 1.0 if i < size - 3 else 1.0 / stiffness
        square += scale * scale * now * now
        before += scale * scale * last * last
        along += scale * scale * now * last
    # The cubic along the previous change of pose and load is valid only for a change in the same direction.
    if along * along > 0.99 * square * before and before > 0.0 and same_contact:
        t = along / before
        if abs(t) < 3.0:
            for i in range(size):
                trial[i] += t * t * (near.bend[0, i] + t * near.bend[1, i])


@compiled
def _path_curvature(near: Parts, known: bool, found: Parts) -> None:
    """Compute the second- and third-order coefficients of the unknowns along the last change of pose and load.

    The coefficients follow from values and slopes at both ends. `known`: the slope at the start is known.
    """
    for i in range(found.unknowns.shape[0]):
        here, there = 0.0, 0.0
        for j in range(found.move.shape[0]):
            here += found.sensitivity[i, j] * found.move[j]
            there += near.sensitivity[i, j] * found.move[j]
        gap = near.unknowns[i] - found.unknowns[i] + here
        curve = there - here
        if not known:
            gap, curve = 0.0, 0.0
        found.bend[0, i] = curve + 3.0 * gap
        found.bend[1, i] = curve + 2.0 * gap


@compiled
def _end_conditions(
    rates: Array,
    wrench: Array,
    state: Array,
    twist: float,
    tubes: tuple[float, ...],
    columns: tuple[float, ...],
    n: int,
    table: Array,
) -> float:
    """Fill `table` with the derivatives of end conditions and tip by unknowns, joints, force and tip moment.

    The last column contains the end conditions: u_iz at each tube's end and M at the tip, which must vanish.

    Returns:
        The largest violation [1/m or N m].

    """
    q, width = len(tubes), len(columns)
    size = q + 3
    t1, t2, t3 = state[2], state[5], state[8]
    x, y, z = state[9], state[10], state[11]
    fx, fy, fz = state[12 + 2 * q], state[13 + 2 * q], state[14 + 2 * q]
    ax = twist * (t2 * wrench[5] - t3 * wrench[4])
    ay = twist * (t3 * wrench[3] - t1 * wrench[5])
    az = twist * (t1 * wrench[4] - t2 * wrench[3])
    theta, torsion, force = FRAME_ROWS * width, (FRAME_ROWS + q) * width, (FRAME_ROWS + 2 * q) * width
    moment = force + 3 * width
    for i in range(q):
        for col in range(width):
            table[i, col] = rates[torsion + i * width + col]
    for col in range(width):
        r1, r2, r3 = rates[col], rates[width + col], rates[2 * width + col]
        dx, dy, dz = rates[3 * width + col], rates[4 * width + col], rates[5 * width + col]
        gx, gy, gz = rates[force + col], rates[force + width + col], rates[force + 2 * width + col]
        turn = rates[theta + col]
        table[0, col] -= ax * r1 + ay * r2 + az * r3
        table[q, col] = rates[moment + col] - (dy * fz - dz * fy) - (y * gz - z * gy)
        table[q + 1, col] = rates[moment + width + col] - (dz * fx - dx * fz) - (z * gx - x * gz)
        table[q + 2, col] = rates[moment + 2 * width + col] - (dx * fy - dy * fx) - (x * gy - y * gx)
        table[size, col], table[size + 1, col], table[size + 2, col] = dx, dy, dz
        # rotation of the tip: the frame's rotation plus the innermost tube's angle about its tangent
        table[size + 3, col], table[size + 4, col], table[size + 5, col] = (
            r1 + t1 * turn,
            r2 + t2 * turn,
            r3 + t3 * turn,
        )
    for i in range(size + 6):
        for col in range(size + n + 3, width + 8):
            table[i, col] = 0.0
    for k in range(3):
        table[0, size + n + 3 + k] = -twist * state[2 + 3 * k]
        table[q + k, size + n + 3 + k] = -1.0
        table[q + k, size + n + 6] = state[15 + 2 * q + k] - wrench[3 + k]
    for i in range(q):
        table[i, size + n + 6] = state[12 + q + i]
    table[0, size + n + 6] -= twist * (t1 * wrench[3] + t2 * wrench[4] + t3 * wrench[5])
    residual = 0.0
    for i in range(size):
        violation = abs(table[i, size + n + 6])
        residual = residual if violation <= residual else violation  # propagates a NaN
    return residual


@compiled
def _add_moment_columns(
    layout: Layout, scheme: Scheme, alpha: Array, beta: Array, wrench: Array, contact: float, trial: Array,
    tubes: tuple[float, ...], columns: tuple[float, ...], state: Array, rates: Array, n: int, table: Array,
) -> None:  # fmt: skip
    """Add derivatives to `table`: of the end conditions by the tip moment that acts through the tubes beyond the tip.

    The part of the tubes up to the tip, and thus the tip's frame, does not change at constant unknowns.
    """
    q, changed, nowhere, column = len(tubes), wrench.copy(), table[:0], len(tubes) + n + 6
    for k in range(3):
        for sign in (-1.0, 1.0):
            changed[3 + k] = wrench[3 + k] + sign * MOMENT_STEP
            propagate(layout, scheme, alpha, beta, changed, contact, trial, tubes, columns, state, rates, nowhere)
            for i in range(q):
                table[i, column + k] += 0.5 * sign / MOMENT_STEP * state[12 + q + i]
            for i in range(3):
                table[q + i, column + k] += 0.5 * sign / MOMENT_STEP * state[15 + 2 * q + i]
        changed[3 + k] = wrench[3 + k]


@compiled
def _finish(base: Array, state: Array, table: Array, q: int, n: int, found: Parts) -> None:
    """Write the tip and its frame after the last Newton step, J, C and the sensitivity to `found`."""
    size = q + 3
    last = size + n + 6
    for i in range(size):
        for j in range(n + 6):
            found.sensitivity[i, j] = -table[i, size + j]
    for i in range(6):
        for j in range(n):
            found.jacobian[i, j] = table[size + i, size + j]
        for j in range(6):
            found.compliance[i, j] = table[size + i, size + n + j]
    cos, sin = np.cos(state[12]), np.sin(state[12])
    n1, n2, n3 = table[size + 3, last], table[size + 4, last], table[size + 5, last]
    for i in range(3):
        found.tip[i] = state[9 + i] + table[size + i, last] + base[9 + i]
    square = n1 * n1 + n2 * n2 + n3 * n3
    for k in range(3):
        # axes of the innermost tube, rotated to second order: the third order of this small rotation is negligible
        if k == 0:
            a, b, c = cos * state[0] + sin * state[1], cos * state[3] + sin * state[4], cos * state[6] + sin * state[7]
        elif k == 1:
            a, b, c = cos * state[1] - sin * state[0], cos * state[4] - sin * state[3], cos * state[7] - sin * state[6]
        else:
            a, b, c = state[2], state[5], state[8]
        along = 0.5 * (n1 * a + n2 * b + n3 * c)
        scale = 1.0 - 0.5 * square
        found.rotation[0, k] = scale * a + n2 * c - n3 * b + along * n1
        found.rotation[1, k] = scale * b + n3 * a - n1 * c + along * n2
        found.rotation[2, k] = scale * c + n1 * b - n2 * a + along * n3


@compiled
def eliminate(table: Array, tubes: tuple[float, ...], columns: tuple[float, ...]) -> float:
    """Eliminate the first q + 3 rows and columns by Gauss-Jordan with row pivoting, also in the rows below.

    [A B; C D] becomes [1 A^-1 B; 0 D - C A^-1 B]. Returns the determinant of A; 0 if A is singular.
    """
    size, rows, count = len(tubes) + 3, len(tubes) + 9, len(columns) + 8
    determinant = 1.0
    for k in range(size):
        pivot = k
        for i in range(k + 1, size):
            if abs(table[i, k]) > abs(table[pivot, k]):
                pivot = i
        if not abs(table[pivot, k]) > 1e-300:
            return 0.0
        if pivot != k:
            determinant = -determinant
            for j in range(count):
                table[k, j], table[pivot, j] = table[pivot, j], table[k, j]
        determinant *= table[k, k]
        inverse = 1.0 / table[k, k]
        for j in range(count):
            table[k, j] *= inverse
        for i in range(rows):
            if i != k:
                factor = table[i, k]
                for j in range(count):
                    table[i, j] -= factor * table[k, j]
    return determinant
