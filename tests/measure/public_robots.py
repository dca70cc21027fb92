"""`python -m tests.measure.public_robots [POSES]`: the model against boundary-value solutions of ten public robots.

The joints are random: any rotation, and translations at which every tube starts behind the next outer one and ends
beyond the plate, in any order of the ends. Half of the poses carry a random force. The judge is `boundary_value`. It
starts from the model's unknowns, so equal shapes are compared; `python -m tests.measure solver` checks that they are
the shapes that the robot reaches from rest. `core/README.md` has the largest errors.
"""

import math
import sys
import time
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from core.errors import NoSolution
from core.model.statics import Statics
from core.robot.robot import Array, Indices, Robot
from station.config.robots import load_robot
from tests.harness.boundary_value import boundary_value
from tests.measure.accuracy import apart
from tests.measure.solver import TubeRow, annulus, published, robot_of

#: Force as a multiple of EI / L^2 of the innermost tube, up to which poses are loaded (L: length beyond the plate).
LOAD = 2.0

#: Robots beside the presets and those of `solver`.
MORE: Mapping[str, tuple[TubeRow, ...]] = {
    # github.com/fcpedrosa/Concentric-Tube-Robot, executable/Main.cpp, commit 04e9e43: E = 65 GPa, nu = 0.32.
    "pedrosa": (
        TubeRow(0.25, 0.06, *annulus(65e9, 65e9 / 2.64, 0.92e-3, 0.80e-3), 25.0),
        TubeRow(0.20, 0.08, *annulus(65e9, 65e9 / 2.64, 1.10e-3, 0.97e-3), 10.0),
        TubeRow(0.13, 0.04, *annulus(65e9, 65e9 / 2.64, 1.40e-3, 1.20e-3), 1.0 / 0.14),
    ),
    # github.com/swagholikar29/Path-Planning-of-Biomedical-Concentric-Tube-Continuum-Robots, two versions of main.m:
    # E = 1.9 GPa; nu = 0.3 is assumed.
    "wagholikar thin": (
        TubeRow(0.15, 0.05, *annulus(1.9e9, 1.9e9 / 2.6, 2.0e-3, 1.5e-3), 30.0),
        TubeRow(0.15, 0.05, *annulus(1.9e9, 1.9e9 / 2.6, 3.0e-3, 2.5e-3), 15.0),
    ),
    "wagholikar": (
        TubeRow(0.297, 0.05, *annulus(1.9e9, 1.9e9 / 2.6, 2.2e-3, 1.7e-3), 50.0),
        TubeRow(0.147, 0.05, *annulus(1.9e9, 1.9e9 / 2.6, 3.8e-3, 3.3e-3), 30.0),
    ),
}


POSITION_AND_ROTATION = (slice(0, 3), slice(3, 6))


class Comparison(NamedTuple):
    """Largest errors of one robot's poses."""

    poses: int
    retracted: int  #: poses at which the innermost tube is not the last to end
    refused: int  #: poses at which the model finds no shape
    tip: float  #: [m]
    jacobian: float  #: largest relative error, see `relative`
    compliance: float


def robots() -> Iterator[Robot]:
    """Yield the ten robots."""
    for name in ("paper", "balanced_pair", "three_tubes", "nylon"):
        yield load_robot(name).robot()
    for name in ("khadem", "grassmann", "rvim"):
        yield published(name)
    for name, rows in MORE.items():
        yield robot_of(name, rows, None)


def random_pose(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return joints (n,) and a wrench (6,)."""
    while True:
        starts, ahead = [0.0] * len(robot.tubes), 0.0
        for i in range(len(robot.tubes) - 1, -1, -1):
            starts[i] = ahead = rng.uniform(-robot.tubes[i].length, max(ahead, -robot.tubes[i].length))
        joints = np.array([
            rng.uniform(-math.pi, math.pi) if joint.motion == "rotation" else starts[joint.tube]
            for joint in robot.joints
        ])  # fmt: skip
        if robot.is_valid_pose(joints) and apart(robot, joints) and robot.tube_ends(joints)[0] > 0.01:
            break
    direction, wrench = rng.normal(size=3), np.zeros(6)
    size = LOAD * robot.tubes[0].bending_stiffness / float(robot.tube_ends(joints)[0]) ** 2
    wrench[:3] = direction / np.linalg.norm(direction) * min(size, 5.0) * max(0.0, rng.uniform(-1.0, 1.0))
    return joints, wrench


def compare(robot: Robot, poses: int, seed: int = 0) -> Comparison:
    """Compare the model as it is shipped with boundary-value solutions."""
    rng, model = np.random.default_rng(seed), Statics(robot)
    slides = np.array([joint.motion == "translation" for joint in robot.joints])
    groups = [np.flatnonzero(~slides), np.flatnonzero(slides)]
    tips, found_rates, true_rates, retracted, refused = list[float](), list[Array](), list[Array](), 0, 0
    for _ in range(poses):
        joints, wrench = random_pose(robot, rng)
        retracted += int(robot.tube_ends(joints).argmax() > 0)
        try:
            found = model.solve(joints, wrench)
        except NoSolution:
            refused += 1
            continue
        truth = boundary_value(robot, joints, wrench, found.unknowns)
        tips.append(float(np.linalg.norm(found.tip - truth.tip)))
        found_rates.append(np.hstack((found.jacobian, found.compliance)))
        true_rates.append(np.hstack((truth.jacobian, truth.compliance)))
    both, n = (np.array(found_rates), np.array(true_rates)), len(robot.joints)
    jacobian = max(relative(*both, rows, group) for rows in POSITION_AND_ROTATION for group in groups if group.size)
    loads = [np.arange(start, start + 3, dtype=np.int64) for start in (n, n + 3)]
    compliance = max(relative(*both, rows, group) for rows in POSITION_AND_ROTATION for group in loads)
    return Comparison(poses, retracted, refused, max(tips), jacobian, compliance)


def relative(found: Array, truth: Array, rows: slice, columns: Indices) -> float:
    """Return the largest error of a block of derivatives (poses, 6, k), relative to the block's largest entry.

    Where a block nearly vanishes, as the rotations of a straight tip do, a hundredth of the largest block replaces it.
    """
    true = truth[:, rows][:, :, columns]
    size = np.abs(true).max(axis=(1, 2))
    error = np.abs(found[:, rows][:, :, columns] - true).max(axis=(1, 2))
    return float((error / np.maximum(size, 0.01 * size.max())).max())


def main(poses: int = 200) -> None:
    """Print the table."""
    columns = (
        "robot",
        "tubes",
        "poses, retracted tips",
        "no shape",
        "largest tip error [mm]",
        "error of J",
        "error of C",
    )
    print(f"| {' | '.join(columns)} |\n{len(columns) * '|---'}|")  # noqa: T201
    for robot in robots():
        start, found = time.monotonic(), compare(robot, poses)
        cells = (
            robot.name, len(robot.tubes), f"{found.poses}, {found.retracted}", found.refused, f"{1e3 * found.tip:.4f}",
            f"{found.jacobian:.1e}", f"{found.compliance:.1e}",
        )  # fmt: skip
        print("| " + " | ".join(map(str, cells)) + " |", flush=True)  # noqa: T201
        print(f"{robot.name}: {time.monotonic() - start:.0f} s", file=sys.stderr)  # noqa: T201


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
