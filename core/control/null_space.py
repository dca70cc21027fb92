"""The null-space objective: how redundant joints move while the tip's task has priority.

A robot with more joints than the task has rows is redundant: its joints can move without moving the tip. These motions
are the null space of the task. `velocity_ik.inverse` chooses among these motions by a very small penalty (the ridge),
inside all limits. The objective sets this penalty in two parts: a desired joint velocity away from edges, and a
resistance against crossing kinks. Neither part changes the motion of the tip.

An edge repels joints whose scaled distance from it is below 1, by the gradient of 1 / distance. Joint velocities are
measured as fractions of their top speeds.

| name | what happens at the edge | unit of distance |
|---|---|---|
| `stability` | the tubes snap | `Solution.stability` of 0.5 |
| `limits` | a joint reaches the end of its travel | a quarter of the travel |
| `order` | a tube passes the tube around it | 10 mm |

A kink is a joint position where the Jacobian jumps, so the slowest joint velocity that fulfils the task differs between
its two sides. Where both velocities point toward the kink, commands that arrive a tenth of a second late belong to the
wrong side. The joints then oscillate across the kink, and the tip stays millimetres behind its setpoint. For motions
along the kink both Jacobians agree. The objective therefore resists the joint velocity across the kink. The remaining
solution is then valid on both sides.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.control.velocity_ik import NullSpace
from core.errors import CtrError, DescriptionError
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array, Robot

OBJECTIVES = ("stability", "limits", "order")
#: Largest joint speed that the repulsion of edges may request, as a fraction of the joint's top speed.
MAX_SPEED_SHARE = 0.1
#: Time constant that scales an edge's repulsion to a joint velocity [s]. With a value ten times larger, joints whose
#: commands arrive a tenth of a second late oscillate between balanced edges, by enough to move the tip.
TIME_CONSTANT_S = 0.1
#: Weight of one trial solve in the running mean of the stability gradient; the mean is needed because each trial uses
#: the noisy load of a single sample.
SLOPE_FILTER_GAIN = 0.2
#: Smallest scaled distance in the formula of repulsion and resistance (no unit); at smaller distances repulsion and
#: resistance stay constant.
MIN_DISTANCE = 0.05
#: Distances at which each edge starts to repel: stability margin; distance from a joint's end as a fraction of half its
#: travel; distance between tube ends [m].
STABILITY_SCALE, TRAVEL_SCALE, TUBE_ORDER_SCALE_M = 0.5, 0.5, 0.010
#: Distance from a kink at which the resistance starts [m]: a joint at top speed travels it in 0.15 s.
KINK_DISTANCE_M = 0.003
#: A trial solve for the stability gradient moves one joint by the distance that it travels at top speed in this time
#: [s].
TRIAL_TIME_S = 0.02


class StabilityGradient(NamedTuple):
    """Gradient of the stability margin by the joints; each tick updates the element of one joint."""

    values: Array  #: (n,) change of the margin per second of joint motion at top speed [1/s]
    next: int  #: index of the joint that the next trial solve moves


class Kinks(NamedTuple):
    """Joint positions where the Jacobian jumps; equation k of `rows @ joints + offsets == 0` describes kink k."""

    rows: Array  #: (k, n) coefficients of the joints, 1, -1 or 0
    offsets: Array  #: (k,) constant terms of the equations [m]


@dataclass(frozen=True)
class NullSpaceObjective:
    """Objective of redundant joints: the edges that they avoid, each with its weight."""

    weights: Mapping[str, float]

    def __post_init__(self) -> None:
        for name, weight in self.weights.items():
            if name not in OBJECTIVES:
                raise DescriptionError(f"null_space: '{name}' is unknown; choose one of {', '.join(OBJECTIVES)}")
            if not (math.isfinite(weight) and 0.0 <= weight <= 100.0):
                raise DescriptionError(f"null_space: weight {weight:g} of '{name}' is outside 0 ... 100")

    def updated_gradient(
        self, statics: Statics, limits: Limits, now: Solution, last: StabilityGradient | None
    ) -> StabilityGradient:
        """Return the stability gradient after a trial solve, with one joint moved away from the nearer end of travel.

        A trial costs one model solve. No trial is made while the margin is too large to repel the joints.
        """
        last = last or StabilityGradient(np.zeros(now.joints.size), 0)
        if not self.weights.get("stability") or now.stability >= STABILITY_SCALE:
            return last
        k, joints, speed = last.next, now.joints.copy(), limits.speed
        lower, upper = limits.packed[0, k], limits.packed[1, k]
        step = TRIAL_TIME_S * float(speed[k]) * (1.0 if joints[k] < 0.5 * (lower + upper) else -1.0)
        joints[k] += step
        values, following = last.values.copy(), (k + 1) % joints.size
        try:
            found = (statics.solve(joints, now.wrench, now).stability - now.stability) / step * speed[k]
        except CtrError:
            found = 0.0  # the moved pose is invalid; the edges `order` and `limits` repel the joints from it
        values[k] += SLOPE_FILTER_GAIN * (found - values[k])
        return StabilityGradient(values, following)

    def velocity(self, limits: Limits, joints: Array, margin: float, slope: StabilityGradient) -> Array:
        """Return the desired joint velocity (n,) away from the edges [rad/s or m/s].

        Args:
            limits: travel, top speeds and tube order.
            joints: joint positions (n,) [rad or m].
            margin: stability margin at these joints.
            slope: gradient of the stability margin.

        """
        weights, (matrix, bound) = self.weights, limits.order
        return _velocity(
            weights.get("stability", 0.0), weights.get("limits", 0.0), weights.get("order", 0.0),
            limits.packed, matrix, bound, joints, margin, slope.values,
        )  # fmt: skip

    def objective(
        self, limits: Limits, kinks: Kinks, joints: Array, margin: float, slope: StabilityGradient
    ) -> NullSpace:
        """Return the desired velocity away from edges and the resisted rows near `kinks`.

        Arguments other than `kinks` are as in `velocity`.
        """
        velocity = self.velocity(limits, joints, margin, slope)
        return NullSpace(velocity, _resisted(kinks.rows, kinks.offsets, joints, limits.packed))


def kinks_of(robot: Robot) -> Kinks:
    """Return the kinks of a robot: joint positions where a tube's curvature changes at another tube's end or the plate.

    At a tube's end the bending stiffness changes, so the Jacobian depends on which comes first along the robot: this
    end or the change of curvature. The curvature changes of two tubes add up in either order, so they form no kink.
    """
    slides = {joint.tube: k for k, joint in enumerate(robot.joints) if joint.motion == "translation"}
    rows, offsets = list[Array](), list[float]()
    for i, tube in enumerate(robot.tubes):
        arc = 0.0
        for section, following in pairwise(tube.sections):
            arc += section.length
            others = [j for j in range(len(robot.tubes)) if j != i]
            for j in (None, *others) if section.curvature != following.curvature else ():
                row, offset = np.zeros(len(robot.joints)), arc - (0.0 if j is None else robot.tubes[j].length)
                for index, sign in ((i, 1.0), (j, -1.0)):
                    if index in slides:
                        row[slides[index]] = sign
                    elif index is not None:
                        offset += sign * robot.tubes[index].translation
                rows.append(row)
                offsets.append(offset)
    return Kinks(np.array(rows).reshape(-1, len(robot.joints)), np.array(offsets))


@compiled
def _resisted(rows: Array, offsets: Array, joints: Array, limits: Array) -> Array:
    """Return one row (n,) across each kink; with joints in units of top speed, its squared length is the resistance."""
    resisted = np.zeros(rows.shape)
    for k in range(rows.shape[0]):
        distance, square = offsets[k], 0.0
        for i in range(joints.shape[0]):
            distance += rows[k, i] * joints[i]
            square += (rows[k, i] * limits[2, i]) ** 2
        if square > 0.0:
            weight = np.sqrt(_repulsion(abs(distance) / KINK_DISTANCE_M) / square)
            for i in range(joints.shape[0]):
                resisted[k, i] = weight * rows[k, i]
    return resisted


@compiled
def _velocity(
    stability: float, ends: float, order: float,
    limits: Array, matrix: Array, bound: Array, joints: Array, margin: float, slope: Array,
) -> Array:  # fmt: skip
    """Compute `NullSpaceObjective.velocity` for the weights of the edges `stability`, `limits` (`ends`) and `order`."""
    n, desired, largest = joints.shape[0], np.zeros(joints.shape[0]), 1e-12
    for i in range(n):
        half = TRAVEL_SCALE * 0.5 * (limits[1, i] - limits[0, i])
        away = _repulsion((joints[i] - limits[0, i]) / half) - _repulsion((limits[1, i] - joints[i]) / half)
        desired[i] = (
            stability * slope[i] / STABILITY_SCALE * _repulsion(margin / STABILITY_SCALE)
            + ends * away * limits[2, i] / half
        )
    for k in range(bound.shape[0]):
        room = bound[k]
        for i in range(n):
            room -= matrix[k, i] * joints[i]
        for i in range(n):
            away = _repulsion(room / TUBE_ORDER_SCALE_M)
            desired[i] -= order * away * matrix[k, i] * limits[2, i] / TUBE_ORDER_SCALE_M
    for i in range(n):
        desired[i] *= TIME_CONSTANT_S
        largest = max(largest, abs(desired[i]))
    for i in range(n):
        desired[i] *= limits[2, i] * min(1.0, MAX_SPEED_SHARE / largest)
    return desired


@compiled
def _repulsion(distance: float) -> float:
    """Return the repulsion at a scaled distance: 1 / distance^2 - 1, and zero for distances above 1."""
    return max(max(distance, MIN_DISTANCE) ** -2.0 - 1.0, 0.0)
