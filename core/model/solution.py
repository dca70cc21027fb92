"""A solved shape: one array of numbers, and names for its parts.

The solver writes one array instead of a dozen small ones: making those took as long as the model. It begins with a
few single numbers, at the places named below; behind them lie the `Parts`, in their order.
"""

from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.robot.robot import Array

#: Places of the single numbers: how many tubes and joints there are, arc length of the force from the plate [m],
#: margin of stability, bound of the residual [1/m or N m], and passes along the tubes (-1: not solved).
TUBES, JOINTS, CONTACT, STABILITY, RESIDUAL, PASSES = range(6)


class Parts(NamedTuple):
    """Views of a solution's numbers for q tubes and n joints. World frame; rows of J and C: position, then rotation."""

    tip: Array  #: (3,) [m]
    rotation: Array  #: (3, 3) frame of the innermost tube at the tip
    jacobian: Array  #: (6, n) by the joints [m or rad per rad or m]
    compliance: Array  #: (6, 6) by force and tip moment [m or rad per N or N m]
    unknowns: Array  #: (q + 3,) u_iz(0) [1/m] and M(0) about the plate [N m]
    sensitivity: Array  #: (q + 3, n + 6) of the unknowns by joints, force and moment
    joints: Array  #: (n,) the pose solved for [rad or m]
    wrench: Array  #: (6,) the load solved for [N, N m]
    move: Array  #: (n + 6,) what joints and wrench have changed by since the solution that this one began from
    bend: Array  #: (2, q + 3) second and third order of the unknowns along `move`


def count(q: int, n: int) -> int:
    """How many numbers a solution has for q tubes and n joints."""
    size = q + 3
    return 6 + 3 + 9 + 6 * n + 36 + size + size * (n + 6) + n + 6 + (n + 6) + 2 * size


@compiled
def parts(numbers: Array) -> Parts:
    """What lies where in a solution's numbers."""
    q, n = int(numbers[TUBES]), int(numbers[JOINTS])
    size = q + 3
    tip = 6
    rotation = tip + 3
    jacobian = rotation + 9
    compliance = jacobian + 6 * n
    unknowns = compliance + 36
    sensitivity = unknowns + size
    joints = sensitivity + size * (n + 6)
    wrench = joints + n
    move = wrench + 6
    bend = move + n + 6
    return Parts(
        numbers[tip:rotation],
        numbers[rotation:jacobian].reshape(3, 3),
        numbers[jacobian:compliance].reshape(6, n),
        numbers[compliance:unknowns].reshape(6, 6),
        numbers[unknowns:sensitivity],
        numbers[sensitivity:joints].reshape(size, n + 6),
        numbers[joints:wrench],
        numbers[wrench:move],
        numbers[move:bend],
        numbers[bend:].reshape(2, size),
    )


@cache
def places(q: int, n: int) -> Mapping[str, tuple[slice, tuple[int, ...]]]:
    """Where `parts` finds each of them in the numbers of q tubes and n joints, and its shape."""
    numbers = np.arange(float(count(q, n)))
    numbers[[TUBES, JOINTS]] = q, n
    found = parts(numbers)._asdict()
    return {name: (slice(int(part.flat[0]), int(part.flat[0]) + part.size), part.shape) for name, part in found.items()}


class Solution:
    """The loaded robot at one pose."""

    __slots__ = ("_places", "numbers")

    def __init__(self, numbers: Array) -> None:
        self.numbers = numbers
        self._places: Mapping[str, tuple[slice, tuple[int, ...]]] | None = None

    def _part(self, name: str) -> Array:
        """One of the `Parts`: most of them are never looked at."""
        if self._places is None:
            self._places = places(int(self.numbers[TUBES]), int(self.numbers[JOINTS]))
        where, shape = self._places[name]
        return self.numbers[where].reshape(shape)

    @property
    def tip(self) -> Array:
        """(3,) [m]."""
        return self._part("tip")

    @property
    def rotation(self) -> Array:
        """(3, 3) frame of the innermost tube at the tip."""
        return self._part("rotation")

    @property
    def jacobian(self) -> Array:
        """(6, n) by the joints [m or rad per rad or m]; rows: position, then rotation."""
        return self._part("jacobian")

    @property
    def compliance(self) -> Array:
        """(6, 6) by force and tip moment [m or rad per N or N m]; rows: position, then rotation."""
        return self._part("compliance")

    @property
    def unknowns(self) -> Array:
        """(q + 3,) u_iz(0) [1/m] and M(0) about the plate [N m]."""
        return self._part("unknowns")

    @property
    def sensitivity(self) -> Array:
        """(q + 3, n + 6) of the unknowns by joints, force and moment."""
        return self._part("sensitivity")

    @property
    def joints(self) -> Array:
        """(n,) the pose solved for [rad or m]."""
        return self._part("joints")

    @property
    def wrench(self) -> Array:
        """(6,) the load solved for [N, N m]."""
        return self._part("wrench")

    @property
    def contact(self) -> float:
        """Arc length from the plate at which the force acts [m]; inf for the tip."""
        return float(self.numbers[CONTACT])

    @property
    def stability(self) -> float:
        """Determinant of the end conditions by the base unknowns: 1 for straight tubes without load.

        It falls to 0 where the shape folds: there the tubes snap, or the load makes them buckle.
        """
        return float(self.numbers[STABILITY])

    @property
    def residual(self) -> float:
        """Bound of the violation of an end condition [1/m or N m]."""
        return float(self.numbers[RESIDUAL])

    @property
    def iterations(self) -> int:
        """Passes along the tubes."""
        return int(self.numbers[PASSES])

    @property
    def singular_values(self) -> Array:
        """(min(3, n),) of the position rows of J, largest first [m per rad or m]."""
        return np.asarray(np.linalg.svd(self.jacobian[:3], compute_uv=False), dtype=np.float64)


def at_rest(joints: Array, contact: float, q: int) -> Solution:
    """Where a cold start begins at joints (n,): no twist, no moment, no load."""
    n = joints.shape[0]
    rest = Solution(np.zeros(count(q, n)))
    rest.numbers[[TUBES, JOINTS, CONTACT, PASSES]] = q, n, contact, -1.0
    rest.joints[:] = joints
    return rest


def pure_force(force: Array) -> Array:
    """The wrench (6,) of a force (3,) alone [N, N m]."""
    return np.concatenate((force, np.zeros(3)))
