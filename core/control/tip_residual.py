"""Learned residual of the model: the tip error that can be predicted from joints, their last motions and the load.

A Gaussian process (`core.calibration.residual` fits it) predicts measured minus modelled tip. Its inputs are

* cosine and sine of each tube's rotation, and its translation [m], relative to the tube around it,
* a direction state of each joint, -1 ... 1, which follows the joint's last motion (`advance_directions`),
* the force at the tip [N].

Force and residual are in a frame that turns with the outermost tube, so a rotation of the whole robot does not change
the residual. The kernel is Matern 3/2, k(r) = (1 + sqrt(3) r) exp(-sqrt(3) r), because the true error has kinks
(friction, flush ends). With m support points, k(x) their kernel values, and the matrices W and B of the fit,

    mean = W^T k(x),    share = k(x)^T B k(x).

`share` is the explained share of the prior variance: 1 in dense data, and 0 far from all data. The residual is the mean
times a gate that closes where the share is small, so that far from the data the model remains as it is.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.compiled import Shapes, compiled, part
from core.model.solution import fields
from core.robot.robot import Array, Robot

#: Distance of a motion after which a direction state has changed by 63 % of its full change, by joint unit [rad, m].
DIRECTION_DISTANCE = {"rad": 0.05, "m": 0.5e-3}
#: Explained shares of the variance at which the gate starts to open and is fully open. In the half of the nylon robot's
#: workspace that a fit left out, the errors were 1 to 8 % smaller than the model's (1 to 4 % with 0.3 and 0.7).
GATE_CLOSED, GATE_OPEN = 0.05, 0.3
#: Largest number of support points, which take about 10 us a tick.
MAX_SUPPORT = 192
#: Kinds of inputs of the Gaussian process, as numbers in `Inputs.table`.
COSINE, SINE, SLIDE, DIRECTION, FORCE_X, FORCE_Y, FORCE_Z = range(7)
#: Indices of the first scalars of a packed residual.
INPUT_COUNT, SUPPORT_COUNT, FRAME_JOINT, STRENGTH, TOLERANCE = range(5)
#: Indices of the parts of a residual's state, in the order of the channel `residual_state`.
SHARE, FACTOR, HARMFUL = range(3)
#: Time after which a residual that increases the tip's error is switched off, and time in which it fades out [s].
HARMFUL_S, FADE_S = 1.0, 0.5


class Inputs(NamedTuple):
    """Inputs of the Gaussian process for one robot."""

    table: Array  #: (d, 4) kind, joint, joint of the tube around it (-1: none), distance of a direction state
    groups: NDArray[np.int64]  #: (d,) inputs of one group share a length scale
    expected: Array  #: (g,) expected length scale of each group, in the unit of its inputs [1, m or N]
    frame_joint: int  #: joint that turns the outermost tube; -1: it does not turn


def inputs_of(robot: Robot) -> Inputs:
    """Return the inputs for a robot."""
    turning = {joint.tube: k for k, joint in enumerate(robot.joints) if joint.motion == "rotation"}
    sliding = {joint.tube: k for k, joint in enumerate(robot.joints) if joint.motion == "translation"}
    around = {k: same.get(tube + 1, -1) for same in (turning, sliding) for tube, k in same.items()}
    rows: list[tuple[float, ...]] = []
    groups: list[int] = []
    expected: list[float] = []

    def group(scale: float, *kinds: tuple[float, ...]) -> None:
        rows.extend(kinds)
        groups.extend([len(expected)] * len(kinds))
        expected.append(scale)

    for k, joint in enumerate(robot.joints):
        if joint.motion == "rotation":
            outer = around[k]
            group(0.7 if outer >= 0 else 2.0, (COSINE, k, outer, 0.0), (SINE, k, outer, 0.0))
        else:
            group(0.02, (SLIDE, k, around[k], 0.0))
    for k, joint in enumerate(robot.joints):
        group(2.0, (DIRECTION, k, around[k], DIRECTION_DISTANCE[joint.unit]))
    group(0.3, *((kind, -1, -1, 0.0) for kind in (FORCE_X, FORCE_Y, FORCE_Z)))
    return Inputs(np.array(rows), np.array(groups), np.array(expected), turning.get(len(robot.tubes) - 1, -1))


class TipResidual(NamedTuple):
    """A fitted residual."""

    inputs: Inputs
    base: Array  #: (3, 3) rotation of the plate in the world
    scales: Array  #: (d,) length scale of each input; inf: the input has no effect
    support: Array  #: (m, d) inputs of the support points
    weights: Array  #: (m, 3) matrix W of the mean [m]
    explained: Array  #: (m, m) matrix B of the explained share
    strength: float  #: factor of the mean, 0 ... 1
    tolerance: float  #: 95 % quantile of the errors that remain at held-out poses [m]

    def packed(self) -> Array:
        """Return the residual in one array, the first argument of the compiled functions."""
        d, m = self.scales.size, len(self.support)
        head = (d, m, self.inputs.frame_joint, self.strength, self.tolerance)
        parts = (head, self.base, self.inputs.table, 1.0 / self.scales, (self.support / self.scales).T, self.weights.T)
        return np.concatenate([np.ravel(np.asarray(each, dtype=np.float64)) for each in (*parts, self.explained)])


@compiled
def _shapes(d: int, m: int) -> Shapes:
    return (1, 5), (3, 3), (d, 4), (1, d), (d, m), (3, m), (m, m)


@compiled
def table_of(packed: Array) -> Array:
    """Return the table (d, 4) of the inputs of a packed residual."""
    return part(packed, _shapes(int(packed[INPUT_COUNT]), int(packed[SUPPORT_COUNT])), 2)


@compiled
def advance_directions(table: Array, before: Array, now: Array, old: Array, new: Array) -> None:
    """Compute the direction states (n,) `new` at joints `now`, from `old` at joints `before`.

    A motion by d changes a state s to exp(-|d| / h) s + (1 - exp(-|d| / h)) sign(d): Dahl's law of friction, with the
    distance h in the table. A rotation is relative to the tube around it.
    """
    for row in range(table.shape[0]):
        if table[row, 0] == DIRECTION:
            k, outer = int(table[row, 1]), int(table[row, 2])
            d = now[k] - before[k]
            if outer >= 0:
                d -= now[outer] - before[outer]
            decay = math.exp(-abs(d) / table[row, 3])
            new[k] = decay * old[k] + (1.0 - decay) * (1.0 if d > 0.0 else -1.0)


@compiled
def write_inputs(
    table: Array, frame: int, base: Array, joints: Array, directions: Array, force: Array, out: Array
) -> None:
    """Write the inputs (d,) of the Gaussian process for joints (n,), direction states (n,) and world force (3,) [N]."""
    turn = joints[frame] if frame >= 0 else 0.0
    c, s = math.cos(turn), math.sin(turn)
    x = base[0, 0] * force[0] + base[1, 0] * force[1] + base[2, 0] * force[2]
    y = base[0, 1] * force[0] + base[1, 1] * force[1] + base[2, 1] * force[2]
    z = base[0, 2] * force[0] + base[1, 2] * force[1] + base[2, 2] * force[2]
    for i in range(table.shape[0]):
        kind, k, outer = int(table[i, 0]), int(table[i, 1]), int(table[i, 2])
        if kind in (COSINE, SINE):
            angle = joints[k] - (joints[outer] if outer >= 0 else 0.0)
            out[i] = math.cos(angle) if kind == COSINE else math.sin(angle)
        elif kind == SLIDE:
            out[i] = joints[k] - (joints[outer] if outer >= 0 else 0.0)
        elif kind == DIRECTION:
            out[i] = directions[k]
        else:
            out[i] = c * x + s * y if kind == FORCE_X else (c * y - s * x if kind == FORCE_Y else z)


@compiled
def residual_at(
    packed: Array, joints: Array, directions: Array, force: Array, value: Array, jacobian: Array, by_force: Array
) -> float:
    """Compute the residual and its derivatives; return the explained share of the variance.

    Args:
        packed: `TipResidual.packed`.
        joints, directions, force: joints (n,) [rad or m], their direction states (n,), force (3,) in the world [N].
        value: out, (3,) residual to add to the model's tip, world frame [m].
        jacobian: out, (3, n) its derivative by the joints; the direction states are constant in it.
        by_force: out, (3, 3) its derivative by the force [m/N].

    """
    d, m, frame, strength = (
        int(packed[INPUT_COUNT]),
        int(packed[SUPPORT_COUNT]),
        int(packed[FRAME_JOINT]),
        packed[STRENGTH],
    )
    shapes = _shapes(d, m)
    base, table, scale = part(packed, shapes, 1), part(packed, shapes, 2), part(packed, shapes, 3)[0]
    support, weights, explained = part(packed, shapes, 4), part(packed, shapes, 5), part(packed, shapes, 6)
    raw, scaled, k, slope, u = np.empty(d), np.empty(d), np.empty(m), np.empty(m), np.zeros(m)
    square = np.zeros(m)
    write_inputs(table, frame, base, joints, directions, force, raw)
    # Loops over all support points are the inner ones, so that the compiler vectorises them.
    for i in range(d):
        scaled[i] = raw[i] * scale[i]
        if scale[i] > 0.0:
            for j in range(m):
                apart = scaled[i] - support[i, j]
                square[j] += apart * apart
    for j in range(m):
        root = math.sqrt(3.0 * square[j])
        small = math.exp(-root)
        k[j], slope[j] = (1.0 + root) * small, -3.0 * small
    share, mean = 0.0, np.zeros(3)
    for j in range(m):
        for i in range(m):
            u[i] += k[j] * explained[j, i]
    for j in range(m):
        share += k[j] * u[j]
    for c in range(3):
        for j in range(m):
            mean[c] += weights[c, j] * k[j]
    opening = min(1.0, max(0.0, (share - GATE_CLOSED) / (GATE_OPEN - GATE_CLOSED)))
    gate = strength * opening * opening * (3.0 - 2.0 * opening)
    gate_slope = strength * 6.0 * opening * (1.0 - opening) / (GATE_OPEN - GATE_CLOSED)
    local, by_joint, by_load = np.empty(3), np.zeros((3, joints.shape[0])), np.zeros((3, 3))
    for c in range(3):
        local[c] = gate * mean[c]
    for i in range(d if gate > 0.0 else 0):
        kind, joint, outer = int(table[i, 0]), int(table[i, 1]), int(table[i, 2])
        if kind == DIRECTION or scale[i] == 0.0:
            continue
        x, y, z, w = 0.0, 0.0, 0.0, 0.0
        for j in range(m):
            step = slope[j] * (scaled[i] - support[i, j])
            x += weights[0, j] * step
            y += weights[1, j] * step
            z += weights[2, j] * step
            w += u[j] * step
        gated = 2.0 * gate_slope * w
        change = (gate * x + gated * mean[0], gate * y + gated * mean[1], gate * z + gated * mean[2])
        for c in range(3):
            rate = scale[i] * change[c]
            if kind in (COSINE, SINE):
                rate *= -raw[i + 1] if kind == COSINE else raw[i - 1]
            if kind <= SLIDE:
                by_joint[c, joint] += rate
                if outer >= 0:
                    by_joint[c, outer] -= rate
            else:
                by_load[c, kind - FORCE_X] = rate
    turn = joints[frame] if frame >= 0 else 0.0
    if (
        frame >= 0
    ):  # the frame of force and residual turns, too: d F / d angle = -z x F, d residual / d angle = z x residual
        for c in range(3):
            by_joint[c, frame] += by_load[c, 0] * raw[d - 2] - by_load[c, 1] * raw[d - 3]
        by_joint[0, frame] -= local[1]
        by_joint[1, frame] += local[0]
    cos, sin, world = math.cos(turn), math.sin(turn), np.empty((3, 3))
    for r in range(3):
        world[r, 0] = base[r, 0] * cos + base[r, 1] * sin
        world[r, 1] = base[r, 1] * cos - base[r, 0] * sin
        world[r, 2] = base[r, 2]
    for r in range(3):
        value[r] = world[r, 0] * local[0] + world[r, 1] * local[1] + world[r, 2] * local[2]
        for j in range(joints.shape[0]):
            jacobian[r, j] = world[r, 0] * by_joint[0, j] + world[r, 1] * by_joint[1, j] + world[r, 2] * by_joint[2, j]
        for j in range(3):
            total = 0.0
            for c in range(3):
                inner = by_load[c, 0] * world[j, 0] + by_load[c, 1] * world[j, 1] + by_load[c, 2] * world[j, 2]
                total += world[r, c] * inner
            by_force[r, j] = total
    return share


@compiled
def apply_residual(
    packed: Array, gain: float, directions: Array, loaded: Array, unloaded: Array, value: Array
) -> float:  # fmt: skip
    """Add the residual times `gain` to tip and Jacobian of the solutions with and without load; return the share.

    `value` receives the residual (3,) of the loaded tip [m]. The unloaded tip gets the part that does not depend on the
    load, to first order. The compliance remains that of the model, so that no stiffness changes its sign.
    """
    with_load, free = fields(loaded), fields(unloaded)
    jacobian, by_force = np.empty((3, with_load.joints.shape[0])), np.empty((3, 3))
    share = residual_at(packed, with_load.joints, directions, with_load.wrench[:3], value, jacobian, by_force)
    for i in range(3):
        value[i] *= gain
        by_load = 0.0
        for j in range(3):
            by_load += by_force[i, j] * with_load.wrench[j]
        with_load.tip[i] += value[i]
        free.tip[i] += value[i] - gain * by_load
        for j in range(jacobian.shape[1]):
            with_load.jacobian[i, j] += gain * jacobian[i, j]
            free.jacobian[i, j] += gain * jacobian[i, j]
    return share


@compiled
def next_gain(
    tolerance: float, period: float, bias: Array, value: Array, gain: float, worse: float
) -> tuple[float, float]:  # fmt: skip
    """Return the factor of the residual, and for how long it has increased the tip's error [s], one tick later.

    `bias` (3,) is the measured tip minus the model's tip with the residual `value` (3,) [m]. The time increases while
    the bias is longer than without the residual by more than `tolerance` [m]; otherwise it decreases. After `HARMFUL_S`
    the factor, which is 1 at the start, falls to 0 within `FADE_S` and stays there.
    """
    with_residual, without = 0.0, 0.0
    for i in range(3):
        with_residual += bias[i] * bias[i]
        without += (bias[i] + value[i]) * (bias[i] + value[i])
    harmful = math.sqrt(with_residual) > math.sqrt(without) + tolerance
    worse = worse + period if harmful else max(0.0, worse - period)
    if gain < 1.0 or worse > HARMFUL_S:
        gain = max(0.0, gain - period / FADE_S)
    return gain, worse
