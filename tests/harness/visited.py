"""Simulated measurements of an exact rod by a tracker with an unknown pose, with noise from a seed."""

import math
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from core.calibration.measurements import Measurement, Noise
from core.calibration.rigid_transform import RigidTransform
from core.model.cosserat import ExactRod
from core.robot.robot import Robot

NOISE = Noise(coil=0.02e-3, axes=1e-3, force=1e-3, moment=0.05e-3)
TRACKER = RigidTransform(Rotation.from_rotvec([3.0, 0.2, -0.4]).as_matrix(), np.array([0.05, -0.02, -0.2]))
COIL = np.array([0.4e-3, -0.3e-3, 1.2e-3])


def poses(seed: int, count: int) -> np.ndarray:
    """Return random joint positions (count, 3) of the paper's robot."""
    random = np.random.default_rng(seed)
    return np.column_stack((random.uniform(-2.5, 2.5, (count, 2)), random.uniform(-0.12, -0.02, count)))


def altered(robot: Robot) -> Robot:
    """Return the robot with changed tubes: bending stiffness, curvature, Poisson's ratio and the inner zero angle."""
    inner, outer = robot.tubes
    turn = math.radians(1.5)
    curved = replace(inner.sections[1], curvature=(3.86 * math.cos(turn), 3.86 * math.sin(turn)))
    inner = replace(inner, bending_stiffness=0.0390, poisson_ratio=0.34, sections=(inner.sections[0], curved))
    curved = replace(outer.sections[1], curvature=(4.1, 0.0))
    outer = replace(outer, bending_stiffness=0.0500, poisson_ratio=0.34, sections=(outer.sections[0], curved))
    return replace(robot, tubes=(inner, outer))


def seen(
    robot: Robot, joints: np.ndarray, force=(0.0, 0.0, 0.0), seed: int = 0, directions: int = 0
) -> list[Measurement]:
    """Return measurements at joints (m, n) under a force [N]; the tracker measures 1 or 3 `directions` of the coil."""
    random, back, exact = np.random.default_rng([seed, 9]), TRACKER.inverse(), ExactRod(robot)
    weight = float(np.linalg.norm(force))
    measurements = []
    for k, pose in enumerate(joints):
        rod = exact.solve(pose, np.r_[force, 0.0, 0.0, 0.0])
        coil = back.apply(rod.tip + rod.rotation @ COIL) + NOISE.coil * random.standard_normal(3)
        axes = None
        if directions:
            axes = (rod.rotation.T[-directions:] @ TRACKER.rotation) + NOISE.axes * random.standard_normal(
                (directions, 3)
            )
        measurements.append(Measurement(10.0 * k, pose, coil, np.zeros((len(robot.tubes), 6)), weight, axes=axes))
    return measurements
