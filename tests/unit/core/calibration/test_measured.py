"""Measured poses held against the model: known frames, tubes and lags found again from poses of the exact rod."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.calibration.fit import Unobservable
from core.calibration.measured import Asked, Spread, alike, askable, match, suspicions, ways
from core.calibration.measurements import Measurement
from core.calibration.rigid import Rigid
from core.model.cosserat import ExactRod
from tests.harness.visited import altered, poses

BASE = Rigid(Rotation.from_rotvec([1.0, -2.0, 0.5]).as_matrix(), np.array([0.3, 0.2, -0.1]))
OFFSET = np.array([2e-3, -1e-3, 15e-3])
NOISE = 0.1e-3


def measured(robot, joints, forces=None, *, noise=NOISE, seed=0, came=None, play=0.0):
    """Measurements of the exact rod by a tracker that stands at BASE and looks at a marker OFFSET from the tip."""
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
    """Angle between two rotations [rad]."""
    return float(np.linalg.norm(Rotation.from_matrix(first @ second.T).as_rotvec()))


def test_base_and_offset_are_found_again_with_the_described_tubes(paper_robot):
    measurements, forces = measured(paper_robot, poses(1, 40))
    found = match(paper_robot, measurements, forces, "frames", Asked())

    assert turned(found.frames.registration.rotation, BASE.rotation) < 1.5e-3
    np.testing.assert_allclose(found.frames.registration.position, BASE.position, rtol=0, atol=0.3e-3)
    np.testing.assert_allclose(found.frames.coil, OFFSET, rtol=0, atol=0.3e-3)
    assert found.noise == pytest.approx(NOISE, rel=0.15)
    # The mean length of a vector of three normal components is sqrt(8 / pi) of their deviation; 9 of 120 are fitted.
    assert Spread.of(found.errors(measurements, forces)).mean == pytest.approx(
        math.sqrt(8.0 / math.pi) * NOISE, rel=0.12
    )  # fmt: skip


def test_how_well_the_base_is_known_is_how_far_it_scatters(paper_robot):
    """Over repeated measurements of the same poses, the tracker's origin half a metre away."""
    found = [
        match(paper_robot, *measured(paper_robot, poses(1, 20), seed=seed), "frames", Asked()) for seed in range(30)
    ]
    places = np.array([each.frames.registration.position for each in found])
    said = np.mean([each.position_errors for each in found], axis=0)
    # The deviation of 30 is known to 13 %; three times that.
    np.testing.assert_allclose(places.std(axis=0, ddof=1), said, rtol=0.4)
    np.testing.assert_allclose(places.mean(axis=0), BASE.position, rtol=0, atol=4.0 * said.max() / math.sqrt(30.0))


def test_tips_that_are_given_in_the_robot_s_frame_need_no_fit(paper_robot):
    measurements, forces = measured(paper_robot, poses(1, 3), noise=0.0)
    at_tip = [v._replace(coil=ExactRod(paper_robot).solve(v.joints, np.zeros(6)).tip) for v in measurements]
    found = match(paper_robot, at_tip, forces, "none", Asked())

    assert found.fit is None
    assert np.abs(found.errors(at_tip, forces)).max() < 2e-6  # of the model's fourth-order scheme


@pytest.fixture(scope="module")
def loaded(paper_robot):
    """Poses of altered tubes under known loads, and what was asked and found."""
    forces = 0.25 * np.random.default_rng(7).standard_normal((60, 3))
    measurements, forces = measured(altered(paper_robot), poses(2, 60), forces)
    asked = askable(paper_robot, measurements, forces, hysteresis=False)
    return measurements, forces, match(paper_robot, measurements, forces, "tubes", asked)


def test_tubes_are_found_again_under_load(paper_robot, loaded):
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
        "inner poisson_ratio": 0.04,
        "inner zero_angle": math.radians(1.5),
        "outer bending_stiffness": 0.0500 / 0.0480 - 1.0,
        "outer curvature": 4.1 / 4.0 - 1.0,
        "outer poisson_ratio": 0.04,
    }
    for name, value in expected.items():
        assert abs(found.fit.value(name) - value) < 3.0 / 1.96 * found.fit.interval(name), name


def test_poses_that_no_fit_has_seen_are_predicted_within_the_noise(paper_robot, loaded):
    measurements, forces, found = loaded
    others, none = measured(altered(paper_robot), poses(3, 20), noise=0.0)
    described = match(paper_robot, measurements, forces, "frames", Asked())

    assert Spread.of(found.errors(others, none)).mean < 0.1e-3
    assert Spread.of(described.errors(others, none)).mean > 0.7e-3


def test_without_load_only_ratios_of_stiffness_are_asked_for(paper_robot):
    measurements, forces = measured(altered(paper_robot), poses(4, 50))
    asked = askable(paper_robot, measurements, forces, hysteresis=False)
    found = match(paper_robot, measurements, forces, "tubes", asked)

    assert any("outer bending stiffness" in reason and "0 poses" in reason for reason in asked.left)
    inner, outer = found.robot.tubes
    assert outer.bending_stiffness == 0.048
    assert inner.bending_stiffness / outer.bending_stiffness == pytest.approx(0.0390 / 0.0500, rel=0.03)


def test_a_lag_behind_the_way_that_the_joints_came_is_found(paper_robot):
    joints = poses(5, 60)
    came = np.sign(np.random.default_rng(5).standard_normal(joints.shape))
    play = np.array([0.06, 0.09, 1.2e-3])
    measurements, forces = measured(paper_robot, joints, came=list(came), play=play)
    without = askable(paper_robot, measurements, forces, hysteresis=False)
    asked = askable(paper_robot, measurements, forces, hysteresis=True)
    found = match(paper_robot, measurements, forces, "frames", asked)

    assert without.lags == ()
    assert (np.abs(found.plays - play) < [3e-3, 3e-3, 0.15e-3]).all()
    assert found.noise == pytest.approx(NOISE, rel=0.15)
    assert match(paper_robot, measurements, forces, "frames", without).noise > 5.0 * NOISE


def test_one_tube_more_and_six_joints(three_tubes):
    random = np.random.default_rng(11)
    turns = random.uniform(-1.0, 1.0, (50, 3))
    slides = random.uniform([-0.19, -0.09, -0.025], [-0.15, -0.06, -0.005], (50, 3))
    joints = np.stack((turns, slides), axis=2).reshape(50, 6)
    joints = joints[[three_tubes.stands(pose) for pose in joints]]
    middle = three_tubes.tubes[1]
    bent = replace(middle.sections[1], curvature=(3.3, 2.2))
    true = replace(
        three_tubes,
        tubes=(three_tubes.tubes[0], replace(middle, sections=(middle.sections[0], bent)), three_tubes.tubes[2]),
    )
    measurements, forces = measured(true, joints, noise=0.02e-3)
    asked = askable(three_tubes, measurements, forces, hysteresis=False)
    found = match(three_tubes, measurements, forces, "tubes", asked)

    assert math.hypot(*found.robot.tubes[1].sections[1].curvature) == pytest.approx(math.hypot(3.3, 2.2), rel=0.01)
    assert found.noise == pytest.approx(0.02e-3, rel=0.2)


def test_single_slips_are_not_fitted_but_count(paper_robot):
    measurements, forces = measured(paper_robot, poses(6, 40))
    measurements[7] = measurements[7]._replace(coil=measurements[7].coil + np.array([0.02, 0.0, 0.0]))
    found = match(paper_robot, measurements, forces, "frames", Asked())

    assert [k for k, seen in enumerate(found.fitted) if not seen] == [7]
    assert found.noise == pytest.approx(NOISE, rel=0.2)
    assert Spread.of(found.errors(measurements, forces)).largest == pytest.approx(0.02, rel=0.02)


def test_a_tube_that_stands_flush_is_not_asked_for_its_length_nor_its_lag(paper_robot):
    joints = poses(8, 12)
    joints[3, 2] = -0.138
    way = np.tile([1.0, -1.0], 18).reshape(12, 3)
    measurements = [
        Measurement(0.0, pose, np.zeros(3), np.zeros((2, 6)), 0.0, w) for pose, w in zip(joints, way, strict=True)
    ]
    asked = askable(paper_robot, measurements, np.zeros((12, 3)), hysteresis=True)

    assert "straight_length" not in {quantity.kind for quantity in asked.quantities}
    assert [lag.joint for lag in asked.lags] == [0, 1]
    assert any(reason.startswith("lag of inner_translation") for reason in asked.left)
    free = askable(paper_robot, measurements[:3], np.zeros((3, 3)), hysteresis=True)
    assert "straight_length" in {quantity.kind for quantity in free.quantities}


def test_too_few_poses_are_refused_with_the_number_that_is_needed(paper_robot):
    measurements, forces = measured(paper_robot, poses(1, 3))
    with pytest.raises(Unobservable, match=r"usable poses: 3, for 9 unknowns \(frames\); at least 4 are needed"):
        match(paper_robot, measurements, forces, "frames", Asked())


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        ([1.0, -1.0, 1.0], "inner_rotation running the other way"),
        ([180.0 / math.pi, 180.0 / math.pi, 1.0], "all rotations read as degrees"),
    ],
)
def test_joints_written_down_otherwise_are_suspected(paper_robot, factor, words):
    measurements, forces = measured(paper_robot, poses(9, 30))
    assert suspicions(paper_robot, measurements, forces) == ()
    wrong = [measurement._replace(joints=measurement.joints * factor) for measurement in measurements]
    what, other, given = suspicions(paper_robot, wrong, forces)[0]
    assert what == words
    assert other < 0.3e-3
    assert given > 5e-3


def test_ways_follow_turns_and_not_jitter():
    column = np.array([0.0, 0.001, 0.5, 1.0, 0.9995, 1.5, 1.2, 0.4, 0.4005, -0.5, -0.4])
    said = [0, 0, 1, 1, 1, 1, -1, -1, -1, -1, 1]
    still = np.full_like(column, 0.3)
    assert ways(np.column_stack((column, still))).T.tolist() == [said, [0] * len(said)]


def test_noise_is_not_alike_and_a_smooth_field_is():
    random = np.random.default_rng(0)
    joints = random.uniform(-1.0, 1.0, (300, 2))
    smooth = np.column_stack((np.sin(3.0 * joints[:, 0]), joints[:, 1], joints.prod(axis=1)))
    assert alike(joints, random.standard_normal((300, 3))) < 0.15
    assert alike(joints, smooth) > 0.8


def test_a_spread_counts_what_is_there():
    errors = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0], [math.nan] * 3, [0.0, 0.0, 3.0]])
    spread = Spread.of(errors)
    assert spread == Spread(3, 3.0, 3.0, pytest.approx(4.8), 5.0)
