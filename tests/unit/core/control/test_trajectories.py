import math

import numpy as np
import pytest

from core.control.trajectories import (
    CircleMotion,
    Directions,
    HelixMotion,
    HoldMotion,
    SinusoidMotion,
    StepMotion,
    Waypoints,
)
from core.errors import DescriptionError

MOTIONS = [
    HoldMotion(),
    SinusoidMotion(direction=(0.0, 0.0, 1.0), amplitude=0.015, frequency=0.05),
    SinusoidMotion(direction=(1.0, -2.0, 0.5), amplitude=0.010, frequency=2.0),
    CircleMotion(radius=0.010, period=20.0),
    CircleMotion(radius=0.005, period=1.0, normal=(0.3, -1.0, 2.0)),
    HelixMotion(radius=0.005, pitch=0.003, turn=4.0, turns=7.0, axis=(0.0, 1.0, 1.0)),
    Waypoints((4.0, 9.0, 30.0), ((0.01, 0.0, 0.0), (0.01, 0.02, 0.0), (0.0, 0.0, -0.01))),
]
TIMES = np.linspace(0.0, 25.0, 60)


@pytest.mark.parametrize("motion", MOTIONS, ids=repr)
def test_every_trajectory_starts_at_the_tip_and_its_velocity_is_the_derivative_of_its_position(motion):
    step = 1e-5
    assert motion.setpoint(0.0).position.tolist() == [0.0, 0.0, 0.0]
    for time in TIMES:
        expected = (motion.setpoint(time + step).position - motion.setpoint(time - step).position) / (2 * step)
        np.testing.assert_allclose(motion.setpoint(time).velocity, expected, rtol=0, atol=1e-8)


def test_helix_is_a_circle_that_advances_one_pitch_per_turn_and_rests_at_its_end():
    helix, circle = (
        HelixMotion(radius=0.005, pitch=-0.003, turn=4.0, turns=2.5, axis=(0.0, 0.0, 2.0)),
        CircleMotion(radius=0.005, period=4.0, normal=(0.0, 0.0, 1.0)),
    )

    assert helix.period == 10.0
    for time in np.linspace(0.0, 9.99, 37):
        advance = np.array([0.0, 0.0, -0.003 * time / 4.0])
        np.testing.assert_allclose(
            helix.setpoint(time).position, circle.setpoint(time).position + advance, rtol=0, atol=1e-15
        )
    end = helix.setpoint(50.0)
    np.testing.assert_allclose(
        end.position, circle.setpoint(10.0).position + np.array([0.0, 0.0, -0.0075]), rtol=0, atol=1e-15
    )
    assert not end.velocity.any()


def test_step_trajectory_jumps_at_once_and_jumps_back_after_a_finite_stay():
    offset = (1e-3, 0.0, -2e-3)
    for time in (0.0, 1.0, 1e4):
        assert StepMotion(offset=offset).setpoint(time).position.tolist() == list(offset)
    there_and_back = StepMotion(offset=offset, stay=2.0)
    for time, there in ((0.0, True), (1.99, True), (2.0, False), (3.99, False), (4.0, True)):
        assert there_and_back.setpoint(time).position.any() == there
        assert not there_and_back.setpoint(time).velocity.any()


WAY = Waypoints((5.0, 10.0, 15.0), ((0.01, 0.0, 0.0), (0.01, 0.01, 0.0), (0.0, 0.01, 0.005)))


def test_waypoints_are_passed_at_their_times_from_rest_to_rest():
    for time, place in zip(WAY.times, WAY.places, strict=True):
        np.testing.assert_allclose(WAY.setpoint(time).position, place, rtol=0, atol=1e-12)
    for time in (0.0, 15.0, 99.0):
        np.testing.assert_allclose(WAY.setpoint(time).velocity, 0.0, atol=1e-12)
    assert WAY.setpoint(99.0).position.tolist() == [0.0, 0.01, 0.005]
    assert WAY.period == 15.0


def test_path_through_waypoints_has_a_continuous_acceleration():
    h = 1e-4
    for time in (5.0, 10.0):
        before = (WAY.setpoint(time).velocity - WAY.setpoint(time - h).velocity) / h
        after = (WAY.setpoint(time + h).velocity - WAY.setpoint(time).velocity) / h
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-6)


def test_path_through_accepted_waypoints_keeps_its_speed_and_acceleration_limits():
    times = np.linspace(0.0, 15.0, 3001)
    velocities = np.array([WAY.setpoint(time).velocity for time in times])
    fastest = np.linalg.norm(velocities, axis=1).max()
    hardest = np.linalg.norm(np.diff(velocities, axis=0), axis=1).max() / (times[1] - times[0])

    Waypoints(WAY.times, WAY.places, 1.01 * fastest, 1.01 * hardest)
    with pytest.raises(DescriptionError, match=r"waypoints: speed .* m/s at .* s is above"):
        Waypoints(WAY.times, WAY.places, 0.98 * fastest, 1.0)
    with pytest.raises(DescriptionError, match=r"waypoints: acceleration .* m/s\^2 at .* s is above"):
        Waypoints(WAY.times, WAY.places, 1.0, 0.98 * hardest)


def test_first_of_several_too_fast_pieces_is_reported_at_its_waypoint():
    times = (5.0, 10.0, 10.2, 15.0, 15.1, 20.0)
    places = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.0, 0.0, 0.0))
    # The path is slower before 10 s. After 10.2 s its speed reaches 0.5 m/s and its acceleration 0.4 m/s^2.
    with pytest.raises(DescriptionError, match=r"acceleration 0\.237 m/s\^2 at 10\.2 s") as hard:
        Waypoints(times, places, max_speed=10.0, max_acceleration=0.2)
    with pytest.raises(DescriptionError, match=r"speed 0\.0559 m/s at 10\.") as fast:
        Waypoints(times, places, max_speed=0.0555, max_acceleration=10.0)
    assert (hard.value.time, fast.value.time) == (10.2, 10.2)


def test_waypoints_may_start_at_the_start_tip_or_consist_of_one_point():
    from_here = Waypoints((0.0, 5.0), ((0.0, 0.0, 0.0), (0.01, 0.0, 0.0)))
    np.testing.assert_allclose(from_here.setpoint(2.5).position, [0.005, 0.0, 0.0], rtol=0, atol=1e-12)
    alone = Waypoints((0.0,), ((0.0, 0.0, 0.0),))
    assert not np.any(alone.setpoint(1.0)[:2])


@pytest.mark.parametrize(
    ("motion", "period"),
    [
        (HoldMotion(), 0.0),
        (StepMotion(offset=(1e-3, 0.0, 0.0)), 0.0),
        (MOTIONS[1], 20.0),
        (CircleMotion(radius=0.01, period=12.0), 12.0),
        (WAY, 15.0),
    ],
    ids=repr,
)
def test_every_trajectory_repeats_itself_or_rests_after_its_period(motion, period):
    assert motion.period == pytest.approx(period)
    later = motion.setpoint(period + 3.0).position
    if isinstance(motion, CircleMotion | SinusoidMotion):
        np.testing.assert_allclose(later, motion.setpoint(3.0).position, rtol=0, atol=1e-12)
    else:
        np.testing.assert_array_equal(later, motion.setpoint(period).position)


@pytest.mark.parametrize("length", [1e-3, 1.0, 50.0])
def test_sinusoid_has_its_amplitude_along_a_direction_vector_of_any_length(length):
    direction = np.array([2.0, -1.0, 2.0]) / 3.0
    motion = SinusoidMotion(direction=tuple((length * direction).tolist()), amplitude=0.015, frequency=0.05)

    np.testing.assert_allclose(motion.setpoint(5.0).position, 0.015 * direction, rtol=0, atol=1e-15)
    np.testing.assert_allclose(motion.setpoint(15.0).position, -0.015 * direction, rtol=0, atol=1e-15)
    np.testing.assert_allclose(motion.setpoint(20.0).position, 0.0, atol=1e-15)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.0, -4.0), (1.0, 0.0, 0.0), (0.3, -1.0, 2.0)])
def test_a_circle_keeps_its_radius_its_plane_and_its_speed_and_turns_once_about_its_normal(normal):
    radius, period = 0.010, 20.0
    motion, axis = CircleMotion(radius=radius, period=period, normal=normal), np.array(normal) / np.linalg.norm(normal)
    # half a period after the start the setpoint is opposite the start
    centre = 0.5 * motion.setpoint(period / 2).position

    for time in TIMES:
        position, velocity = motion.setpoint(time)[:2]
        assert np.linalg.norm(position - centre) == pytest.approx(radius, rel=1e-12)
        assert position @ axis == pytest.approx(0.0, abs=1e-15)
        np.testing.assert_allclose(
            np.cross(position - centre, velocity), 2 * math.pi / period * radius**2 * axis, rtol=0, atol=1e-15
        )
    np.testing.assert_allclose(motion.setpoint(period).position, 0.0, atol=1e-15)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Waypoints((), ()), "waypoints: 0 times and 0 places"),
        (lambda: Waypoints((1.0, 2.0), ((0.0, 0.0, 0.0),)), "waypoints: 2 times and 1 places"),
        (lambda: Waypoints((1e-308,), ((0.0, 0.01, 0.0),)), "waypoints: 1e-308 s is less than 1 ms after 0 s"),
        (lambda: Waypoints((1.0, 1.0000001), ((0.0, 0.01, 0.0),) * 2), "waypoints: 1 s is less than 1 ms after 1 s"),
        (lambda: Waypoints((1.0, 1.0), ((0.0, 0.0, 0.0),) * 2), "waypoints: time 1 s must be after the time 1 s"),
        (lambda: Waypoints((0.0,), ((0.01, 0.0, 0.0),)), "give it a time above 0 s, so that the tip can get there"),
        (lambda: Waypoints((1.0,), ((0.0, math.nan, 0.0),)), "waypoints: number 1 at 1 s, (0.0, nan, 0.0) m"),
        (lambda: Waypoints((math.inf,), ((0.0, 0.0, 0.0),)), "waypoints: number 1 at inf s"),
        (lambda: Waypoints((0.1,), ((0.01, 0.0, 0.0),)), "give the points around it more time"),
    ],
)
def test_an_invalid_trajectory_is_refused_by_name_value_and_bound(make, words):
    with pytest.raises(DescriptionError) as refused:
        make()

    assert words in str(refused.value)


def test_tip_direction_trajectory_turns_about_one_axis_from_rest_to_rest():
    turning_path = Directions(((1.0, 0.0, 0.0, 2.0), (3.0, 1.0, 0.0, 0.0)))
    for time, expected in ((0.0, (0, 0, 1)), (1.0, (0, 0, 1)), (2.0, (0.5**0.5, 0, 0.5**0.5)), (9.0, (1, 0, 0))):
        np.testing.assert_allclose(turning_path.at(time)[0], expected, atol=1e-12)
    for time in (1.2, 1.9, 2.7):
        direction, turning = turning_path.at(time)
        rate = (turning_path.at(time + 1e-6)[0] - turning_path.at(time - 1e-6)[0]) / 2e-6
        np.testing.assert_allclose(np.cross(turning, direction), rate, atol=1e-8)
    assert not turning_path.at(3.5)[1].any()


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (((0.0, 0, 0, 1), (0.0, 1, 0, 0)), "ms or more after"),
        (((0.0, 0, 0, 1), (1.0, 0, 0, -1)), "opposite"),
        (((0.0, 0, 0, 0),), "no length"),
    ],
)
def test_invalid_tip_directions_are_refused(rows, message):
    with pytest.raises(DescriptionError, match=message):
        Directions(rows)


@pytest.mark.parametrize("size", [1e-300, 1e-10, 1e10, 1e160, 1e308])
def test_direction_whose_length_or_its_square_is_no_number_is_refused(size: float) -> None:
    with pytest.raises(DescriptionError, match="whose length is 1e-09"):
        Directions(((0.0, 0.0, 0.0, 1.0), (1.0, size, size, -size)))
