"""Force at the tip compared with generalised least squares with full covariances."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.control.observer import RateFilter, gains
from core.control.sensors import fuse_at
from core.control.tip_force import (
    COVARIANCE,
    FITS,
    FORCE,
    MISFIT,
    QUALITY,
    VARIANCE,
    LoadEstimator,
    SensorErrors,
    estimate_force,
)
from core.errors import DescriptionError
from core.model.statics import Statics
from core.robot.robot import Base, Joint, Robot, Section, Tube
from station.config.robots import load_robot
from tests.harness.boundary_value import boundary_value

#: Start pose of the experiment `fig8`, and the tip in this pose.
JOINTS = np.array([0.0, 0.5 * math.pi, -0.1])
TIP = np.array([0.0246, -0.0415, 0.1939])
#: Bandwidth at which the filter passes all noise, so the covariance is that of single samples.
WIDE = 1e6
#: Sensor errors that consist of noise alone: no drift, no gain error, and an exact lever.
NOISE = SensorErrors(force_drift=0.0, moment_drift=0.0, gain=1e-9, lever=0.0)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("paper").robot()


def cross(v: np.ndarray) -> np.ndarray:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def placed(robot: Robot, joints: np.ndarray) -> list[np.ndarray]:
    """Return a (6, 6) matrix per sensor that maps a reading to the wrench about the world's origin in world axes."""
    found = []
    for alpha, beta in zip(*robot.tube_poses(joints), strict=True):
        turn = np.array([[math.cos(alpha), -math.sin(alpha), 0.0], [math.sin(alpha), math.cos(alpha), 0.0], [0, 0, 1]])
        turn = robot.base.rotation @ turn
        at = np.array(robot.base.position) + robot.base.rotation @ np.array([0.0, 0.0, beta])
        found.append(np.block([[turn, np.zeros((3, 3))], [cross(at) @ turn, turn]]))
    return found


def readings(robot: Robot, force: np.ndarray, at: np.ndarray, internal: np.ndarray) -> np.ndarray:
    """Return the sensors' readings (q, 6) for a force at the point `at` and a wrench (6,) between the two tubes."""
    load = np.r_[force, np.cross(at, force)]
    return np.array(
        [np.linalg.solve(m, w) for m, w in zip(placed(robot, JOINTS), (internal, load - internal), strict=True)]
    )


def estimated(
    robot: Robot, errors: SensorErrors, wrenches: np.ndarray, tip: np.ndarray = TIP, ticks: int = 1
) -> np.ndarray:
    estimator = LoadEstimator(moments=True, errors=errors)
    last = estimator.start(np.zeros(3), WIDE)
    for _ in range(ticks):
        now = np.empty((5, 3))
        estimate_force(estimator.settings, 0.002, robot.layout, JOINTS, wrenches, tip, last, now)
        last = now
    return now


def covariance(rows: np.ndarray) -> np.ndarray:
    (xx, yy, zz), (xy, xz, yz) = rows[VARIANCE], rows[COVARIANCE]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@pytest.mark.parametrize("seed", range(4))
def test_tip_force_and_covariance_equal_direct_generalised_least_squares(robot: Robot, seed: int) -> None:
    random = np.random.default_rng(seed)
    turned = Robot("turned", robot.tubes, robot.joints, Base((0.1, -0.2, 0.05), tuple(random.normal(size=3))))
    noise = random.uniform(0.5, 2.0, (2, 2)) * (0.02, 0.2e-3)
    errors = SensorErrors(
        tuple(noise[:, 0]), tuple(noise[:, 1]), random.uniform(0.0, 0.1), random.uniform(0.0, 1e-3),
        random.uniform(0.0, 0.01), lever=0.0,
    )  # fmt: skip
    tip = np.array(turned.base.position) + turned.base.rotation @ (TIP + random.normal(scale=0.01, size=3))
    force, internal = random.normal(scale=0.2, size=3), random.normal(scale=3 * [2.0] + 3 * [0.05])
    wrenches = readings(turned, force, tip, internal) + random.normal(size=(2, 6)) * np.repeat(noise, 3, axis=1)

    rows = estimated(turned, errors, wrenches, tip)

    total, spread = np.zeros(6), np.zeros((6, 6))
    for place, reading, (force_noise, moment_noise) in zip(placed(turned, JOINTS), wrenches, noise, strict=True):
        carried = (reading[:3] @ reading[:3]) / 18.0**2 + (reading[3:] @ reading[3:]) / 0.25**2
        of_force = force_noise**2 + (0.002 * errors.force_drift) ** 2 + (18.0 * errors.gain) ** 2 * carried
        of_moment = moment_noise**2 + (0.002 * errors.moment_drift) ** 2 + (0.25 * errors.gain) ** 2 * carried
        total += place @ reading
        spread += place @ np.diag(3 * [of_force] + 3 * [of_moment]) @ place.T
    design = np.vstack((np.eye(3), cross(tip)))
    weight = np.linalg.inv(spread)
    expected = np.linalg.inv(design.T @ weight @ design)
    np.testing.assert_allclose(rows[FORCE], expected @ design.T @ weight @ total, rtol=0, atol=1e-9)
    np.testing.assert_allclose(covariance(rows), expected, rtol=1e-7, atol=1e-16)


def test_moments_reduce_the_noise_across_the_lever_from_28_mn_to_below_6(robot: Robot) -> None:
    random, force = np.random.default_rng(1), np.array([0.3, -0.2, 0.1])
    true = readings(robot, force, TIP, np.zeros(6))
    samples = true + random.normal(size=(1000, 2, 6)) * (3 * [0.02] + 3 * [0.2e-3])

    found = np.array([estimated(robot, NOISE, sample)[FORCE] for sample in samples])
    sums = np.array([fuse_at(robot, JOINTS, sample).force for sample in samples])

    np.testing.assert_allclose(found.mean(axis=0), force, rtol=0, atol=3e-3)
    np.testing.assert_allclose(sums.std(axis=0), 0.0283, rtol=0.08)
    principal = np.sqrt(np.linalg.eigvalsh(np.cov(found.T)))
    np.testing.assert_allclose(principal, [0.0041, 0.0057, 0.0283], rtol=0.08)  # the last direction is along the lever
    predicted = covariance(estimated(robot, NOISE, true))
    np.testing.assert_allclose(np.cov(found.T), predicted, rtol=0, atol=0.15 * predicted.max())


def test_wrenches_between_the_tubes_cancel_in_the_tip_force(robot: Robot) -> None:
    force, internal = np.array([0.3, 0.0, -0.1]), np.array([0.5, -0.3, 8.0, 0.03, 0.05, 7.6e-3])

    np.testing.assert_allclose(
        estimated(robot, SensorErrors(), readings(robot, force, TIP, internal))[FORCE], force, rtol=0, atol=1e-12
    )


def test_load_on_the_shaft_gives_the_sum_of_forces_and_the_transition_is_continuous(robot: Robot) -> None:
    force = np.array([0.3, 0.1, 0.0])
    parts = np.linspace(1.0, 0.3, 30)
    narrow = LoadEstimator(moments=True)
    found, misfits = [], []
    for part in parts:
        last = narrow.start(np.zeros(3), 1.0)
        for _ in range(200):  # 0.4 s, because the mismatch is averaged
            now = np.empty((5, 3))
            wrenches = readings(robot, force, part * TIP, np.zeros(6))
            estimate_force(narrow.settings, 0.002, robot.layout, JOINTS, wrenches, TIP, last, now)
            last = now
        found.append(now[FORCE].copy())
        misfits.append(now[QUALITY, MISFIT])

    np.testing.assert_allclose(found[0], force, rtol=0, atol=1e-9)
    assert misfits[0] < 1e-6
    assert misfits[-1] > 10.0 * FITS
    # far from the tip the estimate is the sum of the sensors' forces
    np.testing.assert_allclose(found[-1], force, rtol=0, atol=0.01)
    assert np.abs(np.diff(found, axis=0)).max() < 0.12  # the estimate does not jump between both methods


@pytest.mark.parametrize(
    ("noise", "missing"), [((math.inf, math.inf), [0, 1]), (math.inf, [0, 1]), ((math.inf, 0.2e-3), [0])]
)
def test_force_estimate_without_moments_is_the_sum_of_the_sensor_forces(robot: Robot, noise, missing) -> None:
    force = np.array([0.3, 0.1, -0.2])
    wrenches = readings(robot, force, (0.5 if len(missing) == 2 else 1.0) * TIP, np.zeros(6))
    wrenches[missing, 3:] = math.nan  # a reading of a missing channel is not used

    rows = estimated(robot, SensorErrors(moment_noise=noise), wrenches)

    assert np.isfinite(rows).all() or len(missing) == 2
    np.testing.assert_allclose(rows[FORCE], fuse_at(robot, JOINTS, wrenches).force, rtol=0, atol=1e-6)


def test_sensor_reading_of_nan_makes_the_force_estimate_nan(robot: Robot) -> None:
    wrenches = np.zeros((2, 6))
    wrenches[1, 4] = math.nan

    assert np.isnan(estimated(robot, SensorErrors(), wrenches)[FORCE]).any()


def test_sensor_noise_of_zero_is_refused() -> None:
    with pytest.raises(DescriptionError, match="must be above 0"):
        LoadEstimator(errors=SensorErrors(force_noise=0.0)).settings  # noqa: B018


def test_the_force_uncertainty_grows_with_the_sensor_drift_since_the_tare(robot: Robot) -> None:
    quiet = np.zeros((2, 6))
    early, late = (covariance(estimated(robot, SensorErrors(), quiet, ticks=n)) for n in (1, 500))

    assert (np.linalg.eigvalsh(late - early) > 0.0).all()


@pytest.mark.parametrize("bandwidth", [0.4, 0.7, 3.0, 10.0])
def test_closed_form_filter_gains_match_the_steady_kalman_filter(bandwidth: float) -> None:
    np.testing.assert_allclose(gains(0.002, bandwidth), RateFilter(0.002, bandwidth).gain, rtol=1e-4)


def test_force_sensor_under_a_straight_tube_gives_the_force_with_the_uncertainty_of_its_lever() -> None:
    tube = Tube("only", (Section(0.25),), 0.05, translation=-0.05)
    straight = Robot("straight", (tube,), (Joint("turn", 0, "rotation"),), sensed="robot")
    found, joints, tip = np.empty((5, 3)), np.array([1.3]), np.array([0.0, 0.0, 0.2])
    # 0.3 N along x at 0.2 m: 60 N mm about y, in the plate's axes although the tube is turned.
    reading = np.array([[0.3, -0.1, 0.05, 0.02, 0.06, 0.0]])
    estimator = LoadEstimator(moments=True, errors=NOISE)

    last = estimator.start(np.zeros(3), WIDE)
    estimate_force(estimator.settings, 0.002, straight.layout, joints, reading, tip, last, found)

    np.testing.assert_allclose(found[FORCE], [0.3, -0.1, 0.05], rtol=0, atol=1e-9)
    # Across the lever 1 / variance = 1 / (20 mN)^2 + (0.2 m / 0.2 N mm)^2; along it the force alone counts.
    np.testing.assert_allclose(found[VARIANCE], [1 / 1002500.0, 1 / 1002500.0, 4e-4], rtol=1e-6)


@pytest.mark.parametrize("force", [(0.3, 0.0, 0.0), (-0.1, 0.25, 0.2)])
def test_force_sensor_under_two_tubes_gives_the_force_of_an_independent_solution(robot: Robot, force) -> None:
    one = replace(robot, sensed="robot")
    exact = boundary_value(robot, JOINTS, np.array([*force, 0.0, 0.0, 0.0]))
    moment, found = exact.unknowns[2:], np.empty((5, 3))
    estimator = LoadEstimator(moments=True, errors=NOISE)
    tip = Statics(robot).solve(JOINTS, np.array([*force, 0.0, 0.0, 0.0])).tip

    last = estimator.start(np.zeros(3), WIDE)
    reading = np.array([[*force, *moment]])
    estimate_force(estimator.settings, 0.002, one.layout, JOINTS, reading, tip, last, found)

    np.testing.assert_allclose(found[FORCE], force, rtol=0, atol=1e-3)
    assert found[QUALITY, MISFIT] < 1.0  # the moment is that of a force at the tip
