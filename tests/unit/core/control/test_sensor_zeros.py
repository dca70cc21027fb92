"""Tracked zeros of the base sensors compared with a plain Kalman filter, and with a known drift over an hour."""

import math

import numpy as np
import pytest

from core.control.sensor_zeros import (
    LOAD_N,
    LOAD_S,
    MODEL_S,
    WALK_S,
    SensorZeros,
    _stiffest,  # pyright: ignore[reportPrivateUsage]
    start_zeros,
    update_zeros,
)
from core.control.sensors import fuse_at
from core.control.tip_force import SensorErrors
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Base, Robot
from station.config.robots import load_robot

#: Interval of the updates in these tests [s]; a tracker has 40 frames a second, and the filter's gains scale with time.
INTERVAL_S = 0.5
ERRORS = SensorErrors()


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("paper").robot()


@pytest.fixture(scope="module")
def circle(robot: Robot) -> list[Solution]:
    """Return the model without load at 40 poses of a motion that rotates both tubes."""
    statics, poses = Statics(robot), []
    for angle in np.linspace(0.0, 2.0 * math.pi, 40, endpoint=False):
        joints = np.array([0.4 * math.sin(angle), 0.5 * math.pi + 0.4 * math.cos(angle), -0.1 + 0.01 * math.sin(angle)])
        poses.append(statics.solve(joints, np.zeros(6)))
    return poses


def cross(v: np.ndarray) -> np.ndarray:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def sums(robot: Robot, joints: np.ndarray) -> np.ndarray:
    """Return the matrix (6, 6 q) from the sensors' readings to their sum about the plate's origin in world axes."""
    found = []
    for alpha, beta in zip(*robot.tube_poses(joints), strict=True):
        turn = np.array([[math.cos(alpha), -math.sin(alpha), 0.0], [math.sin(alpha), math.cos(alpha), 0.0], [0, 0, 1]])
        turn = robot.base.rotation @ turn
        found.append(np.block([[turn, np.zeros((3, 3))], [cross(beta * robot.base.rotation[:, 2]) @ turn, turn]]))
    return np.hstack(found)


def drifting(
    robot: Robot, circle: list[Solution], rates: np.ndarray, force: np.ndarray, duration: float, *,
    misfit: float = 0.0, moved: float = 1.0,
) -> tuple[SensorZeros, np.ndarray]:  # fmt: skip
    """Return the zeros and the total force after a drift at `rates` (q, 6) per second under a true tip force (3,).

    The model and its compliance are exact, and the force that the controller uses is the sum of the sensors' forces.
    The true load moves the tip by the fraction `moved` of a load at the tip.
    """
    zeros = start_zeros(len(rates))
    total = np.zeros(6)
    for count in range(1, round(duration / INTERVAL_S) + 1):
        pose = circle[count % len(circle)]
        lever = pose.tip - np.array(robot.base.position)
        total = np.r_[force, np.cross(lever, force)]
        total += sums(robot, pose.joints) @ (count * INTERVAL_S * rates - zeros.values).ravel()
        bias = pose.compliance[:3, :3] @ (moved * force - total[:3])
        zeros = update_zeros(zeros, ERRORS, robot, pose, total, bias, total[:3], misfit, count * INTERVAL_S)
    return zeros, total[:3]


@pytest.mark.parametrize("controlled", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_an_update_equals_a_plain_kalman_filter(
    robot: Robot, circle: list[Solution], seed: int, controlled: bool
) -> None:
    random = np.random.default_rng(seed)
    turned = Robot("turned", robot.tubes, robot.joints, Base((0.1, -0.2, 0.05), tuple(random.normal(size=3))))
    pose = Statics(turned).solve(circle[seed].joints, np.zeros(6))
    root = random.normal(size=(12, 12)) * np.tile(np.repeat([0.02, 0.4e-3], 3), 2)[:, None]
    before = SensorZeros(random.normal(size=(2, 6)), root @ root.T, 10.0, np.array([0.1, 0.0, 0.2]))
    load, bias, force = random.normal(size=6), 1e-3 * random.normal(size=3), random.normal(size=3)
    now = float(random.uniform(10.1, 2.0 * WALK_S))

    after = update_zeros(before, ERRORS, turned, pose, load, bias, force, 0.0, now, controlled=controlled)

    total, compliance = sums(turned, pose.joints), pose.compliance[:3, :3]
    r = pose.tip - np.array(turned.base.position)
    columns = np.linalg.inv(compliance)
    stiffest = columns[:, np.linalg.norm(columns, axis=0).argmax()]
    stiffest /= np.linalg.norm(stiffest)
    design = np.vstack((-compliance @ total[:3], total[3:] - cross(r) @ total[:3], stiffest @ total[:3]))
    residual = np.r_[bias + compliance @ (force - load[:3]), load[3:] - cross(r) @ load[:3], stiffest @ load[:3]]
    moment = (ERRORS.gain * ERRORS.moment_range) ** 2 + ERRORS.lever**2 * (force @ force)
    density = np.r_[3 * [MODEL_S * ERRORS.lever**2], 3 * [MODEL_S * moment], LOAD_S * LOAD_N**2]
    walk = 2.0 * min(now, WALK_S) * np.tile(np.repeat([ERRORS.force_drift, ERRORS.moment_drift], 3), 2) ** 2
    prior = before.covariance + (now - 10.0) * np.diag(walk)

    def kalman(rows: int) -> tuple[np.ndarray, np.ndarray]:
        used = design[:rows]
        spread = used @ prior @ used.T + np.diag(density[:rows]) / (now - 10.0)
        gain = prior @ used.T @ np.linalg.inv(spread)
        return gain @ residual[:rows], prior - gain @ used @ prior

    error, covariance = kalman(6 if controlled else 7)
    np.testing.assert_allclose(after.values.ravel(), before.values.ravel() + error, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(after.covariance, covariance, rtol=0, atol=1e-9)
    assert after.since == now
    forces = total[:3] @ after.covariance @ total[:3].T
    assert after.deviation == pytest.approx(math.sqrt(np.linalg.eigvalsh(forces).max()))
    # What the third residual has moved is the difference to the filter without it.
    moved = stiffest * (stiffest @ total[:3] @ (error - kalman(6)[0]))
    np.testing.assert_allclose(after.assumed - before.assumed, moved, atol=1e-9)


def test_an_hour_of_drift_hardly_changes_the_total_force(robot: Robot, circle: list[Solution]) -> None:
    signs = np.random.default_rng(3).choice([-1.0, 1.0], size=(2, 6))
    rates = signs * np.repeat([ERRORS.force_drift, ERRORS.moment_drift], 3)

    zeros, total = drifting(robot, circle, rates, np.zeros(3), 3600.0)

    assert np.linalg.norm(total) < 0.3  # the drift of the two sensors is 0.6 N in each axis without tracking
    assert np.abs(zeros.values[:, :2]).min() > 0.15  # the drift of each axis of each sensor is 0.3 N


def test_a_lasting_load_on_the_tip_does_not_become_part_of_the_zeros(robot: Robot, circle: list[Solution]) -> None:
    force = np.array([0.3, -0.2, 0.0])
    zeros, total = drifting(robot, circle, np.zeros((2, 6)), force, 600.0)
    along = _stiffest(circle[0].compliance)
    assert np.linalg.norm(np.cross(total - force, along)) < 0.02
    assert np.abs(zeros.values[:, 3:]).max() < 1e-3


def test_in_the_first_minute_after_the_tare_the_zeros_hardly_change(robot: Robot, circle: list[Solution]) -> None:
    zeros, _ = drifting(robot, circle, np.zeros((2, 6)), np.array([0.3, -0.2, 0.3]), 60.0)
    assert np.abs(zeros.values[:, :3]).max() < 1e-3


def test_a_load_on_the_shaft_changes_the_zeros_less_than_one_at_the_tip(robot: Robot, circle: list[Solution]) -> None:
    load, none = np.array([0.3, 0.0, 0.0]), np.zeros((2, 6))
    noticed, _ = drifting(robot, circle, none, load, 300.0, misfit=10.0, moved=0.5)
    unnoticed, _ = drifting(robot, circle, none, load, 300.0, moved=0.5)
    assert np.abs(unnoticed.values[:, :2]).max() > 5e-3
    assert np.abs(noticed.values[:, :2]).max() < 0.3 * np.abs(unnoticed.values[:, :2]).max()


def test_a_missing_sensor_channel_keeps_its_zero(robot: Robot, circle: list[Solution]) -> None:
    errors = SensorErrors(force_noise=(0.02, math.inf), moment_noise=math.inf)
    pose = circle[0]
    force = fuse_at(robot, pose.joints, np.ones((2, 6))).force
    zeros = update_zeros(
        start_zeros(2), errors, robot, pose, np.r_[force, 0.1, 0.1, 0.1], np.array([2e-3, 1e-3, 0.0]), force, 0.0, 900.0
    )
    assert np.abs(zeros.values[0, :3]).min() > 0.0
    np.testing.assert_array_equal(zeros.values[1], 0.0)
    np.testing.assert_array_equal(zeros.values[0, 3:], 0.0)


def test_the_stiffest_direction_is_the_last_singular_vector_of_the_compliance(circle: list[Solution]) -> None:
    for pose in circle:
        expected = np.linalg.svd(pose.compliance[:3, :3])[2][2]
        assert abs(_stiffest(pose.compliance) @ expected) > 0.999
