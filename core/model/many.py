"""Many poses at once: rows of joints and wrenches, solved in compiled code, each with the answer of `Statics.solve`.

A cold row goes the short way where there can be one shape only (`only_shape`): then Newton from nothing finds what
`solve` comes to from rest, and its numbers are what `solve` answers with. A warm row is the single warm solve. Every
other row is solved by `solve` itself, one at a time. Rows go by chunks, which whoever calls may spread over threads:
the compiled part runs without Python's lock. What comes out does not depend on how.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from core.compiled import unlocked
from core.errors import CtrError, DescriptionError
from core.model.newton import CLOSE, CLOSEST, newton
from core.model.only_shape import only_shape
from core.model.solution import CONTACT, JOINTS, PASSES, STABILITY, TUBES, Solution, count, parts, places
from core.model.statics import Statics
from core.robot.robot import Array, Flags, Indices, tube_poses, unpack

#: Rows that are solved in one go. A chunk along rows begins cold, whoever solves it.
CHUNK = 500
#: What a row begins from: nothing, the row before it, or a row of solutions that are given.
COLD, ALONG, NEAR = range(3)

#: Carries out a function for each number, as `map` does; in threads, say.
Spread = Callable[[Callable[[int], None], Iterable[int]], Iterable[None]]


@dataclass(frozen=True)
class Solutions:
    """The loaded robot at k poses; rows that have no solution are NaN. Parts are views, as those of a `Solution`."""

    numbers: Array  #: (k, m) a row each: the numbers of a `Solution`
    failures: Mapping[int, CtrError]  #: by row: why it has none
    tubes: int  #: q
    joints: int  #: n

    def __len__(self) -> int:
        return self.numbers.shape[0]

    @cached_property
    def ok(self) -> Flags:
        """(k,) which rows are solved."""
        solved = np.ones(len(self), np.bool_)
        solved[list(self.failures)] = False
        return solved

    def complete(self) -> "Solutions":
        """These, of which none is missing.

        Raises:
            PoseError, NotFinite, NoSolution: the first one that is, see `Statics.solve`.

        """
        for row in sorted(self.failures)[:1]:
            raise self.failures[row]
        return self

    @property
    def tip(self) -> Array:
        """(k, 3) [m]."""
        return self._part("tip")

    @property
    def rotation(self) -> Array:
        """(k, 3, 3) frame of the innermost tube at the tip."""
        return self._part("rotation")

    @property
    def jacobian(self) -> Array:
        """(k, 6, n) by the joints [m or rad per rad or m]; rows: position, then rotation."""
        return self._part("jacobian")

    @property
    def compliance(self) -> Array:
        """(k, 6, 6) by force and tip moment [m or rad per N or N m]; rows: position, then rotation."""
        return self._part("compliance")

    @property
    def stability(self) -> Array:
        """(k,) margins, see `Solution.stability`."""
        return self.numbers[:, STABILITY]

    @property
    def iterations(self) -> Array:
        """(k,) passes along the tubes."""
        return self.numbers[:, PASSES]

    def at(self, row: int) -> Solution:
        """One of them.

        Raises:
            PoseError, NotFinite, NoSolution: it has none, see `Statics.solve`.

        """
        if row in self.failures:
            raise self.failures[row]
        return Solution(self.numbers[row])

    def _part(self, name: str) -> Array:
        where, shape = places(self.tubes, self.joints)[name]
        return self.numbers[:, where].reshape(-1, *shape)


def solve_many(
    models: Statics | Sequence[Statics],
    joints: Array,
    wrenches: Array,
    near: Solutions | None = None,
    along: bool = False,
    spread: Spread = map,
) -> Solutions:
    """Shapes at many poses; forces act at the tip.

    Args:
        models: the robot and its integrator; or one for each row, of as many tubes and joints, integrated alike.
        joints: positions (k, n) [rad or m].
        wrenches: force and moment (k, 6), world frame [N, N m].
        near: so many solutions nearby, whose branches are followed, row by row; a row without one begins cold.
        along: every row follows the branch of the one before, but every `CHUNK`th, and one behind a failed one, which
            begin cold.
        spread: carries out the chunks.

    Raises:
        DescriptionError: the shapes of the arrays do not fit each other or the robot.

    """
    own = [models] if isinstance(models, Statics) else models
    first = own[0]
    q, n = len(first.robot.tubes), len(first.robot.joints)
    # Copied: compiled code is compiled anew for an array that may not be written to, or whose rows lie apart.
    joints, wrenches = np.array(joints, np.float64, order="C"), np.array(wrenches, np.float64, order="C")
    k = joints.shape[0] if joints.ndim else 0
    if joints.shape != (k, n) or wrenches.shape != (k, 6):
        raise DescriptionError(
            f"joints {joints.shape} and wrenches {wrenches.shape} are not (k, {n}) and (k, 6) for '{first.robot.name}'"
        )
    if len(own) not in (1, k) or any(not _alike(model, first) for model in own[1:]):
        raise DescriptionError(f"{len(own)} models are not one for each of {k} rows, of tubes and steps alike")
    if near is not None and (along or near.numbers.shape != (k, count(q, n))):
        raise DescriptionError(f"near has {near.numbers.shape} numbers for {k} rows, or rows shall follow each other")
    numbers, failures = np.empty((k, count(q, n))), dict[int, CtrError]()
    packed = np.array([model.compiled_arguments[0] for model in own])
    rows = _Rows(own, packed, joints, wrenches, numbers if near is None else near.numbers, numbers, failures)
    start = NEAR if near is not None else ALONG if along else COLD
    for _ in spread(partial(_chunk, rows, start), range(0, k, CHUNK)):
        pass
    return Solutions(numbers, failures, q, n)


def _alike(one: Statics, other: Statics) -> bool:
    """Whether one compiled function takes both."""
    (robot, *how), (robot_2, *how_2) = one.compiled_arguments, other.compiled_arguments
    return robot.size == robot_2.size and how == how_2


@dataclass(frozen=True)
class _Rows:
    """What chunks work on."""

    models: Sequence[Statics]
    packed: Array
    joints: Array
    wrenches: Array
    near: Array
    numbers: Array
    failures: dict[int, CtrError]

    def solve(self, row: int, near: Solution | None) -> None:
        """One row, as if alone."""
        model = self.models[row if len(self.models) > 1 else 0]
        try:
            self.numbers[row] = model.solve(self.joints[row], self.wrenches[row], near).numbers
        except CtrError as error:
            self.numbers[row] = math.nan
            self.failures[row] = error


def _chunk(rows: _Rows, start: int, first: int) -> None:
    """Solve the rows from `first` on; what the compiled code leaves, one at a time."""
    last = min(first + CHUNK, rows.numbers.shape[0])
    left = np.empty(CHUNK, np.int64)
    at = first
    while at < last:
        fresh = start == ALONG and at == first
        here, stays = solve_rows(
            rows.packed, *rows.models[0].compiled_arguments[1:], rows.joints, rows.wrenches, start, fresh, at, last,
            rows.near, rows.numbers, left,
        )  # fmt: skip
        for row in left[:stays].tolist():
            before = rows.near[row if start == NEAR else row - 1]
            warm = start == NEAR or (start == ALONG and row > first)
            rows.solve(row, Solution(before) if warm and before[PASSES] > 0.0 else None)
        at = here


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
    fresh: bool,
    first: int,
    last: int,
    near: Array,
    numbers: Array,
    left: Indices,
) -> tuple[int, int]:
    """Solve rows `first` ... `last` - 1 as far as that goes quickly.

    Args:
        packed: (1, m) the robot, or (k, m) one for each row.
        order, sublink, tubes, columns: see `newton`.
        joints, wrenches: (k, n) and (k, 6).
        start: `COLD`, `ALONG` or `NEAR`.
        fresh: along rows, the first one has none before it.
        first, last: which.
        near: (k, m) where rows of `NEAR` begin.
        numbers: out (k, m).
        left: out, rows that have to be solved in another way.

    Returns:
        The row behind the last one that was looked at (along rows none is skipped), and how many are left.

    """
    rest, stays = np.zeros(numbers.shape[1]), 0
    rest[TUBES], rest[JOINTS], rest[CONTACT], rest[PASSES] = len(tubes), joints.shape[1], np.inf, -1.0
    nothing = parts(rest).joints
    for row in range(first, last):
        robot = packed[row if packed.shape[0] > 1 else 0]
        before, cold = rest, True
        if start == NEAR:
            before, cold = near[row], not near[row, PASSES] > 0.0
        elif start == ALONG and not (fresh and row == first):
            before, cold = numbers[row - 1], not numbers[row - 1, PASSES] > 0.0
        if cold:
            force = wrenches[row, 0] ** 2 + wrenches[row, 1] ** 2 + wrenches[row, 2] ** 2
            moment = abs(wrenches[row, 3]) + abs(wrenches[row, 4]) + abs(wrenches[row, 5])
            layout = unpack(robot)
            _, beta, stands = tube_poses(layout, joints[row])
            solved = stands and moment == 0.0 and only_shape(layout, beta, np.sqrt(force), tubes)
            if solved:
                for j in range(joints.shape[1]):
                    nothing[j] = joints[row, j]
                solved = newton(
                    robot, order, sublink, joints[row], wrenches[row], rest, np.inf, 0, CLOSEST, tubes, columns,
                    numbers[row],
                )  # fmt: skip
                # Sub-links, as the tubes do not, may balance in a twist far beyond what they can tell.
                solved = solved and numbers[row, STABILITY] > 0.0
        else:
            solved = newton(
                robot, order, sublink, joints[row], wrenches[row], before, np.inf, 1, CLOSE, tubes, columns,
                numbers[row],
            )  # fmt: skip
        if not solved:
            left[stays] = row
            stays += 1
            if start == ALONG:
                return row + 1, stays
    return last, stays
