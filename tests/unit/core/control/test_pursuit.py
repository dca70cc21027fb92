import numpy as np
import pytest

from core.control.predictor import Place
from core.control.pursuit import Pursuit
from core.errors import DescriptionError

PERIOD = 0.002
REST = Place(np.zeros(3), np.zeros(3))


def breathing(time: float) -> Place:
    """An ellipse about a place 30 mm away, and its exact velocity."""
    w = 2.0 * np.pi * 0.25
    at = np.array([0.03, 0.0, 0.0]) + 1e-3 * np.array([5.0 * np.sin(w * time), 0.0, 2.0 * np.cos(w * time)])
    return Place(at, 1e-3 * w * np.array([5.0 * np.cos(w * time), 0.0, -2.0 * np.sin(w * time)]))


def run(pursuit, goals, start=REST):
    places = [start]
    for goal in goals:
        places.append(pursuit.step(places[-1], goal, PERIOD))
    return np.array([place.position for place in places]), np.array([place.velocity for place in places])


def check_bounds(pursuit, positions, velocities):
    assert np.linalg.norm(velocities, axis=1).max() <= pursuit.max_speed * (1.0 + 1e-9)
    assert np.linalg.norm(np.diff(velocities, axis=0), axis=1).max() <= pursuit.max_acceleration * PERIOD * (1.0 + 1e-9)
    # What is told as its velocity is how it moves.
    np.testing.assert_allclose(
        np.diff(positions, axis=0), 0.5 * PERIOD * (velocities[1:] + velocities[:-1]), atol=1e-15
    )


def test_it_reaches_a_moving_goal_and_stays_on_it_without_lag():
    pursuit, times = Pursuit(0.02, 0.1), PERIOD * np.arange(1, 5001)

    positions, velocities = run(pursuit, map(breathing, times))

    check_bounds(pursuit, positions, velocities)
    goals = np.array([breathing(time).position for time in times])
    assert np.linalg.norm(positions[1:] - goals, axis=1)[2500:].max() < 2e-5


def test_it_stops_at_a_goal_that_stands_without_passing_it():
    pursuit, goal = Pursuit(0.02, 0.1), Place(np.array([0.0, 0.02, 0.0]), np.zeros(3))

    positions, velocities = run(pursuit, [goal] * 3000)

    check_bounds(pursuit, positions, velocities)
    assert positions[:, 1].max() <= 0.02 + 1e-6
    assert positions[-1, 1] == pytest.approx(0.02, abs=1e-6)


def test_without_a_goal_it_comes_to_rest_and_stays_there():
    pursuit = Pursuit(0.02, 0.1)

    positions, velocities = run(pursuit, [None] * 500, Place(np.zeros(3), np.array([0.02, 0.0, 0.0])))

    check_bounds(pursuit, positions, velocities)
    assert positions[-1, 0] == pytest.approx(0.02**2 / (2 * 0.1), rel=0.02)  # v^2 / 2a
    assert not velocities[-1].any()


def test_a_goal_that_jumps_a_metre_is_gone_after_at_the_bounds():
    pursuit, far = Pursuit(0.02, 0.1), Place(np.array([1.0, 0.0, 0.0]), np.zeros(3))

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
def test_bounds_that_are_none_are_refused_by_name(bad):
    with pytest.raises(DescriptionError, match=next(iter(bad))):
        Pursuit(**{"max_speed": 0.02, "max_acceleration": 0.1, **bad})


def test_it_stops_before_its_reach_and_slides_along_it():
    pursuit = Pursuit(0.02, 0.1, reach=0.03)
    outside = Place(np.array([0.05, 0.0, 0.0]), np.zeros(3))

    positions, velocities = run(pursuit, [outside] * 2500)
    check_bounds(pursuit, positions, velocities)
    assert 0.0299 < positions[-1, 0] <= 0.03 + 1e-9

    aside = Place(np.array([0.05, 0.05, 0.0]), np.zeros(3))
    positions, _ = run(pursuit, [aside] * 5000, Place(positions[-1], velocities[-1]))
    assert np.linalg.norm(positions, axis=1).max() <= 0.03 + 1e-4  # it turns with a bounded acceleration
    assert positions[-1] == pytest.approx(np.array([0.5, 0.5, 0.0]) * 0.03 * np.sqrt(2.0), abs=1e-4)


def test_going_round_along_its_reach_does_not_carry_it_away():
    pursuit = Pursuit(0.02, 0.1, reach=0.02)
    turns = [Place(0.04 * np.array([np.cos(t), np.sin(t), 0.0]), np.zeros(3)) for t in np.arange(0.0, 60.0, 2e-3)]

    positions, _ = run(pursuit, turns)

    away = np.linalg.norm(positions, axis=1)[10_000:]
    assert away.max() <= 0.02 + 2e-4
    assert away[-1000:].max() == pytest.approx(away[:5000].max(), abs=2e-5)
