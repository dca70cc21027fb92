"""A solved shape of the robot: one array of numbers, and names for its parts.

The solver writes one array, because allocating a dozen small arrays would take as long as solving the model. The array
starts with the scalars at the indices below; then the `Parts` follow in their order, with the shapes of `_shapes`.
"""

from collections.abc import Mapping
from functools import cache
from typing import NamedTuple, Protocol

import numpy as np

from core.compiled import Shapes, compiled, packed_size, part
from core.robot.robot import Array

#: Indices of the scalars: numbers of tubes and joints, arc length of the force from the plate [m], margin of stability,
#: bound of the residual [1/m or N m], and passes along the tubes (-1: not solved).
TUBE_COUNT, JOINT_COUNT, CONTACT_POSITION, STABILITY, RESIDUAL, PASSES = range(6)


class Parts(NamedTuple):
    """Views of a solution's numbers for q tubes and n joints. World frame; rows of J and C: position, then rotation."""

    tip: Array  #: (3,) position of the tip [m]
    rotation: Array  #: (3, 3) frame of the innermost tube at the tip
    jacobian: Array  #: (6, n) derivative J of the tip by the joints [m or rad per rad or m]
    compliance: Array  #: (6, 6) derivative C of the tip by force and tip moment [m or rad per N or N m]
    unknowns: Array  #: (q + 3,) torsion u_iz of each tube at the plate [1/m] and moment about the plate [N m]
    sensitivity: Array  #: (q + 3, n + 6) derivative of the unknowns by joints, force and moment
    joints: Array  #: (n,) joint positions for which the model was solved [rad or m]
    wrench: Array  #: (6,) load for which the model was solved [N, N m]
    move: Array  #: (n + 6,) change of joints and wrench since the start solution `near`
    bend: Array  #: (2, q + 3) second- and third-order coefficients of the unknowns along `move`


@compiled
def _shapes(q: int, n: int) -> Shapes:
    """Return the shapes of the scalars and of each of the `Parts` in a solution's numbers."""
    size = q + 3
    return (
        (1, 6), (1, 3), (3, 3), (6, n), (6, 6), (1, size), (size, n + 6), (1, n), (1, 6), (1, n + 6), (2, size)
    )  # fmt: skip


def size(q: int, n: int) -> int:
    """Return the number of values of a solution for q tubes and n joints."""
    return packed_size(_shapes(q, n))


@compiled
def fields(numbers: Array) -> Parts:
    """Return the parts of a solution's numbers as views."""
    shapes = _shapes(int(numbers[TUBE_COUNT]), int(numbers[JOINT_COUNT]))
    return Parts(
        part(numbers, shapes, 1)[0],
        part(numbers, shapes, 2),
        part(numbers, shapes, 3),
        part(numbers, shapes, 4),
        part(numbers, shapes, 5)[0],
        part(numbers, shapes, 6),
        part(numbers, shapes, 7)[0],
        part(numbers, shapes, 8)[0],
        part(numbers, shapes, 9)[0],
        part(numbers, shapes, 10),
    )


@cache
def layout(q: int, n: int) -> Mapping[str, tuple[slice, tuple[int, ...]]]:
    """Return slice and shape of each of the `Parts` in a solution's numbers, for q tubes and n joints."""
    numbers = np.arange(float(size(q, n)))
    numbers[[TUBE_COUNT, JOINT_COUNT]] = q, n
    found = fields(numbers)._asdict()
    return {name: (slice(int(part.flat[0]), int(part.flat[0]) + part.size), part.shape) for name, part in found.items()}


class PartsReader(Protocol):
    """Object with named parts: a solution, or many solutions."""

    def part(self, name: str) -> Array:
        """Return one of the `Parts`."""
        ...


class PartView:
    """Attribute that reads the part with its name on demand, because most parts are never read."""

    def __set_name__(self, owner: type, name: str) -> None:
        """Store the name of the part."""
        self._name = name

    def __get__(self, solution: PartsReader, owner: type | None = None) -> Array:
        """Return the part of a solution."""
        return solution.part(self._name)


class Solution:
    """Solution of the model: the loaded robot at one pose. `Parts` describes its arrays."""

    __slots__ = ("_layout", "numbers")

    tip = PartView()
    rotation = PartView()
    jacobian = PartView()
    compliance = PartView()
    unknowns = PartView()
    sensitivity = PartView()
    joints = PartView()
    wrench = PartView()

    def __init__(self, numbers: Array) -> None:
        self.numbers = numbers
        self._layout: Mapping[str, tuple[slice, tuple[int, ...]]] | None = None

    def copy(self) -> "Solution":
        """Return a copy that shares no memory with this solution."""
        return Solution(self.numbers.copy())

    def part(self, name: str) -> Array:
        """Return one of the `Parts`."""
        if self._layout is None:
            self._layout = layout(int(self.numbers[TUBE_COUNT]), int(self.numbers[JOINT_COUNT]))
        where, shape = self._layout[name]
        return self.numbers[where].reshape(shape)

    @property
    def contact(self) -> float:
        """Arc length from the plate at which the force acts [m]; inf for the tip."""
        return float(self.numbers[CONTACT_POSITION])

    @property
    def stability(self) -> float:
        """Margin of stability: determinant of the derivative of the end conditions by the base unknowns.

        The margin is 1 for straight tubes without load. It falls to 0 where the tubes snap or the load buckles them.
        """
        return self.numbers.item(STABILITY)

    @property
    def residual(self) -> float:
        """Upper bound of the violation of the end conditions [1/m or N m]."""
        return float(self.numbers[RESIDUAL])

    @property
    def iterations(self) -> int:
        """Number of passes along the tubes that the solve took."""
        return int(self.numbers[PASSES])

    @property
    def singular_values(self) -> Array:
        """Singular values (min(3, n),) of the position rows of J, largest first [m per rad or m]."""
        return np.asarray(np.linalg.svd(self.jacobian[:3], compute_uv=False), dtype=np.float64)


def at_rest(joints: Array, contact: float, q: int) -> Solution:
    """Return the initial guess of a cold solve at joints (n,): no twist, no moment, no load."""
    n = joints.shape[0]
    rest = Solution(np.zeros(size(q, n)))
    rest.numbers[[TUBE_COUNT, JOINT_COUNT, CONTACT_POSITION, PASSES]] = q, n, contact, -1.0
    rest.joints[:] = joints
    return rest


def pure_force(force: Array) -> Array:
    """Return the wrench (6,) of a force (3,) without moment [N, N m]."""
    return np.concatenate((force, np.zeros(3)))
