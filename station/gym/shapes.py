"""Computation of the tips of k robots that move: with the loaded model in batches, or with exact rods one by one.

A robot can have several shapes at the same joint positions. Each solver starts from the robot's previous shape, so
that the simulated robot snaps where a real robot would.
"""

from typing import Protocol

import numpy as np

from core.errors import CtrError
from core.model.batch import Solutions
from core.model.cosserat import ExactRod, Rod
from core.model.solution import PASSES, Solution, size
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.solve_many import solve_many


class ShapeSolver(Protocol):
    """Interface of a solver for the tips of k robots; each row of an array belongs to one robot."""

    def replace(self, row: int, robot: Robot) -> None:
        """Use another robot in this row from now on."""
        ...

    def solve_from_rest(self, row: int, joints: Array, wrench: Array) -> Array:
        """Return the tips (m, 3) [m] of a row's robot at joints (m, n), NaN where the robot has no shape.

        The solver does not use the robot's previous shape. Afterwards the robot is at the first of the joint positions.
        """
        ...

    def follow(self, joints: Array, wrenches: Array) -> tuple[Array, list[int]]:
        """Move all robots to joints (k, n) and wrenches (k, 6); return tips (k, 3) [m] and the rows without a shape.

        Robots without a shape stay at their pose, and their returned tips are invalid.
        """
        ...


class LoadedShapes:
    """Solver that uses the loaded model."""

    def __init__(self, robot: Robot, rows: int) -> None:
        self.models = [Statics(robot)] * rows
        self._alike = True
        self._at = Solutions(
            np.full((rows, size(len(robot.tubes), len(robot.joints))), np.nan), {},
            len(robot.tubes), len(robot.joints),
        )  # fmt: skip

    def replace(self, row: int, robot: Robot) -> None:
        """See `ShapeSolver`."""
        if robot is not self.models[row].robot:
            self.models[row] = Statics(robot)
            self._alike = len(self.models) == 1

    def solve_from_rest(self, row: int, joints: Array, wrench: Array) -> Array:
        """See `ShapeSolver`."""
        found = solve_many(self.models[row], joints, np.tile(wrench, (len(joints), 1)), threads=1)
        self._at.numbers[row] = found.numbers[0]
        return found.tip

    def follow(self, joints: Array, wrenches: Array) -> tuple[Array, list[int]]:
        """See `ShapeSolver`."""
        at = self._at
        if len(self.models) == 1:  # for a single robot `solve` is faster than a batch and gives the same result
            near = Solution(at.numbers[0]) if at.numbers[0, PASSES] > 0.0 else None
            try:
                alone = self.models[0].solve(joints[0], wrenches[0], near)
            except CtrError:
                return at.tip.copy(), [0]
            self._at = Solutions(alone.numbers[None], {}, at.tubes, at.joints)
            return alone.tip[None], []
        found = solve_many(self.models[0] if self._alike else self.models, joints, wrenches, near=at)
        lost = list(found.failures)
        tips = found.tip.copy()
        if lost:
            found.numbers[lost] = at.numbers[lost]
        self._at = Solutions(found.numbers, {}, at.tubes, at.joints)
        return tips, lost


class ExactShapes:
    """Solver that uses the exact rod, which is formulated differently from the model and has no sub-links."""

    def __init__(self, robot: Robot, rows: int) -> None:
        self._models = [ExactRod(robot)] * rows
        self._at: list[Rod | None] = [None] * rows

    def replace(self, row: int, robot: Robot) -> None:
        """See `ShapeSolver`."""
        if robot is not self._models[row].robot:
            self._models[row] = ExactRod(robot)

    def solve_from_rest(self, row: int, joints: Array, wrench: Array) -> Array:
        """See `ShapeSolver`."""
        rods = [self._solve(row, pose, wrench, None) for pose in joints]
        self._at[row] = rods[0]
        return np.array([np.full(3, np.nan) if rod is None else rod.tip for rod in rods])

    def follow(self, joints: Array, wrenches: Array) -> tuple[Array, list[int]]:
        """See `ShapeSolver`."""
        tips, lost = np.empty((len(joints), 3)), list[int]()
        for row, (pose, wrench) in enumerate(zip(joints, wrenches, strict=True)):
            rod = self._solve(row, pose, wrench, self._at[row])
            if rod is None:
                lost.append(row)
            else:
                self._at[row], tips[row] = rod, rod.tip
        return tips, lost

    def _solve(self, row: int, joints: Array, wrench: Array, near: Rod | None) -> Rod | None:
        try:
            return self._models[row].solve(joints, wrench, near)
        except CtrError:
            return None
