"""The tube calibration recovers a robot that differs from its description."""

import math

import numpy as np
import pytest

from core.calibration.fit import UnobservableCombination
from core.calibration.tubes import calibrate_tubes, held_out_errors
from tests.harness.visited import NOISE, TRACKER, altered, poses, seen

PULLS = [np.zeros(3), np.array([0.25, 0.0, 0.0]), np.array([0.5, 0.0, 0.0])]


@pytest.fixture(scope="module")
def recorded(paper_robot):
    """Return measurements and forces of the altered robot, to fit and to validate."""
    true, fits, checks = altered(paper_robot), ([], []), ([], [])
    for number, pull in enumerate(PULLS):
        for seed, count, into in ((number, 20, fits), (10 + number, 6, checks)):
            measurements = seen(true, poses(seed, count), pull, seed=seed)
            into[0].extend(measurements)
            noise = NOISE.force * np.random.default_rng([seed, 5]).standard_normal((count, 3))
            into[1].extend(pull + (noise if pull.any() else 0.0 * noise))
    return (fits[0], np.array(fits[1])), (checks[0], np.array(checks[1]))


@pytest.fixture(scope="module")
def found(paper_robot, recorded):
    measurements, forces = recorded[0]
    return calibrate_tubes(paper_robot, measurements, forces, NOISE)


def test_the_tube_calibration_finds_stiffness_curvature_nu_and_zero_angle(paper_robot, found):
    for new, true in zip(found.robot.tubes, altered(paper_robot).tubes, strict=True):
        assert new.bending_stiffness == pytest.approx(true.bending_stiffness, rel=0.01)
        assert math.hypot(*new.sections[1].curvature) == pytest.approx(
            math.hypot(*true.sections[1].curvature), rel=0.005
        )
        assert new.poisson_ratio == pytest.approx(true.poisson_ratio, abs=0.03)
        angles = [math.atan2(*tube.sections[1].curvature[::-1]) for tube in (new, true)]
        assert angles[0] == pytest.approx(angles[1], abs=math.radians(0.1))


def test_true_tube_parameters_are_within_three_standard_deviations(paper_robot, found):
    true, fit = altered(paper_robot), found.fit
    expected = {
        "inner bending_stiffness": true.tubes[0].bending_stiffness / 0.0413 - 1.0,
        "inner curvature": 3.86 / 4.0 - 1.0,
        "inner poisson_ratio": 0.04,
        "inner straight_length": 0.0,
        "inner zero_angle": math.radians(1.5),
        "outer bending_stiffness": 0.0500 / 0.0480 - 1.0,
        "outer curvature": 4.1 / 4.0 - 1.0,
        "outer poisson_ratio": 0.04,
        "outer end": 0.0,
    }
    for name, value in expected.items():
        assert abs(fit.value(name) - value) < 3.0 / 1.96 * fit.interval(name), name
    assert 0.6 < fit.variance_factor < 1.5


def test_the_tube_calibration_also_finds_the_frames(found):
    corners = np.array([[x, y, 0.2] for x in (-0.05, 0.05) for y in (-0.05, 0.05)])
    there = found.frames.registration.apply(TRACKER.inverse().apply(corners))

    assert np.linalg.norm(there - corners, axis=1).mean() < 0.08e-3


def test_calibrated_tubes_predict_held_out_loaded_poses_many_times_better(paper_robot, recorded, found):
    result = held_out_errors(paper_robot, found, recorded[0], recorded[1], NOISE)

    assert result.after.mean() < 0.1e-3
    assert result.before.mean() > 4.0 * result.after.mean()


def test_a_stiffness_fit_without_loaded_measurements_is_refused(paper_robot, recorded):
    measurements, forces = recorded[0]
    free = [k for k, force in enumerate(forces) if not force.any()]

    with pytest.raises(UnobservableCombination, match=r"0 measurements under more than 0\.05 N; .* hang a weight"):
        calibrate_tubes(paper_robot, [measurements[k] for k in free], forces[free], NOISE)


def test_a_tube_calibration_with_too_few_poses_is_refused(paper_robot, recorded):
    measurements, forces = recorded[0]

    with pytest.raises(UnobservableCombination, match="5 measurements for 18 unknowns"):
        calibrate_tubes(paper_robot, measurements[-5:], forces[-5:], NOISE)


def test_the_tube_calibration_finds_a_drives_play_from_arrival_directions(paper_robot):
    play, joints = np.array([0.0, 4e-3, 0.0]), poses(21, 40)
    came = np.sign(np.diff(np.vstack((np.zeros(3), joints)), axis=0))
    pull = np.array([0.4, 0.0, 0.0])
    forces = np.where(np.arange(40)[:, None] < 20, 0.0, pull)
    measurements = []
    for part, force in ((slice(0, 20), (0.0, 0.0, 0.0)), (slice(20, 40), pull)):
        true = joints[part] - 0.5 * play * came[part]
        for measurement, stage, direction in zip(seen(paper_robot, true, force), joints[part], came[part], strict=True):
            measurements.append(measurement._replace(joints=stage, came=direction))

    found = calibrate_tubes(paper_robot, measurements, forces, NOISE._replace(force=1e-6)).fit

    assert found.value("inner_rotation play") == pytest.approx(4e-3, abs=1e-3)
    assert abs(found.value("outer_rotation play")) < 1e-3
    assert found.variance_factor < 1.6
