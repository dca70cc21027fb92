"""Where the tips of k robots are while their joints move: the loaded model in batches, or the exact rod one by one.

Each robot keeps to its branch, so that it snaps where a real one would; a pose without a shape is told as NaN.
"""

from typing import Protocol

import numpy as np

from core.errors import CtrError
from core.model.cosserat import ExactRod, Rod
from core.model.many import Solutions
from core.model.solution import count
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.solve_many import solve_many


class Shapes(Protocol):
    """Robots, one a row."""

    def replace(self, row: int, robot: Robot) -> None:
        """Another robot stands in this row from now on."""
        ...

    def look(self, row: int, joints: Array, wrench: Array) -> Array:
        """Tips (m, 3) [m] of a row's robot at joints (m, n), from rest; it stays at the first of them."""
        ...

    def follow(self, joints: Array, wrenches: Array) -> Array:
        """Tips (k, 3) [m] of all robots, moved on to joints (k, n) and wrenches (k, 6); one without a shape stays."""
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

    def follow(self, joints: Array, wrenches: Array) -> Array:
        """See `Shapes`."""
        found = solve_many(self.models[0] if self._alike else self.models, joints, wrenches, near=self._at)
        tips = found.tip
        if found.failures:
            tips, lost = tips.copy(), list(found.failures)
            found.numbers[lost] = self._at.numbers[lost]
        self._at = Solutions(found.numbers, {}, found.tubes, found.joints)
        return tips


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

    def follow(self, joints: Array, wrenches: Array) -> Array:
        """See `Shapes`."""
        tips = np.full((len(joints), 3), np.nan)
        for row, (pose, wrench) in enumerate(zip(joints, wrenches, strict=True)):
            rod = self._solve(row, pose, wrench, self._at[row])
            if rod is not None:
                self._at[row], tips[row] = rod, rod.tip
        return tips

    def _solve(self, row: int, joints: Array, wrench: Array, near: Rod | None) -> Rod | None:
        try:
            return self._models[row].solve(joints, wrench, near)
        except CtrError:
            return None
