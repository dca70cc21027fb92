import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.control.motion_bounds import MotionBounds
from core.control.predictor import TargetState
from core.errors import DescriptionError

PERIOD = 0.002
REST = TargetState(np.zeros(3), np.zeros(3))


def breathing(time: float) -> TargetState:
    """Return the position and exact velocity of a target that moves along an ellipse about a point 30 mm away."""
    w = 2.0 * np.pi * 0.25
    at = np.array([0.03, 0.0, 0.0]) + 1e-3 * np.array([5.0 * np.sin(w * time), 0.0, 2.0 * np.cos(w * time)])
    return TargetState(at, 1e-3 * w * np.array([5.0 * np.cos(w * time), 0.0, -2.0 * np.sin(w * time)]))


def run(pursuit, goals, start=REST):
    places = [start]
    for goal in goals:
        places.append(pursuit.step(places[-1], goal, PERIOD))
    return np.array([place.position for place in places]), np.array([place.velocity for place in places])


def check_bounds(pursuit, positions, velocities):
    assert np.linalg.norm(velocities, axis=1).max() <= pursuit.max_speed * (1.0 + 1e-9)
    assert np.linalg.norm(np.diff(velocities, axis=0), axis=1).max() <= pursuit.max_acceleration * PERIOD * (1.0 + 1e-9)
    # The reported velocity is the actual velocity of the setpoint.
    np.testing.assert_allclose(
        np.diff(positions, axis=0), 0.5 * PERIOD * (velocities[1:] + velocities[:-1]), atol=1e-15
    )


def test_setpoint_reaches_a_moving_goal_and_follows_it_without_lag():
    pursuit, times = MotionBounds(0.02, 0.1), PERIOD * np.arange(1, 5001)

    positions, velocities = run(pursuit, map(breathing, times))

    check_bounds(pursuit, positions, velocities)
    goals = np.array([breathing(time).position for time in times])
    assert np.linalg.norm(positions[1:] - goals, axis=1)[2500:].max() < 2e-5


def test_setpoint_stops_at_a_stationary_goal_without_overshoot():
    pursuit, goal = MotionBounds(0.02, 0.1), TargetState(np.array([0.0, 0.02, 0.0]), np.zeros(3))

    positions, velocities = run(pursuit, [goal] * 3000)

    check_bounds(pursuit, positions, velocities)
    assert positions[:, 1].max() <= 0.02 + 1e-6
    assert positions[-1, 1] == pytest.approx(0.02, abs=1e-6)


def test_setpoint_without_a_goal_comes_to_rest_and_stays_there():
    pursuit = MotionBounds(0.02, 0.1)

    positions, velocities = run(pursuit, [None] * 500, TargetState(np.zeros(3), np.array([0.02, 0.0, 0.0])))

    check_bounds(pursuit, positions, velocities)
    assert positions[-1, 0] == pytest.approx(0.02**2 / (2 * 0.1), rel=0.02)  # v^2 / 2a
    assert not velocities[-1].any()


def test_setpoint_follows_a_goal_that_jumps_a_metre_within_its_motion_bounds():
    pursuit, far = MotionBounds(0.02, 0.1), TargetState(np.array([1.0, 0.0, 0.0]), np.zeros(3))

    positions, velocities = run(pursuit, [REST] * 10 + [far] * 1000)

    check_bounds(pursuit, positions, velocities)
    assert velocities[-1, 0] == pytest.approx(0.02)


@pytest.mark.parametrize(
    "bad",
    [
        {"max_speed": 0.0},
        {"max_acceleration": -1.0},
        {"rate": float("nan")},
        {"max_speed": float("inf")},
        {"braking": 1.1},
        {"reach": 0.0},
    ],
)
def test_invalid_motion_bounds_are_refused_by_name(bad):
    with pytest.raises(DescriptionError, match=next(iter(bad))):
        MotionBounds(**{"max_speed": 0.02, "max_acceleration": 0.1, **bad})


def test_setpoint_stops_before_its_reach_and_slides_along_it():
    pursuit = MotionBounds(0.02, 0.1, reach=0.03)
    outside = TargetState(np.array([0.05, 0.0, 0.0]), np.zeros(3))

    positions, velocities = run(pursuit, [outside] * 2500)
    check_bounds(pursuit, positions, velocities)
    assert 0.0299 < positions[-1, 0] <= 0.03 + 1e-9

    aside = TargetState(np.array([0.05, 0.05, 0.0]), np.zeros(3))
    positions, _ = run(pursuit, [aside] * 5000, TargetState(positions[-1], velocities[-1]))
    # the setpoint turns with a bounded acceleration, so it may exceed the reach by 0.1 mm
    assert np.linalg.norm(positions, axis=1).max() <= 0.03 + 1e-4
    assert positions[-1] == pytest.approx(np.array([0.5, 0.5, 0.0]) * 0.03 * np.sqrt(2.0), abs=1e-4)


def test_setpoint_that_circles_along_its_reach_does_not_drift_outward():
    pursuit = MotionBounds(0.02, 0.1, reach=0.02)
    turns = [TargetState(0.04 * np.array([np.cos(t), np.sin(t), 0.0]), np.zeros(3)) for t in np.arange(0.0, 60.0, 2e-3)]

    positions, _ = run(pursuit, turns)

    away = np.linalg.norm(positions, axis=1)[10_000:]
    assert away.max() <= 0.02 + 2e-4
    assert away[-1000:].max() == pytest.approx(away[:5000].max(), abs=2e-5)


@given(
    speed=st.floats(1e-3, 0.1),
    acceleration=st.floats(1e-3, 1.0),
    reach=st.floats(1e-3, 0.2),
    seed=st.integers(0, 2**32),
    moving=st.booleans(),
)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_setpoint_never_leaves_its_reach_for_any_goal_and_bounds(speed, acceleration, reach, seed, moving):
    pursuit, random = MotionBounds(speed, acceleration, 20.0, 0.8, reach), np.random.default_rng(seed)
    goals = []
    for _ in range(30):
        place, velocity = random.normal(size=(2, 3))
        place *= reach * random.uniform(0.5, 1.5) / np.linalg.norm(place)
        velocity *= moving * speed / np.linalg.norm(velocity)
        goals += [TargetState(place, velocity)] * int(random.integers(1, 60))

    positions, velocities = run(pursuit, goals)

    check_bounds(pursuit, positions, velocities)
    # The setpoint can stop only at the end of a period, not within a period.
    assert np.linalg.norm(positions, axis=1).max() <= 1.0001 * reach + acceleration * PERIOD**2
