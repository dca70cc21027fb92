"""Where the tips of k robots are while their joints move: the loaded model in batches, or the exact rod one by one.

Each robot keeps to its branch, so that it snaps where a real one would.
"""

from typing import Protocol

import numpy as np

from core.errors import CtrError
from core.model.cosserat import ExactRod, Rod
from core.model.many import Solutions
from core.model.solution import PASSES, Solution, count
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.solve_many import solve_many


class Shapes(Protocol):
    """Robots, one a row."""

    def replace(self, row: int, robot: Robot) -> None:
        """Another robot stands in this row from now on."""
        ...

    def look(self, row: int, joints: Array, wrench: Array) -> Array:
        """Tips (m, 3) [m] of a row's robot at joints (m, n), from rest, NaN without shape; it stays at the first."""
        ...

    def follow(self, joints: Array, wrenches: Array) -> tuple[Array, list[int]]:
        """Tips (k, 3) [m] of all robots, moved on to joints (k, n) and wrenches (k, 6), and which have no shape there.

        These stay, and their tips mean nothing.
        """
        ...


class LoadedShapes:
    """By the loaded model."""

    def __init__(self, robot: Robot, rows: int) -> None:
        self.models = [Statics(robot)] * rows
        self._alike = True
        self._at = Solutions(
            np.full((rows, count(len(robot.tubes), len(robot.joints))), np.nan), {},
            len(robot.tubes), len(robot.joints),
        )  # fmt: skip

    def replace(self, row: int, robot: Robot) -> None:
        """See `Shapes`."""
        if robot is not self.models[row].robot:
            self.models[row] = Statics(robot)
            self._alike = len(self.models) == 1

    def look(self, row: int, joints: Array, wrench: Array) -> Array:
        """See `Shapes`."""
        found = solve_many(self.models[row], joints, np.tile(wrench, (len(joints), 1)), threads=1)
        self._at.numbers[row] = found.numbers[0]
        return found.tip

    def follow(self, joints: Array, wrenches: Array) -> tuple[Array, list[int]]:
        """See `Shapes`."""
        at = self._at
        if len(self.models) == 1:  # the same, for less
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
    """By the exact rod: another formulation, without a model's sub-links."""

    def __init__(self, robot: Robot, rows: int) -> None:
        self._models = [ExactRod(robot)] * rows
        self._at: list[Rod | None] = [None] * rows

    def replace(self, row: int, robot: Robot) -> None:
        """See `Shapes`."""
        if robot is not self._models[row].robot:
            self._models[row] = ExactRod(robot)

    def look(self, row: int, joints: Array, wrench: Array) -> Array:
        """See `Shapes`."""
        rods = [self._solve(row, pose, wrench, None) for pose in joints]
        self._at[row] = rods[0]
        return np.array([np.full(3, np.nan) if rod is None else rod.tip for rod in rods])

    def follow(self, joints: Array, wrenches: Array) -> tuple[Array, list[int]]:
        """See `Shapes`."""
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
