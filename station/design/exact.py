"""What was found held against the exact rod: another formulation, without sub-links."""

from typing import NamedTuple

import numpy as np

from core.model.cosserat import ExactRod, Rod
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.design.study import StudyTaskFile
from station.design.task import Held


class Exact(NamedTuple):
    """The exact rod at the joints that the model has found."""

    away: float  #: of its tip from the points, at worst [m]
    margin: float  #: least of stability [1]


def exact(file: RobotFile, task: StudyTaskFile, held: Held) -> Exact:
    """Solve it at every point under every force.

    Raises:
        NoSolution: it has no shape there.

    """
    rod = ExactRod(file.robot())
    away, margin = 0.0, np.inf
    for force, row in zip(held.load * np.array(task.forces), held.joints, strict=True):
        at: Rod | None = None
        for point, joints in zip(np.array(task.points), row, strict=True):
            wrench: Array = np.concatenate((force, np.zeros(3)))
            at = rod.solve(joints, wrench, at)
            away = max(away, float(np.linalg.norm(at.tip - point)))
            margin = min(margin, rod.stability(joints, wrench, at))
    return Exact(away, margin)
