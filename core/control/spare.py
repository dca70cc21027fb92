"""What joints do that the task leaves over: they keep away from edges, as far as the task's null space lets them.

An edge repels the more the nearer it is, from a distance of 1 below on: the gradient of one over the distance, in
joints measured by their top speed, is a velocity that `inverse` comes as near to as it can without touching the task,
by the ridge that keeps a null space still otherwise. Two levels in one small problem, inside all the limits.

| name | edge | distance |
|---|---|---|
| `stability` | the shape folds, the tubes snap | `Solution.stability` over 0.5 |
| `limits` | the end of a joint's travel | over a quarter of the travel |
| `order` | tubes out of order | over 10 mm |
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.errors import CtrError, DescriptionError
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array

EDGES = ("stability", "limits", "order")
#: Fastest that a joint goes for this, as a part of its top speed.
MOST = 0.1
#: How eagerly [s]: ten times of it, and joints that are told a tenth of a second late hunt about the place where edges
#: balance, by enough to move the tip.
EAGER = 0.1
#: Part of what a trial says that is believed at once: the load that it is made under is a single sample's.
BELIEVED = 0.2
#: No edge repels as if it were nearer.
NEAREST = 0.05
#: What distances are measured by: of the margin, of a joint's end over half of its travel, of the order [m].
STABLE, END, ORDER = 0.5, 0.5, 0.010
#: Time for which a joint goes at top speed to tell how the margin changes with it [s].
TRIED = 0.02


class Slope(NamedTuple):
    """How the margin of stability changes with the joints; one of them is tried at a tick."""

    values: Array  #: (n,) for a second at top speed [1/s]
    next: int  #: the joint to try


@dataclass(frozen=True)
class Spare:
    """Edges to keep away from, each with its weight."""

    weights: Mapping[str, float]

    def __post_init__(self) -> None:
        for name, weight in self.weights.items():
            if name not in EDGES:
                raise DescriptionError(f"spare: '{name}' is unknown; choose of {', '.join(EDGES)}")
            if not (math.isfinite(weight) and 0.0 <= weight <= 100.0):
                raise DescriptionError(f"spare: weight {weight:g} of '{name}' is outside 0 ... 100")

    def tried(self, statics: Statics, limits: Limits, now: Solution, last: Slope | None) -> Slope:
        """The slope with one joint of `now` tried anew, away from the nearer end of its travel.

        None is tried where the edge does not repel: a trial is a solve.
        """
        last = last or Slope(np.zeros(now.joints.size), 0)
        if not self.weights.get("stability") or now.stability >= STABLE:
            return last
        k, joints, speed = last.next, now.joints.copy(), limits.speed
        lower, upper = limits.packed[0, k], limits.packed[1, k]
        step = TRIED * float(speed[k]) * (1.0 if joints[k] < 0.5 * (lower + upper) else -1.0)
        joints[k] += step
        values, following = last.values.copy(), (k + 1) % joints.size
        try:
            found = (statics.solve(joints, now.wrench, now).stability - now.stability) / step * speed[k]
        except CtrError:
            found = 0.0  # it cannot stand there: the order's and the travel's business
        values[k] += BELIEVED * (found - values[k])
        return Slope(values, following)

    def velocity(self, limits: Limits, joints: Array, margin: float, slope: Slope) -> Array:
        """Velocity (n,) that the joints would like [rad/s or m/s] at the margin of stability."""
        weights, (matrix, bound) = self.weights, limits.order
        return _velocity(
            weights.get("stability", 0.0), weights.get("limits", 0.0), weights.get("order", 0.0),
            limits.packed, matrix, bound, joints, margin, slope.values,
        )  # fmt: skip


@compiled
def _velocity(
    stability: float, ends: float, order: float,
    limits: Array, matrix: Array, bound: Array, joints: Array, margin: float, slope: Array,
) -> Array:  # fmt: skip
    """`Spare.velocity` by its weights."""
    n, wish, largest = joints.shape[0], np.zeros(joints.shape[0]), 1e-12
    for i in range(n):
        half = END * 0.5 * (limits[1, i] - limits[0, i])
        away = _repels((joints[i] - limits[0, i]) / half) - _repels((limits[1, i] - joints[i]) / half)
        wish[i] = stability * slope[i] / STABLE * _repels(margin / STABLE) + ends * away * limits[2, i] / half
    for k in range(bound.shape[0]):
        room = bound[k]
        for i in range(n):
            room -= matrix[k, i] * joints[i]
        for i in range(n):
            wish[i] -= order * _repels(room / ORDER) * matrix[k, i] * limits[2, i] / ORDER
    for i in range(n):
        wish[i] *= EAGER
        largest = max(largest, abs(wish[i]))
    for i in range(n):
        wish[i] *= limits[2, i] * min(1.0, MOST / largest)
    return wish


@compiled
def _repels(distance: float) -> float:
    """How much, at a distance: nothing from 1 on."""
    return max(max(distance, NEAREST) ** -2.0 - 1.0, 0.0)
