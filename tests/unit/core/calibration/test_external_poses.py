"""Fits to externally measured poses recover the frames, tubes and lags of the exact rod."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.calibration.external_poses import (
    ErrorStatistics,
    FitParameters,
    alternative_readings,
    arrival_directions,
    fit_parameters,
    fit_poses,
    neighbour_correlation,
)
from core.calibration.fit import UnobservableCombination
from core.calibration.measurements import Measurement
from core.calibration.rigid_transform import RigidTransform
from core.model.cosserat import ExactRod
from tests.harness.visited import altered, poses

BASE = RigidTransform(Rotation.from_rotvec([1.0, -2.0, 0.5]).as_matrix(), np.array([0.3, 0.2, -0.1]))
OFFSET = np.array([2e-3, -1e-3, 15e-3])
NOISE = 0.1e-3


def measured(robot, joints, forces=None, *, noise=NOISE, seed=0, came=None, play=0.0):
    """Return measurements of the exact rod; a tracker at BASE measures a marker at OFFSET from the tip."""
    random, exact = np.random.default_rng([seed, 3]), ExactRod(robot)
    forces = np.zeros((len(joints), 3)) if forces is None else forces
    came = [None] * len(joints) if came is None else came
    measurements = []
    for pose, force, way in zip(joints, forces, came, strict=True):
        there = pose if way is None else pose - 0.5 * play * way
        rod = exact.solve(there, np.r_[force, 0.0, 0.0, 0.0])
        point = BASE.inverse().apply(rod.tip + rod.rotation @ OFFSET) + noise * random.standard_normal(3)
        measurements.append(
            Measurement(0.0, pose, point, np.zeros((len(robot.tubes), 6)), None if force.any() else 0.0, way)
        )
    return measurements, forces


def turned(first: np.ndarray, second: np.ndarray) -> float:
    """Return the angle between two rotations [rad]."""
    return float(np.linalg.norm(Rotation.from_matrix(first @ second.T).as_rotvec()))


def test_the_trackers_base_and_the_marker_offset_are_recovered_with_the_robot_files_tubes(paper_robot):
    measurements, forces = measured(paper_robot, poses(1, 40))
    found = fit_poses(paper_robot, measurements, forces, "frames", FitParameters())

    assert turned(found.frames.registration.rotation, BASE.rotation) < 1.5e-3
    np.testing.assert_allclose(found.frames.registration.position, BASE.position, rtol=0, atol=0.3e-3)
    np.testing.assert_allclose(found.frames.coil, OFFSET, rtol=0, atol=0.3e-3)
    assert found.noise == pytest.approx(NOISE, rel=0.15)
    # A vector of three normal components has a mean length of sqrt(8 / pi) deviations; 9 of 120 values are fitted.
    assert ErrorStatistics.of(found.errors(measurements, forces)).mean == pytest.approx(
        math.sqrt(8.0 / math.pi) * NOISE, rel=0.12
    )  # fmt: skip


def test_the_standard_deviation_of_the_trackers_base_is_its_scatter_over_repetitions(paper_robot):
    """The same poses are measured repeatedly, with the tracker's origin half a metre away."""
    found = [
        fit_poses(paper_robot, *measured(paper_robot, poses(1, 20), seed=seed), "frames", FitParameters())
        for seed in range(30)
    ]
    positions = np.array([each.frames.registration.position for each in found])
    stated = np.mean([each.position_errors for each in found], axis=0)
    # The standard deviation of 30 values has an error of 13 %; the tolerance is three times that.
    np.testing.assert_allclose(positions.std(axis=0, ddof=1), stated, rtol=0.4)
    np.testing.assert_allclose(positions.mean(axis=0), BASE.position, rtol=0, atol=4.0 * stated.max() / math.sqrt(30.0))


def test_tips_in_the_robot_s_frame_need_no_fit(paper_robot):
    measurements, forces = measured(paper_robot, poses(1, 3), noise=0.0)
    at_tip = [v._replace(coil=ExactRod(paper_robot).solve(v.joints, np.zeros(6)).tip) for v in measurements]
    found = fit_poses(paper_robot, at_tip, forces, "none", FitParameters())

    assert found.fit is None
    assert np.abs(found.errors(at_tip, forces)).max() < 2e-6  # the error of the model's fourth-order scheme


@pytest.fixture(scope="module")
def loaded(paper_robot):
    """Return poses of altered tubes under known loads, and their fit."""
    forces = 0.25 * np.random.default_rng(7).standard_normal((60, 3))
    measurements, forces = measured(altered(paper_robot), poses(2, 60), forces)
    asked = fit_parameters(paper_robot, measurements, forces, hysteresis=False)
    return measurements, forces, fit_poses(paper_robot, measurements, forces, "tubes", asked)


def test_tube_parameters_are_recovered_from_loaded_poses(paper_robot, loaded):
    _, _, found = loaded
    for new, true in zip(found.robot.tubes, altered(paper_robot).tubes, strict=True):
        assert new.bending_stiffness == pytest.approx(true.bending_stiffness, rel=0.02)
        assert math.hypot(*new.sections[1].curvature) == pytest.approx(
            math.hypot(*true.sections[1].curvature), rel=0.015
        )
        angles = [math.atan2(*tube.sections[1].curvature[::-1]) for tube in (new, true)]
        assert angles[0] == pytest.approx(angles[1], abs=math.radians(0.4))
    expected = {
        "inner bending_stiffness": 0.0390 / 0.0413 - 1.0,
        "inner curvature": 3.86 / 4.0 - 1.0,
        "inner torsional_stiffness": (0.0390 / 1.34) / (0.0413 / 1.30) - 1.0,  # GJ = EI / (1 + nu)
        "inner zero_angle": math.radians(1.5),
        "outer bending_stiffness": 0.0500 / 0.0480 - 1.0,
        "outer curvature": 4.1 / 4.0 - 1.0,
        "outer torsional_stiffness": (0.0500 / 1.34) / (0.0480 / 1.30) - 1.0,
    }
    for name, value in expected.items():
        assert abs(found.fit.value(name) - value) < 3.0 / 1.96 * found.fit.interval(name), name


def test_held_out_poses_are_predicted_within_the_noise(paper_robot, loaded):
    measurements, forces, found = loaded
    others, none = measured(altered(paper_robot), poses(3, 20), noise=0.0)
    described = fit_poses(paper_robot, measurements, forces, "frames", FitParameters())

    assert ErrorStatistics.of(found.errors(others, none)).mean < 0.1e-3
    assert ErrorStatistics.of(described.errors(others, none)).mean > 0.7e-3


def test_the_outermost_tubes_stiffness_is_not_fitted_to_unloaded_poses(paper_robot):
    measurements, forces = measured(altered(paper_robot), poses(4, 50))
    asked = fit_parameters(paper_robot, measurements, forces, hysteresis=False)
    found = fit_poses(paper_robot, measurements, forces, "tubes", asked)

    assert any("outer bending stiffness" in reason and "0 poses" in reason for reason in asked.omitted)
    inner, outer = found.robot.tubes
    assert outer.bending_stiffness == 0.048
    assert inner.bending_stiffness / outer.bending_stiffness == pytest.approx(0.0390 / 0.0500, rel=0.03)


def test_the_pose_fit_finds_a_lag_behind_the_joints_last_motion(paper_robot):
    joints = poses(5, 60)
    came = np.sign(np.random.default_rng(5).standard_normal(joints.shape))
    play = np.array([0.06, 0.09, 1.2e-3])
    measurements, forces = measured(paper_robot, joints, came=list(came), play=play)
    without = fit_parameters(paper_robot, measurements, forces, hysteresis=False)
    asked = fit_parameters(paper_robot, measurements, forces, hysteresis=True)
    found = fit_poses(paper_robot, measurements, forces, "frames", asked)

    assert without.lags == ()
    assert (np.abs(found.plays - play) < [3e-3, 3e-3, 0.15e-3]).all()
    assert found.noise == pytest.approx(NOISE, rel=0.15)
    assert fit_poses(paper_robot, measurements, forces, "frames", without).noise > 5.0 * NOISE


def test_a_changed_curvature_of_three_tubes_with_six_joints_is_found(three_tubes):
    random = np.random.default_rng(11)
    turns = random.uniform(-1.0, 1.0, (50, 3))
    slides = random.uniform([-0.19, -0.09, -0.025], [-0.15, -0.06, -0.005], (50, 3))
    joints = np.stack((turns, slides), axis=2).reshape(50, 6)
    joints = joints[[three_tubes.is_valid_pose(pose) for pose in joints]]
    middle = three_tubes.tubes[1]
    bent = replace(middle.sections[1], curvature=(3.3, 2.2))
    true = replace(
        three_tubes,
        tubes=(three_tubes.tubes[0], replace(middle, sections=(middle.sections[0], bent)), three_tubes.tubes[2]),
    )
    measurements, forces = measured(true, joints, noise=0.02e-3)
    asked = fit_parameters(three_tubes, measurements, forces, hysteresis=False)
    found = fit_poses(three_tubes, measurements, forces, "tubes", asked)

    assert math.hypot(*found.robot.tubes[1].sections[1].curvature) == pytest.approx(math.hypot(3.3, 2.2), rel=0.01)
    assert found.noise == pytest.approx(0.02e-3, rel=0.2)


def test_outlier_poses_are_not_fitted_but_included_in_the_errors(paper_robot):
    measurements, forces = measured(paper_robot, poses(6, 40))
    measurements[7] = measurements[7]._replace(coil=measurements[7].coil + np.array([0.02, 0.0, 0.0]))
    found = fit_poses(paper_robot, measurements, forces, "frames", FitParameters())

    assert [k for k, seen in enumerate(found.fitted) if not seen] == [7]
    assert found.noise == pytest.approx(NOISE, rel=0.2)
    assert ErrorStatistics.of(found.errors(measurements, forces)).largest == pytest.approx(0.02, rel=0.02)


def test_length_and_lag_of_a_flush_tube_are_not_fitted(paper_robot):
    joints = poses(8, 12)
    joints[3, 2] = -0.138
    way = np.tile([1.0, -1.0], 18).reshape(12, 3)
    measurements = [
        Measurement(0.0, pose, np.zeros(3), np.zeros((2, 6)), 0.0, w) for pose, w in zip(joints, way, strict=True)
    ]
    asked = fit_parameters(paper_robot, measurements, np.zeros((12, 3)), hysteresis=True)

    assert "straight_length" not in {quantity.kind for quantity in asked.quantities}
    assert [lag.joint for lag in asked.lags] == [0, 1]
    assert any(reason.startswith("lag of inner_translation") for reason in asked.omitted)
    free = fit_parameters(paper_robot, measurements[:3], np.zeros((3, 3)), hysteresis=True)
    assert "straight_length" in {quantity.kind for quantity in free.quantities}


def test_a_pose_fit_with_too_few_poses_is_refused_with_the_required_number(paper_robot):
    measurements, forces = measured(paper_robot, poses(1, 3))
    with pytest.raises(
        UnobservableCombination, match=r"usable poses: 3, for 9 unknowns \(frames\); at least 4 are needed"
    ):
        fit_poses(paper_robot, measurements, forces, "frames", FitParameters())


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        ([1.0, -1.0, 1.0], "inner_rotation reversed"),
        ([180.0 / math.pi, 180.0 / math.pi, 1.0], "all rotations read as degrees"),
    ],
)
def test_reversed_joints_and_wrong_angle_units_are_detected(paper_robot, factor, words):
    measurements, forces = measured(paper_robot, poses(9, 30))
    assert alternative_readings(paper_robot, measurements, forces) == ()
    wrong = [measurement._replace(joints=measurement.joints * factor) for measurement in measurements]
    what, other, given = alternative_readings(paper_robot, wrong, forces)[0]
    assert what == words
    assert other < 0.3e-3
    assert given > 5e-3


def test_arrival_directions_of_joints_follow_reversals_and_ignore_jitter():
    column = np.array([0.0, 0.001, 0.5, 1.0, 0.9995, 1.5, 1.2, 0.4, 0.4005, -0.5, -0.4])
    stated = [0, 0, 1, 1, 1, 1, -1, -1, -1, -1, 1]
    still = np.full_like(column, 0.3)
    assert arrival_directions(np.column_stack((column, still))).T.tolist() == [stated, [0] * len(stated)]


def test_errors_of_neighbouring_poses_are_correlated_in_a_smooth_field_and_not_in_noise():
    random = np.random.default_rng(0)
    joints = random.uniform(-1.0, 1.0, (300, 2))
    smooth = np.column_stack((np.sin(3.0 * joints[:, 0]), joints[:, 1], joints.prod(axis=1)))
    assert neighbour_correlation(joints, random.standard_normal((300, 3))) < 0.15
    assert neighbour_correlation(joints, smooth) > 0.8


def test_error_statistics_ignore_rows_of_nan():
    errors = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0], [math.nan] * 3, [0.0, 0.0, 3.0]])
    spread = ErrorStatistics.of(errors)
    assert spread == ErrorStatistics(3, 3.0, 3.0, pytest.approx(4.8), 5.0)
