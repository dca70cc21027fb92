"""Evaluation of a study's task: whether a robot keeps its tip at every point under every load, and how well.

The inverse kinematics of the controller respects the limits of joints and tubes. On the model it moves the tip from
poses all over the joint space to the first point, then from point to point without load. Then each force is applied in
steps. The result is quasi-static and does not include noise, delay and friction; only the virtual lab simulates them.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.control.tip_motion import Aim, move_tip
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.design.inverse_kinematics import SAME_POSE_S, paths
from station.design.study import Objective, StudyTaskFile

#: Number of compared start poses, and largest number of paths to the first point of the task. The paths start at the
#: poses whose tips are nearest to this point.
START_POSES, MAX_WALKS = 96, 6
#: First step in which the load grows, and largest load, both as multiples of the forces of the task.
LOAD_STEP_SHARE, MAX_LOAD_RATIO = 0.25, 20.0
#: Smallest step of the load, as a multiple of the forces of the task; it is the resolution of the largest load.
LOAD_RESOLUTION = 0.01


def dexterity(jacobian: Array, speed: Array) -> Array:
    """Return the dexterity (k,) [m/s]: speed of the tip in its slowest direction while the joints move at full speed.

    The dexterity is the smallest singular value of the position rows of J diag(speed). Scaling the Jacobian J with the
    top speeds makes joints in radians and in metres comparable.

    Args:
        jacobian: Jacobians of the tip at k poses (k, 6, n) [m/rad or m/m].
        speed: top speed of the joints (n,) [rad/s or m/s].

    """
    if jacobian.shape[2] < 3:
        return np.zeros(len(jacobian))  # two joints cannot move the tip in all three directions
    return np.asarray(np.linalg.svd(jacobian[:, :3] * speed, compute_uv=False)[:, 2], np.float64)


def stiffness(compliance: Array) -> Array:
    """Return the tip's stiffness in its softest direction at k poses (k,) [N/m], from compliances (k, 6, 6)."""
    return 1.0 / np.asarray(np.linalg.svd(compliance[:, :3, :3], compute_uv=False)[:, 0], np.float64)


class HeldLoad(NamedTuple):
    """Joint positions and quality measures at the points of a task, under a multiple of its forces."""

    load: float  #: multiple of the task's forces [1]
    joints: Array  #: joint positions (forces, points, n) [rad or m]
    margins: Array  #: margins of stability (forces, points) [1]
    dexterities: Array  #: dexterities (forces, points) [m/s]
    stiffnesses: Array  #: stiffnesses (forces, points) [N/m]


@dataclass(frozen=True)
class TaskResult:
    """Result of the evaluation of a robot for a task."""

    distance: float  #: largest distance of the tip from the points, without load [m]
    load: float  #: largest multiple of the forces that the robot holds; 0: it fails even without load
    why: str  #: limit that prevents a larger load
    nominal: HeldLoad | None  #: poses under the task's forces; None if the robot does not hold them
    largest: HeldLoad | None  #: poses under the largest multiple of the forces that is held


def evaluate(
    file: RobotFile, task: StudyTaskFile, objective: Objective, max_ratio: float = MAX_LOAD_RATIO
) -> TaskResult:
    """Return the best result of several paths through a task; the load grows up to `max_ratio` times the task's forces.

    Raises:
        ConfigError: almost no joint position is valid.

    """
    walker = _Walker(file, task)
    best = TaskResult(math.inf, 0.0, "no pose has a shape", None, None)
    for start in walker.starts():
        best = min(best, _walk_path(walker, start, max_ratio), key=lambda outcome: cost(outcome, objective))
    return best


def cost(outcome: TaskResult, objective: Objective) -> float:
    """Return the cost to minimise. The cost also ranks robots that fail the task, so that a search can improve them."""
    if outcome.load == 0.0:
        return 3.0 + min(100.0 * outcome.distance, 1e3)
    if objective == "load":
        return -outcome.load
    if outcome.nominal is None:
        return 2.0 - outcome.load
    return -float((outcome.nominal.margins if objective == "margin" else outcome.nominal.stiffnesses).min())


def _walk_path(walker: "_Walker", start: Solution, max_ratio: float) -> TaskResult:
    """Move the robot from a pose through all points, then under growing loads; return the result."""
    unloaded: list[Solution] = []
    at, distance = start, 0.0
    for number, point in enumerate(walker.points):
        at, off, why = walker.go(at, point, np.zeros(6))
        if why:
            # This distance is part of the cost, so a search prefers robots that come nearer to all points.
            remaining = float(np.linalg.norm(walker.points[number:] - at.tip, axis=1).max())
            return TaskResult(max(off, remaining), 0.0, f"at point {number + 1} without load: {why}", None, None)
        unloaded.append(at)
        distance = max(distance, off)
    rows, nominal, here, step, why = [unloaded] * len(walker.forces), None, 0.0, LOAD_STEP_SHARE, ""
    while here < max_ratio and step >= LOAD_RESOLUTION:
        to = min(here + step, 1.0 if here < 1.0 else max_ratio)
        found, reason = walker.loaded(rows, to)
        if found is None:
            why, step = reason, 0.5 * (to - here)
            continue
        rows, here = found, to
        step = 0.5 * step if why else LOAD_STEP_SHARE * max(1.0, here)
        nominal = rows if here == 1.0 else nominal
    return TaskResult(
        distance,
        here,
        why or f"more than {max_ratio:g} times the forces was not evaluated",
        None if nominal is None else walker.numbers(1.0, nominal),
        walker.numbers(here, rows),
    )


class _Walker:
    """Computes quasi-static motions of one robot along the points and forces of a task."""

    def __init__(self, file: RobotFile, task: StudyTaskFile) -> None:
        self.file, self.task, self.limits = file, task, file.limits()
        self.model = Statics(file.robot())
        self.points, self.forces = np.array(task.points), np.array(task.forces)
        self._speed = self.limits.speed
        # Only the limits of joints and tubes apply. The workspace limit in the robot's file is for the operation of
        # a robot and does not restrict the points of a design task.

    def starts(self) -> Iterator[Solution]:
        """Yield different poses with the tip at the first point of the task, or as near to this point as possible."""
        visited: list[Array] = []
        first = self._aim(self.points[0], np.zeros(6))
        for at, _, _ in paths(self.file, self.model, self.limits, first, 0, START_POSES, MAX_WALKS):
            if all(np.abs((at.joints - other) / self._speed).max() > SAME_POSE_S for other in visited):
                visited.append(at.joints.copy())
                yield at

    def go(self, at: Solution, point: Array, wrench: Array) -> tuple[Solution, float, str]:
        """Move to a point (3,) under a wrench (6,); return the last pose, its distance [m], and why it fails or ''."""
        at, distance, why = move_tip(self.model, self.limits, self.limits.order, at, self._aim(point, wrench))
        if why and distance > self.task.tolerance:
            why = f"the tip stays {1e3 * distance:.2g} mm from the point ({why})"
        return at, distance, why or self._violated_minimum(at)

    def _aim(self, point: Array, wrench: Array) -> Aim:
        return Aim(point, self.task.tolerance, wrench)

    def _violated_minimum(self, at: Solution) -> str:
        """Return a text about the task's minimum (margin, dexterity, stiffness) that a pose violates; empty: none."""
        if at.stability < self.task.margin:
            return f"margin {at.stability:.3g} is below {self.task.margin:g}"
        slowest = float(dexterity(at.jacobian[None], self._speed)[0])
        if slowest < self.task.dexterity:
            return f"dexterity {1e3 * slowest:.4g} mm/s is below {1e3 * self.task.dexterity:g} mm/s"
        softest = float(stiffness(at.compliance[None])[0])
        if softest < self.task.stiffness:
            return f"stiffness {softest:.3g} N/m is below {self.task.stiffness:g} N/m"
        return ""

    def loaded(self, rows: list[list[Solution]], load: float) -> tuple[list[list[Solution]] | None, str]:
        """Return the poses at every point under `load` times every force, or None and the reason.

        `rows` are the poses under the previous, smaller load.
        """
        found: list[list[Solution]] = []
        for force, row in zip(self.forces, rows, strict=True):
            wrench = np.concatenate((load * force, np.zeros(3)))
            if not force.any():
                found.append(row)
                continue
            line: list[Solution] = []
            for number, (at, point) in enumerate(zip(row, self.points, strict=True), 1):
                to, _, why = self.go(at, point, wrench)
                if why:
                    size = load * float(np.linalg.norm(force))
                    return None, f"at point {number} under {size:.3g} N: {why}"
                line.append(to)
            found.append(line)
        return found, ""

    def numbers(self, load: float, rows: list[list[Solution]]) -> HeldLoad:
        """Return joint positions and quality measures of the poses `rows` under `load`."""
        jacobians = np.array([[at.jacobian for at in row] for row in rows])
        compliances = np.array([[at.compliance for at in row] for row in rows])
        shape = jacobians.shape[:2]
        return HeldLoad(
            load,
            np.array([[at.joints for at in row] for row in rows]),
            np.array([[at.stability for at in row] for row in rows]),
            dexterity(jacobians.reshape(-1, *jacobians.shape[2:]), self._speed).reshape(shape),
            stiffness(compliances.reshape(-1, 6, 6)).reshape(shape),
        )
