"""Check of a found robot with the exact rod: another model of the tubes, which does not divide them into sub-links."""

from typing import NamedTuple

import numpy as np

from core.model.cosserat import ExactRod, Rod
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.design.study import StudyTaskFile
from station.design.task import HeldLoad


class ExactCheck(NamedTuple):
    """Numbers of the exact rod at the joint positions that the evaluation has found with the sub-link model."""

    distance: float  #: largest distance of the exact rod's tip from the task's points [m]
    margin: float  #: smallest margin of stability of the exact rod [1]


def exact(file: RobotFile, task: StudyTaskFile, held: HeldLoad) -> ExactCheck:
    """Compute the exact rod at every point of a task under every force, and return the check.

    Raises:
        NoSolution: the exact rod has no solution at one of the points.

    """
    rod = ExactRod(file.robot())
    distance, margin = 0.0, np.inf
    for force, row in zip(held.load * np.array(task.forces), held.joints, strict=True):
        at: Rod | None = None
        for point, joints in zip(np.array(task.points), row, strict=True):
            wrench: Array = np.concatenate((force, np.zeros(3)))
            at = rod.solve(joints, wrench, at)
            distance = max(distance, float(np.linalg.norm(at.tip - point)))
            margin = min(margin, rod.stability(joints, wrench, at))
    return ExactCheck(distance, margin)
