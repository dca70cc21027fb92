"""Batches of poses: rows of joints and wrenches, solved in compiled code, with the results of `Statics.solve`.

A cold row starts without a nearby solution, a warm row starts from one. Compiled code solves warm rows, and cold rows
with exactly one shape (`is_unique`), for which Newton's method alone finds the shape that `Statics.solve` reaches from
rest. `Statics.solve` solves the other rows, one at a time. Rows are solved in chunks, which the caller may distribute
over threads, because the compiled part releases Python's global interpreter lock. The results do not depend on the
distribution.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from core.compiled import unlocked
from core.errors import CtrError, DescriptionError
from core.model.newton import COLD_STEP_RAD, WARM_STEP_RAD, newton
from core.model.solution import (
    CONTACT_POSITION,
    JOINT_COUNT,
    PASSES,
    STABILITY,
    TUBE_COUNT,
    PartView,
    Solution,
    fields,
    layout,
    size,
)
from core.model.statics import Statics
from core.model.uniqueness import is_unique
from core.robot.robot import Array, Flags, Indices, tube_poses, unpack

#: Number of rows per chunk of a batch. With `along`, each chunk starts cold, so results do not depend on the threads.
CHUNK_ROWS = 500
#: Start of a row's solve: without a nearby solution, from the previous row, or from a row of given solutions.
COLD, ALONG, NEAR = range(3)

#: Type of a function that calls another function for each number, like `map`, for example in threads.
Spread = Callable[[Callable[[int], None], Iterable[int]], Iterable[None]]


@dataclass(frozen=True)
class Solutions:
    """Solutions of the model at k poses; rows without solution are NaN. All array properties are views, not copies."""

    numbers: Array  #: (k, m) the numbers of a `Solution` in each row
    failures: Mapping[int, CtrError]  #: error of each row without solution
    tubes: int  #: number of tubes q
    joints: int  #: number of joints n

    # Arrays (k, ...) of the rows, see `solution.Parts`.
    tip = PartView()
    rotation = PartView()
    jacobian = PartView()
    compliance = PartView()

    def __len__(self) -> int:
        return self.numbers.shape[0]

    @cached_property
    def ok(self) -> Flags:
        """Flags (k,): whether each row is solved."""
        solved = np.ones(len(self), np.bool_)
        solved[list(self.failures)] = False
        return solved

    def complete(self) -> "Solutions":
        """Return these solutions if all rows are solved.

        Raises:
            PoseError, NotFinite, NoSolution: error of the first row without solution, see `Statics.solve`.

        """
        for row in sorted(self.failures)[:1]:
            raise self.failures[row]
        return self

    @property
    def stability(self) -> Array:
        """Margins of stability (k,), see `Solution.stability`."""
        return self.numbers[:, STABILITY]

    @property
    def iterations(self) -> Array:
        """Numbers of passes along the tubes (k,)."""
        return self.numbers[:, PASSES]

    def at(self, row: int) -> Solution:
        """Return the solution of one row.

        Raises:
            PoseError, NotFinite, NoSolution: the row has no solution, see `Statics.solve`.

        """
        if row in self.failures:
            raise self.failures[row]
        return Solution(self.numbers[row])

    def part(self, name: str) -> Array:
        """Return one of the `Parts` of all rows (k, ...)."""
        where, shape = layout(self.tubes, self.joints)[name]
        return self.numbers[:, where].reshape(-1, *shape)


def solve_many(
    models: Statics | Sequence[Statics],
    joints: Array,
    wrenches: Array,
    near: Solutions | None = None,
    along: bool = False,
    spread: Spread = map,
) -> Solutions:
    """Solve many poses; forces act at the tip.

    Args:
        models: the robot and its integrator; or one model per row, with equal tube counts, joint counts and steps.
        joints: positions (k, n) [rad or m].
        wrenches: force and moment (k, 6), world frame [N, N m].
        near: k nearby solutions; each row follows the branch of its solution. A row whose solution is NaN starts cold.
        along: every row follows the branch of the previous row. Every `CHUNK_ROWS`th row and a row after a failed one
            start cold.
        spread: function that executes the chunks, for example in threads.

    Raises:
        DescriptionError: the shapes of the arrays do not match each other or the robot.

    """
    each = [models] if isinstance(models, Statics) else models
    first = each[0]
    q, n = len(first.robot.tubes), len(first.robot.joints)
    # Copy the arrays, because a read-only or non-contiguous array would need another compilation.
    joints, wrenches = np.array(joints, np.float64, order="C"), np.array(wrenches, np.float64, order="C")
    k = joints.shape[0] if joints.ndim else 0
    if joints.shape != (k, n) or wrenches.shape != (k, 6):
        raise DescriptionError(
            f"joints {joints.shape} and wrenches {wrenches.shape} are not (k, {n}) and (k, 6) for '{first.robot.name}'"
        )
    if len(each) not in (1, k) or any(not _same_layout(model, first) for model in each[1:]):
        raise DescriptionError(
            f"{len(each)} models: use one, or one for each of {k} rows with equal tube counts and integration steps"
        )
    if near is not None and (along or near.numbers.shape != (k, size(q, n))):
        raise DescriptionError(f"near has shape {near.numbers.shape} for {k} rows, or along is set too; use only one")
    numbers, failures = np.empty((k, size(q, n))), dict[int, CtrError]()
    packed = np.array([model.compiled_arguments[0] for model in each])
    rows = _Rows(each, packed, joints, wrenches, numbers if near is None else near.numbers, numbers, failures)
    start = NEAR if near is not None else ALONG if along else COLD
    for _ in spread(partial(_chunk, rows, start), range(0, k, CHUNK_ROWS)):
        pass
    return Solutions(numbers, failures, q, n)


def _same_layout(one: Statics, other: Statics) -> bool:
    """Return whether the same compiled function accepts both models."""
    (robot, *how), (robot_2, *how_2) = one.compiled_arguments, other.compiled_arguments
    return robot.size == robot_2.size and how == how_2


@dataclass(frozen=True)
class _Rows:
    """Inputs and outputs of a batch, which its chunks share."""

    models: Sequence[Statics]
    packed: Array
    joints: Array
    wrenches: Array
    near: Array
    numbers: Array
    failures: dict[int, CtrError]

    def solve(self, row: int, near: Solution | None) -> None:
        """Solve one row with `Statics.solve`."""
        model = self.models[row if len(self.models) > 1 else 0]
        try:
            self.numbers[row] = model.solve(self.joints[row], self.wrenches[row], near).numbers
        except CtrError as error:
            self.numbers[row] = math.nan
            self.failures[row] = error


def _chunk(rows: _Rows, start: int, first: int) -> None:
    """Solve the chunk that starts at row `first`; `Statics.solve` then solves the rows that compiled code left."""
    last = min(first + CHUNK_ROWS, rows.numbers.shape[0])
    unsolved = np.empty(CHUNK_ROWS, np.int64)
    at = first
    while at < last:
        cold_start = start == ALONG and at == first
        following, count = solve_rows(
            rows.packed, *rows.models[0].compiled_arguments[1:], rows.joints, rows.wrenches, start, cold_start, at,
            last, rows.near, rows.numbers, unsolved,
        )  # fmt: skip
        for row in unsolved[:count].tolist():
            before = rows.near[row if start == NEAR else row - 1]
            warm = start == NEAR or (start == ALONG and row > first)
            rows.solve(row, Solution(before) if warm and before[PASSES] > 0.0 else None)
        at = following


@unlocked
def solve_rows(
    packed: Array,
    order: int,
    sublink: float,
    tubes: tuple[float, ...],
    columns: tuple[float, ...],
    joints: Array,
    wrenches: Array,
    start: int,
    cold_start: bool,
    first: int,
    last: int,
    near: Array,
    numbers: Array,
    unsolved: Indices,
) -> tuple[int, int]:
    """Solve rows `first` ... `last` - 1 of a batch where Newton's method alone is sufficient.

    Args:
        packed: (1, m) the robot, or (k, m) one per row.
        order, sublink, tubes, columns: see `newton`.
        joints, wrenches: (k, n) and (k, 6).
        start: `COLD`, `ALONG` or `NEAR`.
        cold_start: with `ALONG`, the row `first` starts cold, because it has no previous row.
        first, last: range of rows.
        near: (k, m) nearby solutions from which the rows start, for `NEAR`.
        numbers: out (k, m).
        unsolved: out, rows that `Statics.solve` has to solve.

    Returns:
        The row after the last processed one (`ALONG` stops after a failed row), and the number of unsolved rows.

    """
    rest, count = np.zeros(numbers.shape[1]), 0
    rest[TUBE_COUNT], rest[JOINT_COUNT], rest[CONTACT_POSITION], rest[PASSES] = (
        len(tubes),
        joints.shape[1],
        np.inf,
        -1.0,
    )
    rest_joints = fields(rest).joints
    for row in range(first, last):
        robot = packed[row if packed.shape[0] > 1 else 0]
        before, cold = rest, True
        if start == NEAR:
            before, cold = near[row], not near[row, PASSES] > 0.0
        elif start == ALONG and not (cold_start and row == first):
            before, cold = numbers[row - 1], not numbers[row - 1, PASSES] > 0.0
        if cold:
            force = wrenches[row, 0] ** 2 + wrenches[row, 1] ** 2 + wrenches[row, 2] ** 2
            moment = abs(wrenches[row, 3]) + abs(wrenches[row, 4]) + abs(wrenches[row, 5])
            layout = unpack(robot)
            _, beta, valid = tube_poses(layout, joints[row])
            solved = valid and moment == 0.0 and is_unique(layout, beta, np.sqrt(force), np.inf, tubes)
            if solved:
                for j in range(joints.shape[1]):
                    rest_joints[j] = joints[row, j]
                solved = newton(
                    robot, order, sublink, joints[row], wrenches[row], rest, np.inf, 0, COLD_STEP_RAD, tubes, columns,
                    numbers[row],
                )  # fmt: skip
                # The discretised model may have an extra equilibrium, at a twist too strong for its sub-links.
                solved = solved and numbers[row, STABILITY] > 0.0
        else:
            solved = newton(
                robot, order, sublink, joints[row], wrenches[row], before, np.inf, 1, WARM_STEP_RAD, tubes, columns,
                numbers[row],
            )  # fmt: skip
        if not solved:
            unsolved[count] = row
            count += 1
            if start == ALONG:
                return row + 1, count
    return last, count
