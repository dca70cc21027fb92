"""The points of the tubes are moved by the most likely errors of the tubes that explain the observed tip."""

from dataclasses import replace

import numpy as np
import pytest

from core.control.shape_correction import error_causes, start_correction, update_correction
from core.model.backbone import POINTS, backbone
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.config.robots import load_robot

ROBOT = load_robot("paper").robot()
STATICS = Statics(ROBOT)
CAUSES = error_causes(STATICS, 0.05, 0.01)
JOINTS, WRENCH = np.array([0.3, 1.2, -0.1]), np.array([0.1, -0.15, 0.05, 0.0, 0.0, 0.0])
TIP_NOISE_M = 1e-4


def varied(seed: int) -> Robot:
    """Return the robot with stiffness and curvature of each tube within 8 % of the description."""
    random = np.random.default_rng(seed)
    tubes = tuple(
        replace(
            tube,
            bending_stiffness=random.uniform(0.92, 1.08) * tube.bending_stiffness,
            sections=tuple(
                replace(one, curvature=tuple(factor * u for u in one.curvature))
                for factor in [random.uniform(0.92, 1.08)]
                for one in tube.sections
            ),
        )
        for tube in ROBOT.tubes
    )
    return replace(ROBOT, tubes=tubes)


def points(statics: Statics) -> Array:
    return backbone(statics, statics.solve(JOINTS, WRENCH)).points[:POINTS]


def test_errors_along_the_tubes_are_a_third_of_those_of_the_square_of_the_share() -> None:
    at = STATICS.solve(JOINTS, WRENCH)
    weights = start_correction(STATICS, CAUSES, at, TIP_NOISE_M).weights
    corrected: list[Array] = []
    by_square: list[Array] = []
    for seed in range(20):
        true = points(Statics(varied(seed)))
        corrected.append(backbone(STATICS, at, true[-1], weights=weights).points[:POINTS] - true)
        by_square.append(backbone(STATICS, at, true[-1]).points[:POINTS] - true)

    assert np.sqrt(np.mean(np.square(by_square))) > 50e-6
    assert np.sqrt(np.mean(np.square(corrected))) < np.sqrt(np.mean(np.square(by_square))) / 3.0


def test_last_point_is_at_the_observed_tip() -> None:
    at, offset = STATICS.solve(JOINTS, WRENCH), np.array([0.002, -0.001, 0.0015])
    weights = start_correction(STATICS, CAUSES, at, TIP_NOISE_M).weights
    found = backbone(STATICS, at, at.tip + offset, weights=weights)

    assert np.allclose(found.points[POINTS - 1], at.tip + offset, atol=1e-9)
    assert np.allclose(found.points[0], backbone(STATICS, at).points[0], atol=1e-9)


def test_an_unknown_force_bends_the_points_as_a_force_does() -> None:
    """A bench without force sensors: the model has no load, the tip is observed under a load."""
    free, loaded = STATICS.solve(JOINTS, np.zeros(6)), points(STATICS)
    causes = error_causes(STATICS, 0.001, 0.25)
    weights = start_correction(STATICS, causes, free, TIP_NOISE_M).weights
    found = backbone(STATICS, free, loaded[-1], weights=weights).points[:POINTS] - loaded
    by_square = backbone(STATICS, free, loaded[-1]).points[:POINTS] - loaded

    assert np.abs(found).max() < 0.7 * np.abs(by_square).max()


def test_frames_renew_the_causes_one_after_the_other() -> None:
    start = STATICS.solve(JOINTS, WRENCH)
    moved = STATICS.solve(JOINTS + np.array([0.2, -0.3, 0.01]), WRENCH, near=start)
    correction = start_correction(STATICS, CAUSES, start, TIP_NOISE_M)
    expected = start_correction(STATICS, CAUSES, moved, TIP_NOISE_M)
    for _ in CAUSES:
        assert not np.allclose(correction.influence, expected.influence, rtol=1e-3, atol=1e-6)
        correction = update_correction(STATICS, CAUSES, correction, moved, TIP_NOISE_M)

    assert correction.influence == pytest.approx(expected.influence, abs=1e-9)
    assert correction.weights == pytest.approx(expected.weights, abs=1e-9)
