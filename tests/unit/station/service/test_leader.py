"""What one who leads the tip may say, and what becomes of it."""

import math

import numpy as np
import pytest

from station.service.leader import BURST, FASTEST, Leader, LeadIn, NotTaken, TooFast

POINTING = {"task": "position_and_direction"}
START = np.array([0.01, 0.02, 0.15])


def leader(**asked) -> Leader:
    return Leader(LeadIn(**asked), START, 0.0)


@pytest.mark.parametrize("told", [(0.0, math.nan, 0.0), (math.inf, 0.0, 0.0), (0.0, 0.0), (0.0,) * 4, ()])
def test_what_is_not_three_finite_numbers_is_not_taken(told):
    for say in (leader().place, leader().velocity):
        with pytest.raises(NotTaken, match="three finite numbers"):
            say(told, 0.1)


def test_a_jump_of_a_metre_is_not_taken_and_says_how_far_one_may_go():
    with pytest.raises(NotTaken, match=r"1000 mm from the start, beyond the reach of 50 mm"):
        leader().place((1.0, 0.0, 0.0), 0.1)


def test_places_beyond_all_measure_are_not_taken_either():
    with pytest.raises(NotTaken, match=r"1e\+308.*inf mm from the start"):
        leader().place((1e308, 1e308, -1e308), 0.1)


def test_a_long_list_is_not_told_back():
    with pytest.raises(NotTaken, match="tip of 20000 numbers: three finite numbers are needed"):
        leader().place((0.0,) * 20_000, 0.1)


def test_in_the_world_places_are_told_from_the_worlds_origin():
    place = leader(frame="world").place((0.012, 0.02, 0.15), 0.1).place
    assert place == pytest.approx([0.002, 0.0, 0.0])


@pytest.mark.parametrize("rate", [10.0, 50.0, 500.0])
def test_places_have_the_velocity_of_their_line_although_they_come_unevenly(rate):
    rng, one, speed = np.random.default_rng(1), leader(), np.array([0.004, -0.003, 0.001])
    wish = None
    for k in range(90):
        arrived = (k + 0.3 * rng.random()) / rate
        wish = one.place(tuple(speed * k / rate), arrived)
    assert wish is not None
    assert wish.velocity == pytest.approx(speed, rel=0.4)
    assert wish.goes_on == pytest.approx(min(max(2.5 / rate, 0.05), 0.2), rel=0.25)


def test_what_is_held_up_on_its_way_counts_by_the_senders_own_time():
    rng, one, speed = np.random.default_rng(2), leader(), np.array([0.004, -0.003, 0.001])
    for k in range(90):
        sent, arrived = 1e6 + 0.02 * k, 0.02 * k + 0.001 + 0.05 * rng.random() * (k % 3 > 0)
        wish = one.place(tuple(speed * 0.02 * k), arrived, sent)
        assert wish.asked == pytest.approx(0.02 * k + 0.001, abs=1e-3)
        assert wish.asked <= arrived
    assert wish.velocity == pytest.approx(speed, rel=0.02)


@pytest.mark.parametrize("sent", [1e300, -1e300, 0.0])
def test_a_senders_clock_that_was_set_is_believed_from_there_on(sent):
    one = leader()
    one.place((0.0, 0.0, 0.0), 1.0, 50.0)
    for k in range(5):
        wish = one.place((0.0, 0.0, 0.0), 1.1 + 0.02 * k, sent)
        assert 1.0 <= wish.asked <= 1.1 + 0.02 * k
        assert 1.1 + 0.02 * k - wish.asked <= 0.1 + 1e-9
    for k in range(5):
        assert one.place((0.0, 0.0, 0.0), 1.3 + 0.02 * k, 70.0 + 0.02 * k).asked == pytest.approx(1.3 + 0.02 * k)


def test_the_first_place_and_one_after_a_pause_stand_still():
    one = leader()
    assert one.place((0.001, 0.0, 0.0), 0.0).velocity == pytest.approx(np.zeros(3))
    one.place((0.002, 0.0, 0.0), 0.02)
    assert one.place((0.010, 0.0, 0.0), 5.0).velocity == pytest.approx(np.zeros(3))


def test_as_many_messages_as_may_come_are_taken_and_ten_thousand_a_second_are_not():
    one = leader()
    for k in range(5000):
        one.count(k / FASTEST)
    quick = leader()
    taken = round(BURST * 10_000.0 / (10_000.0 - FASTEST))  # what comes on top of the burst meanwhile
    for k in range(taken - 1):
        quick.count(k / 10_000.0)
    with pytest.raises(TooFast, match="500 messages a second"):
        _all(quick, taken)


def _all(quick: Leader, begin: int) -> None:
    for k in range(begin, begin + 3):
        quick.count(k / 10_000.0)


@pytest.mark.parametrize(
    "told", [(0.0, 0.0, 2.0), (0.0, 0.0, 3e-9), (0.0, 0.0, 1e308), (1e308, 1e308, 1e308), (3, -4, 12)]
)
def test_a_direction_counts_whatever_its_length(told):
    direction = leader(controller=POINTING).place((0.0, 0.0, 0.0), 0.1, direction=told).direction
    assert direction is not None
    scaled = np.array(told) / np.abs(told).max()
    assert direction == pytest.approx(scaled / np.linalg.norm(scaled))


def test_the_direction_told_last_stands_and_there_is_none_before():
    one = leader(controller=POINTING)
    assert one.place((0.0, 0.0, 0.0), 0.1).direction is None
    assert one.velocity((0.0, 0.0, 0.0), 0.2).direction is None
    one.place((0.0, 0.0, 0.0), 0.3, direction=(2.0, 0.0, 0.0))
    for wish in (one.place((0.0, 0.0, 0.001), 0.4), one.velocity((0.0, 0.0, 0.001), 0.5)):
        assert wish.direction is not None
        assert wish.direction.tolist() == [1.0, 0.0, 0.0]


def test_directions_are_told_in_the_world_whatever_places_are():
    for frame, place in (("start", (0.0, 0.0, 0.0)), ("world", tuple(START))):
        wish = leader(frame=frame, controller=POINTING).place(place, 0.1, direction=(0.0, 1.0, 0.0))
        assert wish.direction is not None
        assert wish.direction.tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize(
    ("told", "reason"),
    [
        ((0.0, 0.0, 0.0), r"direction \[0.0, 0.0, 0.0\] has the length 0, shorter than 1e-09"),
        ((1e-10, 0.0, 0.0), r"direction \[1e-10, 0.0, 0.0\] has the length 1e-10, shorter than 1e-09"),
        ((math.nan, 0.0, 1.0), r"direction \[nan, 0.0, 1.0\]: three finite numbers are needed"),
        ((0.0, -math.inf, 1.0), r"direction \[0.0, -inf, 1.0\]: three finite numbers are needed"),
        ((0.0, 1.0), "direction of 2 numbers: three finite numbers are needed"),
        ((), "direction of 0 numbers"),
    ],
)
def test_what_is_no_direction_is_not_taken_and_nothing_of_its_message_is(told, reason):
    one = leader(controller=POINTING)
    one.place((0.0, 0.0, 0.0), 0.0, direction=(0.0, 0.0, 1.0))
    with pytest.raises(NotTaken, match=reason + ".*before it stands"):
        one.place((0.010, 0.0, 0.0), 0.02, direction=told)
    wish = one.place((0.0, 0.0, 0.0), 0.04)
    assert wish.velocity == pytest.approx(np.zeros(3))
    assert wish.direction is not None
    assert wish.direction.tolist() == [0.0, 0.0, 1.0]


def test_the_direction_beside_a_place_beyond_the_reach_is_not_taken_either():
    one = leader(controller=POINTING)
    with pytest.raises(NotTaken, match="beyond the reach"):
        one.place((1.0, 0.0, 0.0), 0.1, direction=(1.0, 0.0, 0.0))
    assert one.place((0.0, 0.0, 0.0), 0.2).direction is None


def test_a_direction_is_not_taken_where_only_the_place_is_controlled_and_what_to_do_is_said():
    with pytest.raises(NotTaken, match=r'begin it with controller\.task = "position_and_direction"'):
        leader().place((0.0, 0.0, 0.0), 0.1, direction=(0.0, 0.0, 1.0))


def test_the_direction_turns_as_fast_as_was_agreed():
    assert LeadIn(turning=0.4).lead().turning.max_speed == 0.4
    assert LeadIn().lead().turning.max_speed == 0.2


@pytest.mark.parametrize(
    "wrong",
    [
        {"turning": 0.0},
        {"turning": 1.1},
        {"turning": math.nan},
        {"speed": 0.0},
        {"speed": math.nan},
        {"reach": 1.0},
        {"frame": "tip"},
        {"silence": 10.0},
        {"what": 1},
    ],
)
def test_what_one_agrees_to_has_bounds(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        LeadIn(**wrong)
