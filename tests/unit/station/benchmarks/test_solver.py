"""The stability check by energy, compared with Euler's column."""

import math

import numpy as np
import pytest

from core.model.solution import at_rest
from core.model.statics import Statics
from core.robot.robot import Joint, Robot, Section, Tube
from station.benchmarks.solver import ZERO_EIGENVALUE, lowest


@pytest.mark.parametrize(("part", "stable"), [(-1.0, True), (0.0, True), (0.97, True), (1.03, False), (5.0, False)])
def test_straight_tube_is_stable_up_to_eulers_load(part, stable):
    tube = Tube("only", (Section(0.2),), 0.04)
    robot = Robot("one", (tube,), (Joint("rotation", 0, "rotation"), Joint("translation", 0, "translation")))
    joints = np.array([0.0, -0.05])
    wrench = np.array([0.0, 0.0, -part * math.pi**2 * 0.04 / (4.0 * 0.15**2), 0.0, 0.0, 0.0])
    straight = Statics(robot, 0.0025).solve(joints, wrench, at_rest(joints, math.inf, 1))

    least = lowest(robot, straight)

    assert abs(least) > ZERO_EIGENVALUE
    assert (least > 0.0) == stable
