import math

import numpy as np
import pytest

from core.errors import DescriptionError
from core.trajectories import Circle, Hold, Sinusoid

MOTIONS = [
    Hold(),
    Sinusoid((0.0, 0.0, 1.0), amplitude=0.015, frequency=0.05),
    Sinusoid((1.0, -2.0, 0.5), amplitude=0.010, frequency=2.0),
    Circle(radius=0.010, period=20.0),
    Circle(radius=0.005, period=1.0, normal=(0.3, -1.0, 2.0)),
]
TIMES = np.linspace(0.0, 25.0, 60)


@pytest.mark.parametrize("motion", MOTIONS, ids=repr)
def test_the_velocity_is_the_derivative_of_the_position(motion):
    step = 1e-5
    for time in TIMES:
        expected = (motion.setpoint(time + step).position - motion.setpoint(time - step).position) / (2 * step)
        np.testing.assert_allclose(motion.setpoint(time).velocity, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("motion", MOTIONS, ids=repr)
def test_a_motion_starts_where_the_tip_is(motion):
    assert motion.setpoint(0.0).position.tolist() == [0.0, 0.0, 0.0]


def test_hold_never_moves():
    for time in TIMES:
        assert not np.any(Hold().setpoint(time))


@pytest.mark.parametrize("length", [1e-3, 1.0, 50.0])
def test_a_sinusoid_goes_its_amplitude_along_its_direction_whatever_the_directions_length(length):
    direction = np.array([2.0, -1.0, 2.0]) / 3.0
    motion = Sinusoid(tuple((length * direction).tolist()), amplitude=0.015, frequency=0.05)

    np.testing.assert_allclose(motion.setpoint(5.0).position, 0.015 * direction, rtol=0, atol=1e-15)
    np.testing.assert_allclose(motion.setpoint(15.0).position, -0.015 * direction, rtol=0, atol=1e-15)
    np.testing.assert_allclose(motion.setpoint(20.0).position, 0.0, atol=1e-15)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.0, -4.0), (1.0, 0.0, 0.0), (0.3, -1.0, 2.0)])
def test_a_circle_keeps_its_radius_its_plane_and_its_speed_and_turns_once_about_its_normal(normal):
    radius, period = 0.010, 20.0
    motion, axis = Circle(radius, period, normal), np.array(normal) / np.linalg.norm(normal)
    centre = 0.5 * motion.setpoint(period / 2).position  # opposite the start

    for time in TIMES:
        position, velocity = motion.setpoint(time)
        assert np.linalg.norm(position - centre) == pytest.approx(radius, rel=1e-12)
        assert position @ axis == pytest.approx(0.0, abs=1e-15)
        np.testing.assert_allclose(
            np.cross(position - centre, velocity), 2 * math.pi / period * radius**2 * axis, rtol=0, atol=1e-15
        )
    np.testing.assert_allclose(motion.setpoint(period).position, 0.0, atol=1e-15)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sinusoid((0.0, 0.0, 1.0), 0.0, 0.05), "sinusoid: amplitude 0 m must be"),
        (lambda: Sinusoid((0.0, 0.0, 1.0), -0.01, 0.05), "sinusoid: amplitude -0.01 m must be"),
        (lambda: Sinusoid((0.0, 0.0, 1.0), math.nan, 0.05), "sinusoid: amplitude nan m must be"),
        (lambda: Sinusoid((0.0, 0.0, 1.0), 0.01, -1.0), "sinusoid: frequency -1 Hz must be"),
        (lambda: Sinusoid((0.0, 0.0, 1.0), 0.01, math.inf), "sinusoid: frequency inf Hz must be"),
        (lambda: Sinusoid((0.0, 0.0, 0.0), 0.01, 1.0), "sinusoid: direction (0.0, 0.0, 0.0) has no length"),
        (lambda: Sinusoid((0.0, math.nan, 1.0), 0.01, 1.0), "sinusoid: direction (0.0, nan, 1.0)"),
        (lambda: Sinusoid((0.0, 1.0), 0.01, 1.0), "give three numbers"),
        (lambda: Circle(0.0, 20.0), "circle: radius 0 m must be finite and greater than 0"),
        (lambda: Circle(math.inf, 20.0), "circle: radius inf m must be"),
        (lambda: Circle(0.01, 0.0), "circle: period 0 s must be"),
        (lambda: Circle(0.01, -20.0), "circle: period -20 s must be"),
        (lambda: Circle(0.01, 20.0, (0.0, 0.0, 0.0)), "(0.0, 0.0, 0.0) has no length"),
        (lambda: Circle(0.01, 20.0, (math.inf, 0.0, 0.0)), "(inf, 0.0, 0.0)"),
    ],
)
def test_an_impossible_motion_is_refused_by_name_value_and_bound(make, words):
    with pytest.raises(DescriptionError) as refused:
        make()

    assert words in str(refused.value)
