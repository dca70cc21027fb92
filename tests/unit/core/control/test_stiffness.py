"""The offset of the setpoint: its size, its bounds, and its stability in contact with a rigid obstacle."""

import numpy as np
import pytest

from core.control.stiffness import MAX_RATE_PER_S, MAX_SPEED_M_S, MIN_GAIN_PER_S, NO_OFFSET, TipStiffness
from core.errors import DescriptionError

PERIOD, DELAY, GAIN = 0.002, 0.0445, 2.5
#: Compliance of the tubes in the pose of the experiments [m/N].
NATURAL = np.array([[0.0308, 0.002, -0.002], [0.002, 0.0306, 0.004], [-0.002, 0.004, 0.0034]])


class Solved:
    """Solution of a model that has only a compliance."""

    def part(self, name):
        assert name == "compliance"
        return np.block([[NATURAL, np.zeros((3, 3))], [np.zeros((3, 6))]])


def offsets(stiffness, force, seconds=30.0):
    found, rates = [NO_OFFSET], stiffness.rates(NATURAL, GAIN, DELAY)
    for _ in range(round(seconds / PERIOD)):
        found.append(stiffness.update(found[-1], np.array(force), rates, PERIOD))
    return found


@pytest.mark.parametrize("force", [(0.2, 0.0, 0.0), (0.0, -0.1, 0.0), (0.05, 0.1, -0.3)])
def test_offset_settles_at_force_over_stiffness(force):
    stiffness = TipStiffness((30.0, 60.0, 500.0))
    assert offsets(stiffness, force)[-1].position == pytest.approx(np.array(force) / stiffness.axes, abs=1e-6)


def test_offset_stays_inside_its_bound_and_its_speed_under_a_wrong_force():
    found = offsets(TipStiffness((30.0, 60.0, 500.0), max_offset=0.004), (50.0, -20.0, 10.0), 5.0)
    positions = np.array([one.position for one in found])
    assert np.linalg.norm(positions, axis=1).max() <= 0.004 + 1e-12
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).max() <= MAX_SPEED_M_S * PERIOD + 1e-12
    velocities = np.array([one.velocity for one in found])[1:]
    assert velocities == pytest.approx(np.diff(positions, axis=0) / PERIOD, abs=1e-9)


def test_rates_of_every_direction_respect_the_delay():
    stiffness = TipStiffness((20.0, 60.0, 200.0))
    rates = stiffness.rates(NATURAL, GAIN, DELAY)
    loop = np.diag(stiffness.compliance) @ np.linalg.inv(NATURAL)
    for matrix, most in ((rates.filter, MAX_RATE_PER_S), (rates.gain, GAIN)):
        assert np.linalg.eigvals(loop @ matrix).real.max() * DELAY <= 0.5 + 1e-9
        assert np.linalg.eigvals(matrix).real.max() <= most + 1e-9


@pytest.mark.parametrize("softness", [0.1, 0.5, 1.0, 3.0, 10.0, 100.0])
def test_tip_against_a_rigid_obstacle_reaches_its_stiffness_without_oscillation(softness):
    """Simulate a tip that cannot move: joints that would move it by x cause the force -K_n x, after the delay."""
    natural = 1.0 / 30.0
    stiffness, pressed = TipStiffness((30.0 / softness,) * 3), 0.002
    rates = stiffness.rates(natural * np.eye(3), GAIN, DELAY)
    offset, joints, forces = NO_OFFSET, 0.0, [0.0] * round(DELAY / PERIOD)
    pressed_by = lambda moved: -(moved + pressed) / natural  # noqa: E731 - the obstacle has moved in by `pressed`
    for _ in range(round(60.0 / PERIOD)):
        offset = stiffness.update(offset, np.array([forces[-round(DELAY / PERIOD)], 0.0, 0.0]), rates, PERIOD)
        joints += PERIOD * (rates.gain[0, 0] * (offset.position[0] + pressed) + offset.velocity[0])
        forces.append(pressed_by(joints))
    expected = -pressed * 30.0 / softness
    assert forces[-1] == pytest.approx(expected, rel=0.02)
    settled = np.array(forces[len(forces) // 2 :])
    assert np.ptp(settled) < 0.1 * abs(expected)


def test_stiffness_that_the_delay_does_not_allow_is_refused_with_the_factor_that_is_missing():
    with pytest.raises(DescriptionError, match=r"stiffness 1, 1, 1 N/m is \d+ times softer .* allows 112 times: mult"):
        TipStiffness((1.0, 1.0, 1.0)).check(Solved(), DELAY)
    TipStiffness((10.0, 10.0, 100.0)).check(Solved(), DELAY)
    assert pytest.approx(112.0, abs=1.0) == 0.5 / (MIN_GAIN_PER_S * DELAY)


@pytest.mark.parametrize("wrong", [((0.0, 1.0, 1.0), 0.02), ((1.0, 1.0, float("nan")), 0.02), ((1.0, 1.0, 1.0), 0.0)])
def test_stiffness_without_a_positive_value_is_refused(wrong):
    with pytest.raises(DescriptionError):
        TipStiffness(*wrong)
