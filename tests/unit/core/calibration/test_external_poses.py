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
    check_tip_moves,
    fit_parameters,
    fit_poses,
    follows_model,
    neighbour_correlation,
)
from core.calibration.fit import UnobservableCombination
from core.calibration.measurements import Measurement
from core.calibration.quantities import quantities
from core.calibration.rigid_transform import RigidTransform
from core.model.cosserat import ExactRod
from core.robot.robot import Joint, Robot, Section, Tube
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


def test_tips_in_the_robot_s_frame_need_no_fit(paper_robot):
    measurements, forces = measured(paper_robot, poses(1, 3), noise=0.0)
    at_tip = [v._replace(coil=ExactRod(paper_robot).solve(v.joints, np.zeros(6)).tip) for v in measurements]
    found = fit_poses(paper_robot, at_tip, forces, "none", FitParameters())

    assert found.fit is None
    assert np.abs(found.errors(at_tip, forces)).max() < 2e-6  # the error of the model's fourth-order scheme


@pytest.fixture(scope="module")
def loaded(paper_robot):
    """Return poses of altered tubes under known loads, and their fit."""
    forces = 0.25 * np.random.default_rng(7).standard_normal((40, 3))
    measurements, forces = measured(altered(paper_robot), poses(2, 40), forces)
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
    measurements, forces = measured(altered(paper_robot), poses(4, 30))
    asked = fit_parameters(paper_robot, measurements, forces, hysteresis=False)
    found = fit_poses(paper_robot, measurements, forces, "tubes", asked)

    assert any("outer bending stiffness" in reason and "0 poses" in reason for reason in asked.omitted)
    inner, outer = found.robot.tubes
    assert outer.bending_stiffness == 0.048
    assert inner.bending_stiffness / outer.bending_stiffness == pytest.approx(0.0390 / 0.0500, rel=0.03)


def test_the_pose_fit_finds_a_lag_behind_the_joints_last_motion(paper_robot):
    joints = poses(5, 30)
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


def flush_robot(inner_slides: bool, sliding: tuple[int, ...], flush: tuple[int, int]) -> Robot:
    """Return a robot of three tubes; tube `flush[0]` ends where tube `flush[1]` ends if both start at their rest."""
    lengths = {(1, 2): ((0.2, 0.1), (0.05, 0.1), (0.03, 0.08)), (0, 1): ((0.1, 0.1), (0.06, 0.1), (0.03, 0.05))}[flush]
    starts = {(1, 2): (-0.1, -0.04, 0.0), (0, 1): (-0.06, -0.02, 0.0)}[flush]
    curves, stiffness, bores = (6.0, 3.0, 3.0), (0.02, 0.04, 0.09), ((1.0, 0.5), (1.8, 1.2), (2.6, 2.0))
    tubes = tuple(
        Tube(f"t{i}", (Section(a), Section(b, (u, 0.0))), ei, 0.3, 1e-3 * out, 1e-3 * bore, translation=start)
        for i, ((a, b), u, ei, (out, bore), start) in enumerate(
            zip(lengths, curves, stiffness, bores, starts, strict=True)
        )
    )
    joints = [Joint(f"turn {i}", i, "rotation") for i in range(3)]
    slides = [Joint(f"slide {i}", i, "translation") for i in ((0,) if inner_slides else ()) + sliding]
    return Robot("flush", tubes, (*joints, *slides))


@pytest.mark.parametrize(
    ("inner_slides", "sliding", "flush"),
    [(True, (), (1, 2)), (True, (1,), (1, 2)), (True, (1, 2), (1, 2)), (False, (), (0, 1)), (False, (2,), (0, 1))],
)
def test_flush_ends_of_three_tubes_stay_flush_in_a_fit_of_the_tubes(inner_slides, sliding, flush):
    robot = flush_robot(inner_slides, sliding, flush)
    random, count = np.random.default_rng(4), 40
    joints = np.zeros((count, len(robot.joints)))
    shift = random.uniform(-0.02, 0.0, count)
    for k, joint in enumerate(robot.joints):
        start = robot.tubes[joint.tube].translation
        if joint.motion == "rotation":
            joints[:, k] = random.uniform(-1.0, 1.0, count)
        elif joint.tube == 0:
            joints[:, k] = random.uniform(-0.12, -0.07, count)
        else:  # tubes 1 and 2 slide together, so that their ends stay flush
            joints[:, k] = start + (shift if 2 in sliding else 0.0)
    bent = replace(robot.tubes[1], sections=(robot.tubes[1].sections[0], Section(0.1, (3.3, 0.2))))
    true = replace(robot, tubes=(robot.tubes[0], bent, robot.tubes[2]))
    measurements, forces = measured(true, joints, noise=0.02e-3)
    asked = fit_parameters(robot, measurements, forces, hysteresis=False)
    found = fit_poses(robot, measurements, forces, "tubes", asked)

    ends = [np.array([tube.length + tube.translation for tube in each.tubes]) for each in (robot, found.robot)]
    np.testing.assert_allclose(ends[1][list(flush)], ends[0][list(flush)], rtol=0, atol=1e-12)
    assert found.noise == pytest.approx(0.02e-3, rel=0.25)
    angle = math.atan2(*found.robot.tubes[1].sections[1].curvature[::-1])
    assert angle == pytest.approx(math.atan2(0.2, 3.3), abs=math.radians(0.3))


def test_a_calibration_never_moves_the_ends_of_fixed_flush_tubes():
    kinds = {(each.tube, each.kind) for each in quantities(flush_robot(True, (), (1, 2)))}
    assert {(1, "curve_start"), (0, "straight_length")} < kinds
    assert not kinds & {(1, "straight_length"), (1, "end"), (2, "end")}
    sliding = {(each.tube, each.kind) for each in quantities(flush_robot(True, (1,), (1, 2)))}
    assert {(1, "straight_length"), (1, "end"), (2, "end")} < sliding


@pytest.mark.parametrize("outlier", [0.0, 0.05])
def test_a_tip_that_stands_still_is_noticed_before_a_fit(paper_robot, outlier):
    """The joints of 31 rows move by 91 mm and 230 degrees, the tip by 0.3 mm."""
    random, joints = np.random.default_rng(3), poses(3, 31)
    joints[:, 2] = np.linspace(-0.115, -0.024, 31)
    points = np.array([0.1, 0.2, 0.3]) + random.uniform(-0.1e-3, 0.1e-3, (31, 3))
    points[5] += outlier
    still = [Measurement(0.0, pose, at, np.zeros((2, 6)), 0.0) for pose, at in zip(joints, points, strict=True)]
    with pytest.raises(UnobservableCombination, match=r"the tip does not move.*inner_translation 91 mm"):
        check_tip_moves(paper_robot, still, np.zeros((31, 3)))


def test_a_moving_tip_passes_and_a_tip_of_other_rows_does_not_follow_the_model(paper_robot):
    measurements, forces = measured(paper_robot, poses(9, 30))
    mixed = [m._replace(coil=measurements[(7 * k + 3) % 30].coil) for k, m in enumerate(measurements)]
    for those, follows in ((measurements, True), (mixed, False)):
        check_tip_moves(paper_robot, those, forces)
        found = fit_poses(paper_robot, those, forces, "frames", FitParameters())
        assert follows_model(found, those, forces) is follows


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
    measurements, forces = measured(paper_robot, poses(9, 10))
    wrong = [measurement._replace(joints=measurement.joints * factor) for measurement in measurements]
    what, other, given = alternative_readings(paper_robot, wrong, forces)[0]
    assert what == words
    assert other < 0.3e-3
    assert given > 5e-3


def test_correct_joints_have_no_alternative_reading(paper_robot):
    assert alternative_readings(paper_robot, *measured(paper_robot, poses(9, 10))) == ()


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
