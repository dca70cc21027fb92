"""Conversion of a streaming client's messages to setpoint requests, and refusals of invalid messages."""

import math

import numpy as np
import pytest

from station.service.commands import StreamAgreement
from station.service.setpoint_stream import MAX_BURST, MAX_RATE_HZ, RateExceeded, SetpointRefused, SetpointStream

POINTING = {"task": "position_and_direction"}
START = np.array([0.01, 0.02, 0.15])


def new_stream(**options) -> SetpointStream:
    return SetpointStream(StreamAgreement(**options), START, 0.0)


@pytest.mark.parametrize("numbers", [(0.0, math.nan, 0.0), (math.inf, 0.0, 0.0), (0.0, 0.0), (0.0,) * 4, ()])
def test_streamed_setpoint_that_is_not_three_finite_numbers_is_refused(numbers):
    for send in (new_stream().position, new_stream().velocity):
        with pytest.raises(SetpointRefused, match="three finite numbers"):
            send(numbers, 0.1)


def test_error_for_a_streamed_position_beyond_the_reach_has_the_reach():
    with pytest.raises(SetpointRefused, match=r"1000 mm from the start, beyond the reach of 50 mm"):
        new_stream().position((1.0, 0.0, 0.0), 0.1)


def test_streamed_position_whose_distance_overflows_is_refused():
    with pytest.raises(SetpointRefused, match=r"1e\+308.*inf mm from the start"):
        new_stream().position((1e308, 1e308, -1e308), 0.1)


def test_error_for_a_setpoint_with_many_numbers_does_not_repeat_them():
    with pytest.raises(SetpointRefused, match="tip of 20000 numbers: three finite numbers are needed"):
        new_stream().position((0.0,) * 20_000, 0.1)


def test_streamed_positions_in_frame_world_are_relative_to_the_world_origin():
    position = new_stream(frame="world").position((0.012, 0.02, 0.15), 0.1).position
    assert position == pytest.approx([0.002, 0.0, 0.0])


@pytest.mark.parametrize("rate", [10.0, 50.0, 500.0])
def test_stream_velocity_is_right_for_positions_on_a_line_at_uneven_intervals(rate):
    rng, stream, speed = np.random.default_rng(1), new_stream(), np.array([0.004, -0.003, 0.001])
    request = None
    for k in range(90):
        arrived = (k + 0.3 * rng.random()) / rate
        request = stream.position(tuple(speed * k / rate), arrived)
    assert request is not None
    assert request.velocity == pytest.approx(speed, rel=0.4)
    assert request.extrapolation == pytest.approx(min(max(2.5 / rate, 0.05), 0.2), rel=0.25)


@pytest.mark.parametrize("sent", [1e300, -1e300, 0.0])
def test_transport_delay_is_compensated_again_after_the_senders_clock_was_set(sent):
    stream = new_stream()
    stream.position((0.0, 0.0, 0.0), 1.0, 50.0)
    for k in range(5):
        request = stream.position((0.0, 0.0, 0.0), 1.1 + 0.02 * k, sent)
        assert 1.0 <= request.time <= 1.1 + 0.02 * k
        assert 1.1 + 0.02 * k - request.time <= 0.1 + 1e-9
    for k in range(5):
        assert stream.position((0.0, 0.0, 0.0), 1.3 + 0.02 * k, 70.0 + 0.02 * k).time == pytest.approx(1.3 + 0.02 * k)


def test_streamed_position_at_the_start_or_after_a_pause_has_no_velocity():
    stream = new_stream()
    assert stream.position((0.001, 0.0, 0.0), 0.0).velocity == pytest.approx(np.zeros(3))
    stream.position((0.002, 0.0, 0.0), 0.02)
    assert stream.position((0.010, 0.0, 0.0), 5.0).velocity == pytest.approx(np.zeros(3))


def test_simultaneous_positions_of_a_stream_have_no_velocity():
    stream = new_stream()
    for k in range(20):
        request = stream.position((0.0005 * (k % 3), 0.0, 0.0), 0.1 + 1e-6 * k)
        assert not request.velocity.any()


def test_stream_velocity_comes_from_the_newest_message_of_each_bunch():
    stream, speed = new_stream(), np.array([0.004, -0.003, 0.001])
    for k in range(60):
        # The client sends 50 positions a second, which arrive in bunches of three.
        arrived = 0.06 * (k // 3) + 1e-5 * (k % 3)
        request = stream.position(tuple(speed * 0.02 * k), arrived)
        if k % 3 == 2 and k > 5:
            assert request.velocity == pytest.approx(speed, rel=0.01)
            # The last three bunches arrived within the window of the velocity.
            assert request.extrapolation == pytest.approx(0.12, rel=0.01)


def test_stream_velocity_and_extrapolation_stay_within_their_bounds():
    stream = new_stream(speed=0.01)
    for k in range(20):
        request = stream.position((0.02 * (k % 2), 0.0, 0.0), 0.02 * k)
        assert math.hypot(*request.velocity) <= 0.01 * (1.0 + 1e-9)
        assert math.hypot(*request.velocity) * request.extrapolation <= 0.02 + 1e-9
    for requested in ((1e308, 1e308, 0.0), (0.0, 0.03, 0.04), (5e-324, 0.0, 0.0)):
        request = stream.velocity(requested, 1.0)
        assert math.hypot(*request.velocity) == pytest.approx(min(0.01, math.hypot(*requested)))


def test_receiver_clock_that_goes_back_counts_as_stopped_for_a_stream():
    stream = new_stream()
    stream.position((0.001, 0.0, 0.0), 1.0)
    for request in (stream.position((0.002, 0.0, 0.0), 0.5), stream.velocity((0.0, 0.0, 0.001), 0.4)):
        assert request.time == 1.0
        assert math.hypot(*request.velocity) <= 0.02


def test_stream_messages_that_waited_on_a_busy_computer_do_not_exceed_the_rate():
    stream, now = new_stream(), 0.0
    for _ in range(3):
        now += 3.0
        for _ in range(round(450.0 * 3.0)):
            stream.count(now)


def test_stream_messages_up_to_the_largest_rate_are_accepted_and_faster_ones_refused():
    stream = new_stream()
    for k in range(5000):
        stream.count(k / MAX_RATE_HZ)
    quick = new_stream()
    # The expected number of accepted messages includes the initial burst.
    taken = round(MAX_BURST * 10_000.0 / (10_000.0 - MAX_RATE_HZ))
    for k in range(taken - 1):
        quick.count(k / 10_000.0)
    with pytest.raises(RateExceeded, match="500 messages a second"):
        _all(quick, taken)


def _all(quick: SetpointStream, first: int) -> None:
    for k in range(first, first + 3):
        quick.count(k / 10_000.0)


@pytest.mark.parametrize(
    "direction_sent", [(0.0, 0.0, 2.0), (0.0, 0.0, 3e-9), (0.0, 0.0, 1e308), (1e308, 1e308, 1e308), (3, -4, 12)]
)
def test_streamed_direction_of_any_length_becomes_a_unit_vector(direction_sent):
    direction = new_stream(controller=POINTING).position((0.0, 0.0, 0.0), 0.1, direction=direction_sent).direction
    assert direction is not None
    scaled = np.array(direction_sent) / np.abs(direction_sent).max()
    assert direction == pytest.approx(scaled / np.linalg.norm(scaled))


def test_latest_streamed_direction_remains_and_is_none_before_the_first():
    stream = new_stream(controller=POINTING)
    assert stream.position((0.0, 0.0, 0.0), 0.1).direction is None
    assert stream.velocity((0.0, 0.0, 0.0), 0.2).direction is None
    stream.position((0.0, 0.0, 0.0), 0.3, direction=(2.0, 0.0, 0.0))
    for request in (stream.position((0.0, 0.0, 0.001), 0.4), stream.velocity((0.0, 0.0, 0.001), 0.5)):
        assert request.direction is not None
        assert request.direction.tolist() == [1.0, 0.0, 0.0]


def test_streamed_directions_are_in_the_world_frame_for_every_frame_of_positions():
    for frame, position in (("start", (0.0, 0.0, 0.0)), ("world", tuple(START))):
        request = new_stream(frame=frame, controller=POINTING).position(position, 0.1, direction=(0.0, 1.0, 0.0))
        assert request.direction is not None
        assert request.direction.tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize(
    ("direction_sent", "reason"),
    [
        ((0.0, 0.0, 0.0), r"direction \[0.0, 0.0, 0.0\] has the length 0, shorter than 1e-09"),
        ((1e-10, 0.0, 0.0), r"direction \[1e-10, 0.0, 0.0\] has the length 1e-10, shorter than 1e-09"),
        ((math.nan, 0.0, 1.0), r"direction \[nan, 0.0, 1.0\]: three finite numbers are needed"),
        ((0.0, -math.inf, 1.0), r"direction \[0.0, -inf, 1.0\]: three finite numbers are needed"),
        ((0.0, 1.0), "direction of 2 numbers: three finite numbers are needed"),
        ((), "direction of 0 numbers"),
    ],
)
def test_setpoint_with_an_invalid_direction_is_refused_as_a_whole(direction_sent, reason):
    stream = new_stream(controller=POINTING)
    stream.position((0.0, 0.0, 0.0), 0.0, direction=(0.0, 0.0, 1.0))
    with pytest.raises(SetpointRefused, match=reason + ".*the previous setpoint remains"):
        stream.position((0.010, 0.0, 0.0), 0.02, direction=direction_sent)
    request = stream.position((0.0, 0.0, 0.0), 0.04)
    assert request.velocity == pytest.approx(np.zeros(3))
    assert request.direction is not None
    assert request.direction.tolist() == [0.0, 0.0, 1.0]


def test_streamed_direction_is_refused_together_with_a_position_beyond_the_reach():
    stream = new_stream(controller=POINTING)
    with pytest.raises(SetpointRefused, match="beyond the reach"):
        stream.position((1.0, 0.0, 0.0), 0.1, direction=(1.0, 0.0, 0.0))
    assert stream.position((0.0, 0.0, 0.0), 0.2).direction is None


def test_streamed_direction_is_refused_if_only_the_position_is_controlled():
    with pytest.raises(SetpointRefused, match=r'start the stream with controller\.task = "position_and_direction"'):
        new_stream().position((0.0, 0.0, 0.0), 0.1, direction=(0.0, 0.0, 1.0))


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
def test_stream_option_out_of_range_is_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        StreamAgreement(**wrong)
