"""Fixtures of the model's tests: exact tips, robots with one or three tubes, and numerical derivatives of a tip."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.robot.robot import Joint, Robot, Section, Tube

EXACT_TIPS = Path(__file__).parents[1] / "exact_tips.csv"

#: Half step of the central differences for each unit.
STEPS = {"rad": 1e-5, "m": 1e-6, "N": 1e-5, "N m": 1e-6}


@pytest.fixture(scope="session")
def exact_tips() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return joints, wrench and tip [m] of the paper's robot; three independent solvers agree on the tip to 1e-5 mm."""
    table = np.loadtxt(EXACT_TIPS, delimiter=",", skiprows=1)
    return [(row[[1, 2, 0]], np.r_[row[3:6], 0.0, 0.0, 0.0], 1e-3 * row[6:9]) for row in table]


@pytest.fixture(scope="session")
def one_tube():
    """Return a function that makes a robot of one tube, which turns and slides."""

    def make(*sections: Section, bending_stiffness: float = 0.04, poisson_ratio: float = 0.30) -> Robot:
        tube = Tube("only", sections, bending_stiffness, poisson_ratio)
        return Robot("one", (tube,), (Joint("rotation", 0, "rotation"), Joint("translation", 0, "translation")))

    return make


@pytest.fixture(scope="session")
def three_tubes() -> Robot:
    """Return a robot of three tubes and six joints: rotation and translation of each tube, the innermost first."""
    tubes = (
        Tube("a", (Section(0.20), Section(0.10, (6.0, 0.0))), 0.02, 0.30, 1.0e-3, 0.5e-3),
        Tube("b", (Section(0.10), Section(0.10, (3.0, 2.0))), 0.04, 0.35, 1.8e-3, 1.2e-3),
        Tube("c", (Section(0.03), Section(0.08, (2.0, 0.0))), 0.09, 0.25, 2.6e-3, 2.0e-3),
    )
    joints = [Joint(f"{tube.name} {motion}", i, motion) for i, tube in enumerate(tubes) for motion in MOTIONS]
    return Robot("three", tubes, tuple(joints))


MOTIONS = ("rotation", "translation")


@pytest.fixture(scope="session")
def differences():
    """Return a function that differentiates a solved tip (position, then rotation) by central differences."""

    def differences(solver, joints: np.ndarray, wrench: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return J (6, n) and C (6, 6)."""
        n = joints.size
        steps = [STEPS[joint.unit] for joint in solver.robot.joints] + 3 * [STEPS["N"]] + 3 * [STEPS["N m"]]
        columns = []
        for k, step in enumerate(steps):
            moved = np.zeros(n + 6)
            moved[k] = step
            up = solver.solve(joints + moved[:n], wrench + moved[n:])
            down = solver.solve(joints - moved[:n], wrench - moved[n:])
            turned = Rotation.from_matrix(up.rotation @ down.rotation.T).as_rotvec()
            columns.append(np.r_[up.tip - down.tip, turned] / (2.0 * step))
        derivative = np.column_stack(columns)
        return derivative[:, :n], derivative[:, n:]

    return differences


@pytest.fixture(scope="session")
def poses():
    """Return a function that draws poses of the paper's robot, and tip wrenches up to a force [N] and moment [N m]."""

    def draw(seed: int, count: int, force: float, moment: float = 0.0) -> list[tuple[np.ndarray, np.ndarray]]:
        random = np.random.default_rng(seed)
        drawn = []
        for _ in range(count):
            joints = np.r_[random.uniform(-np.pi, np.pi, 2), random.uniform(-0.125, -0.01)]
            directions = random.normal(size=(2, 3))
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            sizes = random.uniform(0.0, [force, moment])
            drawn.append((joints, (directions * sizes[:, None]).ravel()))
        return drawn

    return draw
