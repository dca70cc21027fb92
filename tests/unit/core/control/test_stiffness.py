"""The offset of the setpoint: its size, its bounds, its axes, and its stability in contact with a rigid obstacle."""

import numpy as np
import pytest

from core.control.stiffness import (
    MAX_RATE_PER_S,
    MAX_SPEED_M_S,
    MIN_GAIN_PER_S,
    NO_OFFSET,
    RAMP_S,
    StiffnessRamp,
    TipStiffness,
)
from core.errors import DescriptionError

PERIOD, DELAY, GAIN = 0.002, 0.0445, 2.5
#: Compliance of the tubes in the pose of the experiments [m/N].
NATURAL = np.array([[0.0308, 0.002, -0.002], [0.002, 0.0306, 0.004], [-0.002, 0.004, 0.0034]])
#: Frame of the tip: 40 deg about z, then 50 deg about the world's x.
TURN_Z, TURN_X = np.radians((40.0, 50.0))
TIP = np.array([[1, 0, 0], [0, np.cos(TURN_X), -np.sin(TURN_X)], [0, np.sin(TURN_X), np.cos(TURN_X)]]) @ np.array(
    [[np.cos(TURN_Z), -np.sin(TURN_Z), 0], [np.sin(TURN_Z), np.cos(TURN_Z), 0], [0, 0, 1]]
)


class Solved:
    """Solution of a model that has only a compliance and the frame of the tip."""

    def part(self, name):
        return {"compliance": np.block([[NATURAL, np.zeros((3, 3))], [np.zeros((3, 6))]]), "rotation": TIP}[name]


def offsets(stiffness, force, seconds=30.0):
    found, rates = [NO_OFFSET], stiffness.rates(NATURAL, TIP, GAIN, DELAY)
    for _ in range(round(seconds / PERIOD)):
        found.append(stiffness.update(found[-1], np.array(force), TIP, rates, PERIOD))
    return found


def compliance(stiffness):
    """Return K_d^-1 (3, 3) in the world frame, as a sum over the axes."""
    axes = TIP.T if stiffness.frame == "tip" else np.eye(3)
    return sum(np.outer(axis, axis) / value for axis, value in zip(axes, stiffness.axes, strict=True))


@pytest.mark.parametrize("force", [(0.05, 0.1, -0.3)])
def test_offset_settles_at_force_over_stiffness(force):
    stiffness = TipStiffness((30.0, 60.0, 500.0))
    assert offsets(stiffness, force)[-1].position == pytest.approx(np.array(force) / stiffness.axes, abs=1e-6)


@pytest.mark.parametrize("axis", [0, 2])
def test_offset_along_an_axis_of_the_tip_settles_at_force_over_stiffness(axis):
    stiffness = TipStiffness((30.0, 60.0, 500.0), frame="tip")
    along = TIP[:, axis]
    assert offsets(stiffness, 0.1 * along)[-1].position == pytest.approx(0.1 / stiffness.axes[axis] * along, abs=1e-6)


def test_offset_in_the_frame_of_the_tip_settles_at_the_turned_compliance_times_the_force():
    stiffness, force = TipStiffness((30.0, 60.0, 500.0), frame="tip"), np.array([0.05, 0.1, -0.3])
    assert offsets(stiffness, force)[-1].position == pytest.approx(compliance(stiffness) @ force, abs=1e-6)


def test_stiffness_along_the_world_axes_does_not_depend_on_the_frame_of_the_tip():
    stiffness, force = TipStiffness((30.0, 60.0, 500.0)), np.array([0.05, 0.1, -0.3])
    rates = [stiffness.rates(NATURAL, tip, GAIN, DELAY) for tip in (TIP, np.eye(3))]
    found = [stiffness.update(NO_OFFSET, force, tip, rates[0], PERIOD) for tip in (TIP, np.eye(3))]
    np.testing.assert_array_equal(rates[0], rates[1])
    np.testing.assert_array_equal(found[0], found[1])


def test_offset_stays_inside_its_bound_and_its_speed_under_a_wrong_force():
    found = offsets(TipStiffness((30.0, 60.0, 500.0), max_offset=0.004), (50.0, -20.0, 10.0), 5.0)
    positions = np.array([one.position for one in found])
    assert np.linalg.norm(positions, axis=1).max() <= 0.004 + 1e-12
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).max() <= MAX_SPEED_M_S * PERIOD + 1e-12
    velocities = np.array([one.velocity for one in found])[1:]
    assert velocities == pytest.approx(np.diff(positions, axis=0) / PERIOD, abs=1e-9)


@pytest.mark.parametrize("frame", ["world", "tip"])
def test_rates_of_every_direction_respect_the_delay(frame):
    stiffness = TipStiffness((20.0, 60.0, 200.0), frame=frame)
    rates = stiffness.rates(NATURAL, TIP, GAIN, DELAY)
    loop = compliance(stiffness) @ np.linalg.inv(NATURAL)
    for matrix, most in ((rates.filter, MAX_RATE_PER_S), (rates.gain, GAIN)):
        found = np.linalg.eigvals(loop @ matrix).real
        # Every direction has the smaller one of the two bounds.
        expected = np.minimum(0.5 / DELAY, most * np.linalg.eigvals(loop).real)
        assert np.sort(found) == pytest.approx(np.sort(expected), rel=1e-6)


@pytest.mark.parametrize("softness", [0.1, 3.0, 100.0])
def test_tip_against_a_rigid_obstacle_reaches_its_stiffness_without_oscillation(softness):
    """Simulate a tip that cannot move: joints that would move it by x cause the force -K_n x, after the delay."""
    natural = 1.0 / 30.0
    stiffness, pressed = TipStiffness((30.0 / softness,) * 3), 0.002
    rates = stiffness.rates(natural * np.eye(3), TIP, GAIN, DELAY)
    offset, joints, forces = NO_OFFSET, 0.0, [0.0] * round(DELAY / PERIOD)
    pressed_by = lambda moved: -(moved + pressed) / natural  # noqa: E731 - the obstacle has moved in by `pressed`
    for _ in range(round(60.0 / PERIOD)):
        offset = stiffness.update(offset, np.array([forces[-round(DELAY / PERIOD)], 0.0, 0.0]), TIP, rates, PERIOD)
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


def test_stiffness_in_the_frame_of_the_tip_is_refused_at_the_softness_of_the_turned_matrix():
    """The stiffest direction of the tubes is near z of the world, where this stiffness is low only if it is turned."""
    axes = (1.0, 1.0, 1000.0)
    TipStiffness(axes).check(Solved(), DELAY)
    stiffness = TipStiffness(axes, frame="tip")
    softness = np.linalg.eigvals(compliance(stiffness) @ np.linalg.inv(NATURAL)).real.max()
    with pytest.raises(DescriptionError, match=f"is {softness:.0f} times softer"):
        stiffness.check(Solved(), DELAY)


def test_stiffness_ramp_changes_the_compliance_linearly_between_its_ends():
    first, last = TipStiffness((20.0, 60.0, 500.0), 0.01, "tip"), TipStiffness((200.0, 30.0, 500.0), 0.01, "tip")
    ramp = StiffnessRamp(first, last, start=3.0)
    assert ramp.at(3.0).axes == pytest.approx(first.axes)
    assert ramp.at(3.0 + RAMP_S) == ramp.at(100.0) == last
    half = ramp.at(3.0 + 0.5 * RAMP_S)
    assert (half.frame, half.max_offset) == ("tip", 0.01)
    assert half.axes == pytest.approx((1.0 / (0.5 / 20 + 0.5 / 200), 1.0 / (0.5 / 60 + 0.5 / 30), 500.0))


def test_setpoint_moves_slowly_under_a_force_while_the_stiffness_changes():
    first, last = TipStiffness((200.0, 200.0, 200.0)), TipStiffness((20.0, 20.0, 20.0))
    force = np.array([0.2, 0.0, 0.0])
    ramp, offset = StiffnessRamp(first, last, start=0.0), offsets(first, force)[-1]
    travel = 0.2 / 20.0 - 0.2 / 200.0
    for number in range(round(10.0 / PERIOD)):
        stiffness = ramp.at(PERIOD * number)
        rates = stiffness.rates(NATURAL, TIP, GAIN, DELAY)
        offset = stiffness.update(offset, force, TIP, rates, PERIOD)
        assert np.linalg.norm(offset.velocity) <= travel / RAMP_S + 1e-9
    assert offset.position == pytest.approx([0.01, 0.0, 0.0], abs=1e-5)


@pytest.mark.parametrize("frame", ["world", "tip"])
def test_stiffness_within_a_ramp_is_never_softer_than_the_softer_end(frame):
    ends = TipStiffness((20.0, 600.0, 90.0), frame=frame), TipStiffness((300.0, 30.0, 800.0), frame=frame)
    softest = max(end.softness(NATURAL, TIP)[0][-1] for end in ends)
    ramp = StiffnessRamp(*ends, start=0.0)
    between = [ramp.at(RAMP_S * part).softness(NATURAL, TIP)[0][-1] for part in np.linspace(0.0, 1.0, 51)]
    assert max(between) <= softest * (1.0 + 1e-9)


@pytest.mark.parametrize("wrong", [((0.0, 1.0, 1.0), 0.02), ((1.0, 1.0, float("nan")), 0.02), ((1.0, 1.0, 1.0), 0.0)])
def test_stiffness_without_a_positive_value_is_refused(wrong):
    with pytest.raises(DescriptionError):
        TipStiffness(*wrong)
