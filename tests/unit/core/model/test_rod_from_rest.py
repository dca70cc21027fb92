"""The exact rod without a warm start has the stable shape that the robot reaches from rest, as the model has."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.model.cosserat import ExactRod
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.config.robots import load_robot
from station.lab.config import PlantConfig
from station.lab.plant import Plant
from tests.harness.root import ROOT
from tests.measure.solver import published

#: Same shape: the tips of model and exact rod are closer than this [m]; another branch is millimetres away.
SAME_TIP_M = 2e-5
UNLOADED = np.zeros(6)


def poses(robot: Robot, seed: int, count: int) -> list[Array]:
    """Return random valid poses, with all rotations up to half a turn."""
    rng, found = np.random.default_rng(seed), []
    lengths = np.array([tube.length for tube in robot.tubes])
    while len(found) < count:
        joints = np.array(
            [
                rng.uniform(-math.pi, math.pi) if joint.motion == "rotation" else -rng.uniform(0.0, lengths[joint.tube])
                for joint in robot.joints
            ]
        )
        if robot.is_valid_pose(joints):
            found.append(joints)
    return found


@pytest.mark.parametrize("name", ["nylon", "khadem", "grassmann", "rvim"])
def test_cold_rods_of_robots_that_snap_are_stable_and_have_the_shape_of_the_model(name):
    robot = load_robot("nylon").robot() if name == "nylon" else published(name)
    model, rod = Statics(robot), ExactRod(robot)
    for joints in poses(robot, seed=3, count=200 if name == "nylon" else 60):
        found = rod.solve(joints, UNLOADED)
        assert np.linalg.norm(found.tip - model.solve(joints, UNLOADED).tip) < SAME_TIP_M
        assert rod.stability(joints, UNLOADED, found) > 0.0


def test_the_lab_starts_with_the_shape_that_its_robot_reaches_from_rest():
    robot = published("rvim")
    model = Statics(robot)
    for seed, joints in enumerate(poses(robot, seed=4, count=30)):
        plant = Plant(robot, PlantConfig(tubes={}), np.random.default_rng(seed), joints)
        at = plant.advance(joints, np.zeros(3)).truth.tip
        assert np.linalg.norm(at - model.solve(joints, UNLOADED).tip) < SAME_TIP_M


def test_a_load_that_ends_the_branch_of_the_unloaded_tubes_still_has_a_stable_shape():
    # Turned first and loaded afterwards, these tubes snap; turned while the load grows, they do not.
    robot, joints = load_robot(str(ROOT / "tests/harness/straight_outer_tube.toml")).robot(), np.array(
        [-2.26947876, -0.02989845, -1.31345575, -0.06271554, 1.35202273, -0.18016992]
    )  # fmt: skip
    true = ((14.724505728578247, 0.002677088813431738), (5.775361851259616, 0.013488074375445783),
            (0.5074019048793641, 0.0511053128622246))  # fmt: skip
    robot = replace(robot, tubes=tuple(
        replace(tube, sections=(tube.sections[0], replace(tube.sections[1], curvature=(curvature, 0.0))),
                bending_stiffness=stiffness, poisson_ratio=0.35)
        for tube, (curvature, stiffness) in zip(robot.tubes, true, strict=True)
    ))  # fmt: skip
    load, rod = np.array([0.14, 0.0, 0.0, 0.0, 0.0, 0.0]), ExactRod(robot)
    found = rod.solve(joints, load)
    assert rod.stability(joints, load, found) > 0.0
    assert np.linalg.norm(found.tip - Statics(robot).solve(joints, load).tip) < SAME_TIP_M
