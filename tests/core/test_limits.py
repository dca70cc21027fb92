import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import DescriptionError, PoseError
from core.limits import JointLimit, Limits

DEGREE = math.pi / 180.0
SLIDE = JointLimit("inner_translation", "m", -0.130, -0.005, speed=0.020, acceleration=0.100)
TURN = JointLimit("outer_rotation", "rad", -2 * math.pi, 2 * math.pi, speed=20 * DEGREE, acceleration=100 * DEGREE)
LIMITS = Limits((TURN, SLIDE), reaction=0.050)

INSIDE = [share * (limit.upper - limit.lower) + limit.lower for limit, share in ((TURN, 0.5), (SLIDE, 0.5))]


def stop(position: float, velocity: float, acceleration: float, reaction: float) -> float:
    """Where a joint comes to rest that goes on for the reaction time and then brakes; by small steps."""
    dt = 1e-5
    position += velocity * reaction
    while velocity != 0.0:
        slower = math.copysign(max(abs(velocity) - acceleration * dt, 0.0), velocity)
        position += 0.5 * (velocity + slower) * dt
        velocity = slower
    return position


@pytest.mark.parametrize("limit", [TURN, SLIDE], ids=lambda limit: limit.name)
@pytest.mark.parametrize("reaction", [0.0, 0.050, 0.200])
@pytest.mark.parametrize("room", [0.0, 1e-3, 0.01, 0.05, 0.2])
def test_from_the_highest_velocity_allowed_a_joint_stops_inside_its_travel(limit, reaction, room):
    away = room * (limit.upper - limit.lower)
    limits = Limits((limit,), reaction)
    for place, side in ((limit.upper - away, 1), (limit.lower + away, 0)):
        velocity = limits.velocity_bounds(np.array([place]))[side][0]
        rest = stop(place, velocity, limit.acceleration, reaction)
        bound = limit.upper if side else limit.lower
        overshoot = (rest - bound) if side else (bound - rest)

        assert overshoot <= 1e-9
        # ... and nothing is given away: slower than top speed only when it must be.
        assert overshoot == pytest.approx(0.0, abs=1e-6) or abs(velocity) == limit.speed


@pytest.mark.parametrize("limit", [TURN, SLIDE], ids=lambda limit: limit.name)
def test_driven_at_the_bound_a_joint_that_answers_in_a_third_of_the_reaction_time_stays_inside(limit):
    limits, dt = Limits((limit,), reaction=0.060), 1e-3
    under_way = [0.0] * 20
    position, velocity, furthest = limit.upper - 0.5 * limit.speed, 0.0, -math.inf

    for _ in range(4000):
        under_way.append(limits.velocity_bounds(np.array([position]))[1][0])
        most = limit.acceleration * dt
        velocity += min(max(under_way.pop(0) - velocity, -most), most)
        position += velocity * dt
        furthest = max(furthest, position)

    assert limit.upper - 1e-3 * limit.speed < furthest <= limit.upper + 1e-12


def test_in_the_middle_of_its_travel_a_joint_may_go_at_top_speed_both_ways():
    lower, upper = LIMITS.velocity_bounds(np.array(INSIDE))

    np.testing.assert_allclose(upper, [20 * DEGREE, 0.020])
    np.testing.assert_allclose(lower, [-20 * DEGREE, -0.020])
    np.testing.assert_allclose(LIMITS.speed, [20 * DEGREE, 0.020])


def test_outside_its_travel_a_joint_may_only_come_back():
    lower, upper = LIMITS.velocity_bounds(np.array([-7.0, 0.010]))

    assert lower[0] == 0.0
    assert upper[0] == 20 * DEGREE
    assert upper[1] == 0.0
    assert lower[1] == -0.020


def test_a_position_that_is_not_a_number_gives_no_leave_to_move():
    lower, upper = LIMITS.velocity_bounds(np.array([math.nan, math.nan]))

    assert not (lower < 0.0).any()
    assert not (upper > 0.0).any()


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ([0.0, -0.150], ["inner_translation", "-0.15 m", "-0.13 ... -0.005 m", "travel"]),
        ([0.0, 0.0], ["inner_translation", "0 m", "-0.13 ... -0.005 m"]),
        ([6.5, -0.1], ["outer_rotation", "6.5 rad", "-6.283 ... 6.283 rad"]),
        ([math.nan, -0.1], ["outer_rotation", "nan rad"]),
        ([0.0, math.inf], ["inner_translation", "inf m"]),
    ],
)
def test_a_position_outside_its_travel_is_refused_by_name_value_and_bound(joints, words):
    with pytest.raises(PoseError) as refused:
        LIMITS.check(np.array(joints))

    for word in words:
        assert word in str(refused.value)


@pytest.mark.parametrize("joints", [[0.0, -0.130], [2 * math.pi, -0.005], INSIDE])
def test_the_travel_includes_its_ends(joints):
    LIMITS.check(np.array(joints))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lower": -0.005, "upper": -0.130}, "travel -0.005 ... -0.13 m is empty"),
        ({"lower": -0.005}, "travel -0.005 ... -0.005 m is empty"),
        ({"upper": math.nan}, "travel -0.13 ... nan m"),
        ({"lower": -math.inf}, "travel -inf ... -0.005 m"),
        ({"speed": 0.0}, "speed limit 0 m/s must be greater than 0"),
        ({"speed": math.nan}, "speed limit nan m/s"),
        ({"acceleration": -0.1}, "acceleration limit -0.1 m/s^2 must be greater than 0"),
        ({"acceleration": math.inf}, "acceleration limit inf m/s^2"),
    ],
)
def test_an_impossible_limit_is_refused_by_name_value_and_unit(change, words):
    with pytest.raises(DescriptionError) as refused:
        replace(SLIDE, **change)

    assert f"inner_translation: {words}" in str(refused.value)


@pytest.mark.parametrize("reaction", [-0.010, math.nan, math.inf])
def test_a_reaction_time_that_is_none_is_refused(reaction):
    with pytest.raises(DescriptionError, match=rf"reaction {reaction:g} s"):
        Limits((SLIDE,), reaction)
