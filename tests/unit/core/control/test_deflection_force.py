"""The force from the deflection is compared with the exact rod."""

import math

import numpy as np
import pytest

from core.control.deflection_force import (
    LARGEST_FORCE_N,
    LARGEST_STEP_N,
    DeflectionForce,
    start_deflection,
    update_deflection,
)
from core.control.observer import Observer, ObserverState
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import load_robot

JOINTS = np.array([0.0, math.pi / 2, -0.100])
BIAS = np.array([2e-3, -1e-3, 3e-3])
ROBOT = load_robot("paper").robot()
MODEL = Statics(ROBOT)
FREE = MODEL.solve(JOINTS, np.zeros(6))


def observed(tip: Array) -> ObserverState:
    """Return the observer's state for a tip that rests at `tip` (3,) [m], long after the first frame."""
    return Observer(0.002).start(FREE.tip, tip)


def settled(tip: Array, frames: int = 30) -> DeflectionForce:
    """Return the estimate after some frames with the tip at `tip` (3,) [m], from a reference with the bias."""
    found, state = start_deflection(FREE, BIAS), observed(tip)
    for _ in range(frames):
        found = update_deflection(MODEL, found, JOINTS, FREE, state, np.zeros(3))
    return found


def covariance(found: DeflectionForce) -> Array:
    xx, xy, xz, yy, yz, zz = found.covariance
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@pytest.mark.parametrize("force", [(0.5, 0.0, 0.0), (-0.3, 0.0, 0.0), (0.0, 0.4, 0.0), (0.2, -0.2, 0.0)])
def test_force_of_the_exact_rod_is_found_where_the_tubes_bend(force):
    rod = ExactRod(ROBOT)
    rest, bent = (rod.solve(JOINTS, np.concatenate((f, np.zeros(3)))) for f in (np.zeros(3), np.array(force)))
    found = settled(FREE.tip + BIAS + bent.tip - rest.tip)

    _, axes = np.linalg.eigh(covariance(found))
    error = axes.T @ (found.force - force)  # the third axis is the stiff one
    assert np.abs(error[:2]).max() < 0.01


def test_a_direction_in_which_the_tubes_hardly_bend_has_a_large_variance():
    variances, axes = np.linalg.eigh(covariance(settled(FREE.tip + BIAS)))
    compliant, directions = np.linalg.eigh(MODEL.solve(JOINTS, np.zeros(6)).compliance[:3, :3])
    assert abs(axes[:, 2] @ directions[:, 0]) > 0.999
    assert math.sqrt(variances[2]) == pytest.approx(LARGEST_FORCE_N, rel=0.2)
    # In the others the variance is that of the errors over the square of the compliance.
    errors = observed(FREE.tip).covariance[0] + 0.2e-3**2
    assert math.sqrt(variances[0]) == pytest.approx(math.sqrt(errors) / compliant[2], rel=0.02)


def test_no_deflection_is_no_force_whatever_the_bias():
    assert np.abs(settled(FREE.tip + BIAS).force).max() < 1e-9


def test_one_frame_changes_the_force_by_a_bounded_step():
    found = settled(FREE.tip + BIAS + np.array([0.05, 0.0, 0.0]), frames=1)
    assert np.linalg.norm(found.force) == pytest.approx(LARGEST_STEP_N)


def test_a_model_without_a_shape_gives_an_unknown_force_and_no_error():
    start = start_deflection(FREE, BIAS)._replace(force=np.array([1e6, 0.0, 0.0]))
    found = update_deflection(MODEL, start, JOINTS, FREE, observed(FREE.tip), np.zeros(3))
    assert not found.force.any()
    np.testing.assert_allclose(covariance(found), LARGEST_FORCE_N**2 * np.eye(3))


def test_uncertain_tubes_widen_the_interval_with_the_deflection():
    bent = FREE.tip + BIAS + np.array([0.010, 0.0, 0.0])
    start, state = start_deflection(FREE, BIAS), observed(bent)
    known, unknown = (update_deflection(MODEL, start, JOINTS, FREE, state, np.zeros(3), error) for error in (0.0, 0.05))
    ratio = np.linalg.eigvalsh(covariance(unknown))[0] / np.linalg.eigvalsh(covariance(known))[0]
    errors = state.covariance[0] + 0.2e-3**2
    assert ratio == pytest.approx((errors + (0.05 * 0.010) ** 2) / errors, rel=1e-2)
