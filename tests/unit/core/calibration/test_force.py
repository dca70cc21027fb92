"""The sensor calibration recovers the parameters of simulated sensors (independent implementation)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.calibration.fit import UnobservableCombination
from core.calibration.force import calibrate_sensors, check_weight
from core.calibration.measurements import Measurement, Noise
from core.model.statics import Statics

DOWN = np.array([1.0, 0.0, 0.0])
NOISE = Noise(force=1.5e-3, moment=0.05e-3)
MOUNTING = [Rotation.from_rotvec([0.01, -0.02, 0.03]), Rotation.from_rotvec([-0.02, 0.01, -0.015])]
WEIGHT, PLACE = [0.10, 0.05], [np.array([1e-3, 2e-3, 15e-3]), np.array([-2e-3, 1e-3, 20e-3])]


def readings(joints, load, internal, time, offset, drift, random):
    """Return readings of two sensors: shares of a load about the plate's origin (6,) and wrenches between the tubes."""
    rows = []
    for i, (share, alpha, beta) in enumerate(
        zip((0.3 * load + internal, 0.7 * load - internal), joints[1::-1], (joints[2], 0.0), strict=True)
    ):
        turn = Rotation.from_euler("z", alpha)
        force, moment = share[:3], share[3:] - np.cross([0.0, 0.0, beta], share[:3])
        hanging = WEIGHT[i] * turn.inv().apply(DOWN)
        own_force, own_moment = (
            turn.inv().apply(force) + hanging,
            turn.inv().apply(moment) + np.cross(PLACE[i], hanging),
        )
        said = np.r_[MOUNTING[i].inv().apply(own_force), MOUNTING[i].inv().apply(own_moment)]
        noise = np.repeat([1e-3, 0.02e-3], 3) * random.standard_normal(6)
        rows.append(said + noise + offset[i] + time * drift[i])
    return np.array(rows)


@pytest.fixture(scope="module")
def bench(paper_robot):
    """Return measurements, tips and the simulated errors; blocks without and with weight alternate."""
    random, model = np.random.default_rng(1), Statics(paper_robot)
    offset = random.uniform(-1.0, 1.0, (2, 6)) * np.repeat([1.0, 0.01], 3)
    drift = random.choice([-1.0, 1.0], (2, 6)) * np.repeat([5e-3 / 60.0, 0.0], 3)
    measurements, tips = [], []
    for k in range(60):
        joints = np.r_[random.uniform(-3.0, 3.0, 2), random.uniform(-0.12, -0.01)]
        weight = (0.0, 0.5, 0.25, 0.0)[k // 15]
        force = weight * DOWN
        tip = model.solve(joints, np.r_[force, np.zeros(3)]).tip
        internal = random.normal(size=6) * np.repeat([0.3, 0.02], 3)
        said = readings(joints, np.r_[force, np.cross(tip, force)], internal, 10.0 * k, offset, drift, random)
        measurements.append(Measurement(10.0 * k, joints, np.zeros(3), said, weight))
        tips.append(tip)
    return measurements, np.array(tips), drift


@pytest.fixture(scope="module")
def found(paper_robot, bench):
    return calibrate_sensors(paper_robot, bench[0], bench[1], NOISE, 0.05e-3)


def test_mounting_angles_and_weights_of_sensors_are_found(found):
    for i in range(2):
        away = Rotation.from_matrix(found.sensors.mounting[i]) * MOUNTING[i].inv()
        assert np.degrees(away.magnitude()) < 0.15
        assert found.sensors.weight[i] == pytest.approx(WEIGHT[i], abs=2e-3)
    assert 0.5 < found.fit.variance_factor < 1.5


def test_calibrated_sensors_measure_loads_below_the_forces_between_tubes(paper_robot, bench, found):
    errors = np.array(
        [found.load(paper_robot, measurement).force - measurement.weight * DOWN for measurement in bench[0]]
    )

    assert np.sqrt(np.mean(errors**2, axis=0)).max() < 2.5e-3


def test_observable_sensor_drift_is_found(bench, found):
    drift = bench[2]

    np.testing.assert_allclose(found.drift[:, :2], drift[:, :2], rtol=0, atol=0.5e-3 / 60.0)
    # Along the axis only the sum of both sensors' drifts affects the load, so only this sum is determined.
    assert found.drift[:, 2].sum() == pytest.approx(drift[:, 2].sum(), abs=0.5e-3 / 60.0)
    assert any({"inner force drift z", "outer force drift z"} <= dict(weak.parts).keys() for weak in found.fit.weak)


def test_unknown_loads_improve_the_sensor_calibration(paper_robot, bench):
    measurements = [v._replace(weight=None) if v.weight else v for v in bench[0]]

    found = calibrate_sensors(paper_robot, measurements, bench[1], NOISE, 0.05e-3)

    errors = [found.load(paper_robot, v).force - u.weight * DOWN for v, u in zip(measurements, bench[0], strict=True)]
    assert np.sqrt(np.mean(np.array(errors) ** 2)) < 6e-3


def test_the_error_of_a_known_weight_is_measured(paper_robot, bench, found):
    loads = np.array([found.load(paper_robot, v).force for v in bench[0] if v.weight == 0.5])

    check = check_weight(loads, 0.5, DOWN)

    assert abs(check.error) < 1.5e-3
    assert np.degrees(check.angle) < 0.3


def test_a_sensor_calibration_without_rotation_is_refused_and_the_joint_is_named(paper_robot, bench):
    measurements = [v._replace(joints=v.joints * [1.0, 0.1, 1.0]) for v in bench[0]]

    with pytest.raises(
        UnobservableCombination, match=r"tube 'inner' .* turn inner_rotation by more than 60 deg without load"
    ):
        calibrate_sensors(paper_robot, measurements, bench[1], NOISE, 0.05e-3)


def test_a_sensor_calibration_with_too_few_unloaded_poses_is_refused(paper_robot, bench):
    with pytest.raises(UnobservableCombination, match="5 measurements without load"):
        calibrate_sensors(paper_robot, bench[0][:5], bench[1][:5], NOISE, 0.05e-3)


def test_force_sensor_under_the_robot_is_calibrated_with_the_weights_of_the_tubes(paper_robot):
    random, measurements, tips = np.random.default_rng(3), [], []
    one, model = replace(paper_robot, sensed="robot"), Statics(paper_robot)
    offset, mounting = random.uniform(-1.0, 1.0, 6) * np.repeat([1.0, 0.01], 3), MOUNTING[0].inv()
    for k in range(60):
        joints = np.r_[random.uniform(-3.0, 3.0, 2), random.uniform(-0.12, -0.01)]
        force = (0.0, 0.5, 0.25, 0.0)[k // 15] * DOWN
        tip = model.solve(joints, np.r_[force, np.zeros(3)]).tip
        total, moment = force.copy(), np.cross(tip, force)
        for i, (alpha, beta) in enumerate(zip(joints[1::-1], (joints[2], 0.0), strict=True)):
            centre = Rotation.from_euler("z", alpha).apply(PLACE[i]) + np.array([0.0, 0.0, beta])
            total, moment = total + WEIGHT[i] * DOWN, moment + np.cross(centre, WEIGHT[i] * DOWN)
        noise = np.repeat([1e-3, 0.02e-3], 3) * random.standard_normal(6)
        said = np.r_[mounting.apply(total), mounting.apply(moment)] + offset + noise
        measurements.append(Measurement(10.0 * k, joints, np.zeros(3), said[None], float(force[0])))
        tips.append(tip)

    found = calibrate_sensors(one, measurements, np.array(tips), NOISE, 0.05e-3)

    assert found.sensors.mounting.shape == (1, 3, 3)
    away = Rotation.from_matrix(found.sensors.mounting[0]) * MOUNTING[0].inv()
    assert np.degrees(away.magnitude()) < 0.3
    assert found.sensors.weight[0] == pytest.approx(WEIGHT[0], abs=2e-3)  # the tube that slides
    errors = np.array([found.load(one, v).force - v.weight * DOWN for v in measurements])
    assert np.sqrt(np.mean(errors**2, axis=0)).max() < 2.5e-3
