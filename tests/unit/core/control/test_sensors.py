"""Base sensors against scipy's rotations and rigid transforms; corrected devices give the estimates of ideal ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.control.controller_settings import Controller
from core.control.controllers import strategy
from core.control.estimation import Actuation, Estimator
from core.control.observer import Observer, RateFilter
from core.control.sensors import Corrections, Sensors, fuse, fuse_at
from core.control.step import Sample, start_controller, step
from core.model.statics import Statics
from core.robot.limits import JointLimit, Limits

ALPHA, POSE = np.array([0.7, -1.9]), np.array([-1.9, 0.7, -0.1])
MOUNTING = [Rotation.from_rotvec([0.02, -0.03, 0.4]), Rotation.from_rotvec([-0.05, 0.01, -0.2])]
WEIGHT, MOMENT = np.array([0.2, 0.1]), np.array([[1e-3, 2e-3, 3e-3], [-2e-3, 1e-3, 4e-3]])
DOWN = np.array([0.6, 0.0, 0.8])


@pytest.fixture
def sensors() -> Sensors:
    return Sensors(np.array([m.as_matrix() for m in MOUNTING]), WEIGHT, MOMENT, DOWN)


def reading(exerted: np.ndarray) -> np.ndarray:
    """Return the readings (2, 6) of the sensors for wrenches (2, 6) that act on their tubes."""
    rows = []
    for i in range(2):
        down = Rotation.from_euler("z", ALPHA[i]).inv().apply(DOWN)
        whole = exerted[i] + np.r_[WEIGHT[i] * down, np.cross(MOMENT[i], down)]
        rows.append(np.r_[MOUNTING[i].inv().apply(whole[:3]), MOUNTING[i].inv().apply(whole[3:])])
    return np.array(rows)


def test_wrenches_of_the_tubes_are_recovered_from_sensor_readings(sensors, paper_robot):
    exerted = np.random.default_rng(0).normal(size=(2, 6))

    np.testing.assert_allclose(sensors.exerted(paper_robot, POSE, reading(exerted)), exerted, rtol=0, atol=1e-12)


def test_sensor_reading_without_a_load_is_the_hanging_weight(sensors, paper_robot):
    np.testing.assert_allclose(sensors.hanging(paper_robot, POSE), reading(np.zeros((2, 6))), rtol=0, atol=1e-12)


def test_ideal_sensors_return_the_readings_unchanged(paper_robot):
    wrenches = np.random.default_rng(1).normal(size=(2, 6))

    ideal = Sensors.ideal(paper_robot)

    np.testing.assert_array_equal(ideal.exerted(paper_robot, POSE, wrenches), wrenches)
    np.testing.assert_array_equal(ideal.hanging(paper_robot, POSE), np.zeros((2, 6)))


def test_force_sensor_under_the_robot_measures_the_sum_with_the_weights_where_they_are(paper_robot):
    one, gravity = replace(paper_robot, sensed="robot"), np.array([1.0, 0.0, 0.0])
    tip, force = np.array([0.02, -0.04, 0.19]), np.array([0.3, -0.2, 0.1])
    total = np.r_[force, np.cross(tip, force)]
    for alpha, beta, weight, moment in zip(ALPHA, (-0.1, 0.0), WEIGHT, MOMENT, strict=True):
        centre = Rotation.from_euler("z", alpha).apply(moment / weight)
        centre[2] += beta
        total += np.r_[weight * gravity, np.cross(centre, weight * gravity)]
    turn = MOUNTING[0].inv()
    sensor = Sensors(MOUNTING[0].as_matrix()[None], WEIGHT, MOMENT, gravity)

    found = sensor.exerted(one, POSE, np.r_[turn.apply(total[:3]), turn.apply(total[3:])][None])

    np.testing.assert_allclose(found, [np.r_[force, np.cross(tip, force)]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.concatenate(fuse_at(one, POSE, found)), found[0], rtol=0, atol=1e-12)


def at_sensor(world: np.ndarray, alpha: float, beta: float) -> np.ndarray:
    """Return the reading of a sensor at (0, 0, beta), rotated by alpha, for a wrench about the plate's origin."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.0, 0.0, alpha]).as_matrix()
    pose[:3, 3] = [0.0, 0.0, beta]
    to_sensor = np.linalg.inv(pose)
    turn, (x, y, z) = to_sensor[:3, :3], to_sensor[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    adjoint = np.block([[turn, np.zeros((3, 3))], [cross @ turn, turn]])
    return adjoint @ world


@pytest.mark.parametrize("tubes", [1, 2, 3])
@pytest.mark.parametrize("seed", range(2))
def test_total_load_is_recovered_from_base_sensors_and_forces_between_tubes_cancel(tubes, seed):
    random = np.random.default_rng([tubes, seed])
    alpha, beta = random.uniform(-np.pi, np.pi, tubes), random.uniform(-0.13, 0.0, tubes)
    tip, force = random.uniform(-0.2, 0.2, 3), random.uniform(-0.5, 0.5, 3)
    load = np.r_[force, np.cross(tip, force)]
    shares = random.dirichlet(np.ones(tubes))[:, None] * load
    internal = random.normal(scale=3 * [2.0] + 3 * [0.3], size=(tubes, 6))  # friction and contact, larger than the load
    internal -= internal.mean(axis=0)  # by action and reaction the internal wrenches sum to zero
    readings = np.array([at_sensor(*each) for each in zip(shares + internal, alpha, beta, strict=True)])

    fused = fuse(readings, alpha, beta)

    np.testing.assert_allclose(fused.force, force, rtol=0, atol=1e-12)
    np.testing.assert_allclose(fused.moment, load[3:], rtol=0, atol=1e-12)


JOINTS, FORCE, COIL = np.array([0.2, 1.6, -0.1]), np.array([0.3, 0.1, -0.05]), np.array([0.4e-3, -0.3e-3, 1.0e-3])
SMALL_MOUNTING = [Rotation.from_rotvec([0.02, -0.01, 0.05]), Rotation.from_rotvec([-0.03, 0.02, -0.08])]


@pytest.fixture
def controller(paper_robot) -> Controller:
    limits = Limits(tuple(JointLimit(j.name, j.unit, -7.0, 7.0, 0.3, 2.0) for j in paper_robot.joints))
    estimator = Estimator(RateFilter(0.002, 1.0), Observer(0.002, bandwidth=2.0), Actuation(0.002, 0.025, 0.012))
    return Controller(Statics(paper_robot), strategy("dual_layer", 2.5, 2.5, False), limits, estimator)


def at_bases(tip: np.ndarray) -> np.ndarray:
    """Return the wrenches (2, 6) of both tubes for FORCE at the tip; the outer tube carries all of it."""
    turn = Rotation.from_euler("z", JOINTS[0]).inv()
    return np.array([np.zeros(6), np.r_[turn.apply(FORCE), turn.apply(np.cross(tip, FORCE))]])


def test_corrected_sample_gives_the_estimates_of_ideal_devices(controller, paper_robot):
    pose = controller.statics.solve(JOINTS, np.r_[FORCE, np.zeros(3)])
    true = at_bases(pose.tip)
    misaligned = np.array([
        np.r_[m.inv().apply(row[:3]), m.inv().apply(row[3:])] for m, row in zip(SMALL_MOUNTING, true, strict=True)
    ])  # fmt: skip
    coil = pose.tip + pose.rotation @ COIL
    sensors = replace(Sensors.ideal(paper_robot), mounting=np.array([m.as_matrix() for m in SMALL_MOUNTING]))
    corrected = replace(controller, corrections=Corrections(sensors, COIL))

    ideal = Sample(JOINTS, np.zeros(3), true, pose.tip)
    real = Sample(JOINTS, np.zeros(3), misaligned, coil)
    expected = step(controller, start_controller(controller, ideal), ideal, None)
    found = step(corrected, start_controller(corrected, real), real, None)

    np.testing.assert_allclose(found.load.force, FORCE, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.memory.tip, expected.memory.tip, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.memory.estimate.loaded.tip, pose.tip, rtol=0, atol=1e-9)
    assert np.linalg.norm(step(controller, start_controller(controller, real), real, None).memory.tip - pose.tip) > 1e-3


def test_tare_does_not_remove_the_hanging_weight(controller, paper_robot):
    """A tare at one rotation is valid at another: the weight rotates in the sensor's axes, the load does not."""
    sensors = replace(Sensors.ideal(paper_robot), weight=np.array([0.1, 0.2]), first_moment=np.full((2, 3), 1e-3))
    corrected = replace(controller, corrections=Corrections(sensors))
    offset = np.random.default_rng(0).normal(size=(2, 6))
    here, there = JOINTS, JOINTS + np.array([1.0, -2.0, 0.0])

    tare = corrected.tare(offset + sensors.hanging(paper_robot, here), here)

    np.testing.assert_allclose(tare, offset, rtol=0, atol=1e-12)
    left = offset + sensors.hanging(paper_robot, there) - tare
    np.testing.assert_allclose(sensors.exerted(paper_robot, there, left), np.zeros((2, 6)), rtol=0, atol=1e-12)


AXIS = Rotation.from_euler("zy", [50.0, 3.0], degrees=True).apply([0.0, 0.0, 1.0])
TIP = Rotation.from_euler("xyz", [140.0, 35.0, -75.0], degrees=True)


def test_axis_of_a_misaligned_coil_is_rotated_to_the_tips_axis(paper_robot):
    corrections = Corrections(Sensors.ideal(paper_robot), axis=AXIS)

    direction = corrections.direction(TIP.apply(AXIS), TIP.as_matrix())

    np.testing.assert_allclose(direction, TIP.apply([0.0, 0.0, 1.0]), rtol=0, atol=1e-12)
    np.testing.assert_allclose(corrections.coil_axis(direction, TIP.as_matrix()), TIP.apply(AXIS), rtol=0, atol=1e-12)


def test_error_of_the_models_tip_frame_enters_the_direction_only_times_the_coils_misalignment(paper_robot):
    """With a frame error of six degrees and a misalignment of three, at most their product enters the direction."""
    corrections, errors = (
        Corrections(Sensors.ideal(paper_robot), axis=AXIS),
        np.random.default_rng(5).standard_normal((20, 3)),
    )
    for error in errors:
        wrong = Rotation.from_rotvec(np.radians(6.0) * error / np.linalg.norm(error)) * TIP
        direction = corrections.direction(TIP.apply(AXIS), wrong.as_matrix())
        angle = np.arccos(min(direction @ TIP.apply([0.0, 0.0, 1.0]), 1.0))
        assert angle < 1.05 * np.radians(6.0) * np.radians(3.0)


def test_measured_coil_axis_is_the_tips_direction_without_a_calibrated_axis(paper_robot):
    measured = TIP.apply(AXIS)
    assert Corrections(Sensors.ideal(paper_robot)).direction(measured, TIP.as_matrix()) is measured


def test_controller_tick_estimates_the_direction_only_on_request_and_with_corrections(controller, paper_robot):
    pose = controller.statics.solve(JOINTS, np.r_[FORCE, np.zeros(3)])
    corrected = replace(controller, corrections=Corrections(Sensors.ideal(paper_robot), axis=AXIS))
    sample = Sample(JOINTS, np.zeros(3), at_bases(pose.tip), pose.tip, direction=pose.rotation @ AXIS)

    plain = step(corrected, start_controller(corrected, sample), sample, None)
    watching = replace(corrected, watches=True)
    watched = step(watching, start_controller(watching, sample), sample, None)

    assert plain.memory.direction is None
    assert watched.memory.direction is not None
    assert watched.memory.direction.measured_once
    np.testing.assert_allclose(watched.memory.direction.measured, pose.rotation[:, 2], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(watched.command, plain.command)
    untold = step(watching, start_controller(watching, sample), sample._replace(direction=None), None)
    assert untold.memory.direction is not None
    assert not untold.memory.direction.measured_once
