"""How a robot does with a study's task: can its tip be held at every point under every load, and how well.

The joints are found by the controller's own limit-aware inverse, walked on the model: from poses all over the joint
space to the first point, from point to point without load, then under each force in steps. What is held at the end
is what a robot that is led slowly could do; noise, delay and friction are the virtual lab's.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.control.inverse import inverse
from core.errors import CtrError
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.design.measures import dexterity, stiffness
from station.design.poses import spread_poses
from station.design.study import Objective, StudyTaskFile
from station.solve_many import solve_many

#: Poses that are looked at for a way to the first point, and how many of them are gone from.
LOOKED, STARTS = 96, 6
#: Two ways to a point have come to the same pose when their tubes lie this close [rad or m over full speed: s].
SAME = 1e-2
#: In one step of a walk the tip goes no further [m], and joints no further than in this time at full speed [s].
STRIDE, LONGEST = 0.01, 0.5
#: Steps of a walk to a place before it is given up, and how close it comes if it can, in parts of the tolerance.
MOST_STEPS, CLOSE = 60, 0.1
#: A load grows by this part, of the task's at first, and no further than this many times.
GROWTH, MOST_LOAD = 0.25, 20.0
#: The largest load is found to this part of the task's.
FINE = 0.01


class Held(NamedTuple):
    """What is least along the points, under multiples of the forces."""

    load: float  #: the multiple
    joints: Array  #: (forces, points, n) [rad or m]
    margins: Array  #: (forces, points) of stability [1]
    dexterities: Array  #: (forces, points) [m/s]
    stiffnesses: Array  #: (forces, points) [N/m]


@dataclass(frozen=True)
class Outcome:
    """How a robot does with a task."""

    away: float  #: of the tip from the points, at worst, without load [m]
    load: float  #: largest multiple of the forces that is held; 0: not even the points are reached
    why: str  #: what ends it
    held: Held | None  #: under the forces as they are; None: they are not held
    most: Held | None  #: under the largest multiple


def done(file: RobotFile, task: StudyTaskFile, objective: Objective, most: float = MOST_LOAD) -> Outcome:
    """Carry out the task in the best of the ways that were found; loads grow up to `most` times the task's.

    Raises:
        ConfigError: the tubes stand hardly anywhere in their joints' travel.

    """
    walker = _Walker(file, task)
    best = Outcome(math.inf, 0.0, "no pose has a shape", None, None)
    for start in walker.starts():
        best = min(best, _way(walker, start, most), key=lambda outcome: cost(outcome, objective))
    return best


def cost(outcome: Outcome, objective: Objective) -> float:
    """The smaller the better, also among those that cannot carry out the task: a search has to see the way out."""
    if outcome.load == 0.0:
        return 3.0 + min(100.0 * outcome.away, 1e3)
    if objective == "load":
        return -outcome.load
    if outcome.held is None:
        return 2.0 - outcome.load
    return -float((outcome.held.margins if objective == "margin" else outcome.held.stiffnesses).min())


def _way(walker: "_Walker", start: Solution, most: float) -> Outcome:
    """From a pose to the first point, along all of them, and then the loads."""
    bare: list[Solution] = []
    at, away = start, 0.0
    for number, point in enumerate(walker.points):
        at, off, why = walker.go(at, point, np.zeros(6))
        if why:
            # What is left of the way counts: a search is to see that one comes further than another.
            left = float(np.linalg.norm(walker.points[number:] - at.tip, axis=1).max())
            return Outcome(max(off, left), 0.0, f"at point {number + 1} without load: {why}", None, None)
        bare.append(at)
        away = max(away, off)
    rows, held, here, step, why = [bare] * len(walker.forces), None, 0.0, GROWTH, ""
    while here < most and step >= FINE:
        to = min(here + step, 1.0 if here < 1.0 else most)
        found, said = walker.loaded(rows, to)
        if found is None:
            why, step = said, 0.5 * (to - here)
            continue
        rows, here = found, to
        step = 0.5 * step if why else GROWTH * max(1.0, here)
        held = rows if here == 1.0 else held
    return Outcome(
        away,
        here,
        why or f"more than {most:g} times was not tried",
        None if held is None else walker.numbers(1.0, held),
        walker.numbers(here, rows),
    )


class _Walker:
    """One robot and its task."""

    def __init__(self, file: RobotFile, task: StudyTaskFile) -> None:
        self.file, self.task, self.limits = file, task, file.limits()
        self.model = Statics(file.robot())
        self.points, self.forces = np.array(task.points), np.array(task.forces)
        self._lower, self._upper, self._speed = self.limits.packed[:3]
        # Only what the tubes themselves demand: a task's points lie where they lie.

    def starts(self) -> Iterator[Solution]:
        """Poses at the first point, or as near as it goes, each another one."""
        poses = spread_poses(self.file, LOOKED, 0)
        found = solve_many(self.model, poses, np.zeros((LOOKED, 6)), threads=1)
        away = np.linalg.norm(found.tip - self.points[0], axis=1)
        seen: list[Array] = []
        for row in [row for row in np.argsort(away).tolist() if found.ok[row]][:STARTS]:
            at, _, _ = self.go(found.at(row), self.points[0], np.zeros(6))
            if all(np.abs((at.joints - other) / self._speed).max() > SAME for other in seen):
                seen.append(at.joints.copy())
                yield at

    def go(self, at: Solution, point: Array, wrench: Array) -> tuple[Solution, float, str]:
        """Walk to a point (3,) under a wrench (6,): where that ends, how far off [m], and what is in the way."""
        close, reasons = CLOSE * self.task.tolerance, ""
        try:
            at = self.model.solve(at.joints.copy(), wrench, at)
            for _ in range(MOST_STEPS):
                way = point - at.tip
                away = float(np.linalg.norm(way))
                if away <= close:
                    break
                lower = np.maximum(self._lower - at.joints, -LONGEST * self._speed).clip(max=0.0)
                upper = np.minimum(self._upper - at.joints, LONGEST * self._speed).clip(min=0.0)
                rows, bound = self.limits.order
                room = (bound - rows @ at.joints).clip(min=0.0)
                found = inverse(at.jacobian[:3], way * min(1.0, STRIDE / away), self._speed, lower, upper, rows, room)
                reasons = ", ".join(self.limits.active(at.joints, found.at_bound, found.at_row))
                if np.abs(found.velocity / self._speed).max() < 1e-7:
                    break
                to = np.clip(at.joints + found.velocity, self._lower, self._upper)
                at = self.model.solve(to, wrench, at)
        except CtrError as error:
            return at, float(np.linalg.norm(at.tip - point)), str(error)
        away = float(np.linalg.norm(at.tip - point))
        if away > self.task.tolerance:
            return at, away, f"the tip stays {1e3 * away:.2g} mm off ({reasons or 'no joint takes it nearer'})"
        return at, away, self._lacking(at)

    def _lacking(self, at: Solution) -> str:
        """What is too little there; empty when nothing is."""
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
        """Every point under `load` times every force, from the same under less; None and why not."""
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

    def numbers(self, load: float, rows: list[list[Solution]]) -> Held:
        """What the tubes are like there."""
        jacobians = np.array([[at.jacobian for at in row] for row in rows])
        compliances = np.array([[at.compliance for at in row] for row in rows])
        shape = jacobians.shape[:2]
        return Held(
            load,
            np.array([[at.joints for at in row] for row in rows]),
            np.array([[at.stability for at in row] for row in rows]),
            dexterity(jacobians.reshape(-1, *jacobians.shape[2:]), self._speed).reshape(shape),
            stiffness(compliances.reshape(-1, 6, 6)).reshape(shape),
        )
