"""The largest plausible error of the force, compared with errors that random numbers make."""

import numpy as np
import pytest

from core.control.deflection_force import start_deflection
from core.control.force_error import DEVIATIONS, error_by_deflection, error_by_sensors
from core.control.sensor_zeros import start_zeros
from core.control.tip_force import COVARIANCE, VARIANCE
from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import load_robot

FREE = Statics(load_robot("paper").robot()).solve(np.array([0.0, 0.5 * np.pi, -0.1]), np.zeros(6))


def random_covariance(seed: int) -> Array:
    root = np.random.default_rng(seed).normal(size=(3, 3)) * [0.01, 0.05, 0.1]
    return np.asarray(root @ root.T)


def estimated(covariance: Array) -> Array:
    load = np.zeros((5, 3))
    load[VARIANCE], load[COVARIANCE] = np.diag(covariance), covariance[[0, 0, 1], [1, 2, 2]]
    return load


@pytest.mark.parametrize("seed", range(5))
def test_the_error_covers_95_of_100_errors_in_the_worst_direction(seed: int) -> None:
    covariance = random_covariance(seed)
    errors = np.random.default_rng(100 + seed).multivariate_normal(np.zeros(3), covariance, 20_000)
    worst = np.linalg.svd(errors, full_matrices=False)[2][0]
    inside = np.abs(errors @ worst) <= error_by_sensors(estimated(covariance), None)
    assert inside.mean() == pytest.approx(0.954, abs=0.01)


def test_drift_of_the_zeros_and_a_force_that_was_assumed_to_be_drift_add_to_the_error() -> None:
    load, zeros = estimated(0.03**2 * np.eye(3)), start_zeros(2)
    assert error_by_sensors(load, zeros) == pytest.approx(DEVIATIONS * 0.03)
    drifted = zeros._replace(deviation=0.04, assumed=np.array([0.0, 0.3, 0.4]))
    assert error_by_sensors(load, drifted) == pytest.approx(DEVIATIONS * 0.05 + 0.5)


def test_the_error_of_a_force_from_the_deflection_leaves_out_what_the_deflection_cannot_show() -> None:
    deviations = np.array([0.02, 0.04, 0.249])
    found = start_deflection(FREE, np.zeros(3))
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    covariance = (turn * deviations**2 @ turn.T)[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    assert error_by_deflection(found._replace(covariance=covariance)) == pytest.approx(DEVIATIONS * 0.04)
    assert error_by_deflection(found) == 0.0  # before the first frame the force is unknown in every direction
