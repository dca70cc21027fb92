"""A solved shape: one array of numbers, and names for what they are.

The solver writes one array instead of a dozen small ones: making those took as long as the model.
"""

from typing import NamedTuple

import numpy as np

from core.compiled import inlined
from core.robot.robot import Array


class Places(NamedTuple):
    """Where a part of the numbers ends, for q tubes and n joints; each begins where the one before ends."""

    q: int
    n: int
    tip: int
    rotation: int
    jacobian: int
    compliance: int
    unknowns: int
    sensitivity: int
    joints: int
    wrench: int
    move: int
    curve: int
    total: int


@inlined
def places(q: int, n: int) -> Places:
    """For q tubes and n joints."""
    size = q + 3
    jacobian = 12 + 6 * n
    compliance = jacobian + 36
    unknowns = compliance + size
    sensitivity = unknowns + size * (n + 6)
    joints = sensitivity + n
    wrench = joints + 6
    move = wrench + n + 6
    curve = move + 2 * size
    return Places(q, n, 3, 12, jacobian, compliance, unknowns, sensitivity, joints, wrench, move, curve, curve + 4)


class Solution:
    """The loaded robot at one pose. World frame; rows of J and C: position, then rotation."""

    __slots__ = ("numbers", "places")

    def __init__(self, numbers: Array, places: Places) -> None:
        self.numbers = numbers
        self.places = places

    @property
    def tip(self) -> Array:
        """(3,) [m]."""
        return self.numbers[:3]

    @property
    def rotation(self) -> Array:
        """(3, 3) frame of the innermost tube at the tip."""
        return self.numbers[3:12].reshape(3, 3)

    @property
    def jacobian(self) -> Array:
        """(6, n) by the joints [m or rad per rad or m]."""
        return self.numbers[12 : self.places.jacobian].reshape(6, self.places.n)

    @property
    def compliance(self) -> Array:
        """(6, 6) by force and tip moment [m or rad per N or N m]."""
        return self.numbers[self.places.jacobian : self.places.compliance].reshape(6, 6)

    @property
    def unknowns(self) -> Array:
        """(q + 3,) u_iz(0) [1/m] and M(0) about the plate [N m]."""
        return self.numbers[self.places.compliance : self.places.unknowns]

    @property
    def sensitivity(self) -> Array:
        """(q + 3, n + 6) of the unknowns by joints, force and moment."""
        return self.numbers[self.places.unknowns : self.places.sensitivity].reshape(-1, self.places.n + 6)

    @property
    def joints(self) -> Array:
        """(n,) the pose solved for."""
        return self.numbers[self.places.sensitivity : self.places.joints]

    @property
    def wrench(self) -> Array:
        """(6,) the load solved for [N, N m]."""
        return self.numbers[self.places.joints : self.places.wrench]

    @property
    def contact(self) -> float:
        """Arc length from the plate at which the force acts [m]; inf for the tip."""
        return float(self.numbers[-4])

    @property
    def stability(self) -> float:
        """Determinant of the end conditions by the base unknowns: 1 for straight tubes without load.

        It falls to 0 where the shape folds: there the tubes snap, or the load makes them buckle.
        """
        return float(self.numbers[-3])

    @property
    def residual(self) -> float:
        """Bound of the violation of an end condition [1/m or N m]."""
        return float(self.numbers[-2])

    @property
    def iterations(self) -> int:
        """Passes along the tubes."""
        return int(self.numbers[-1])

    @property
    def singular_values(self) -> Array:
        """(min(3, n),) of the position rows of J, largest first [m per rad or m]."""
        return np.asarray(np.linalg.svd(self.jacobian[:3], compute_uv=False), dtype=np.float64)


def at_rest(joints: Array, contact: float, q: int) -> Solution:
    """Where a cold start begins: no twist, no moment, no load."""
    where = places(q, joints.shape[0])
    numbers = np.zeros(where.total)
    numbers[where.sensitivity : where.joints] = joints
    numbers[-4] = contact
    return Solution(numbers, where)
