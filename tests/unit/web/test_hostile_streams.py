"""Bounds of the control loop's setpoint under hostile setpoint streams, by WebSocket and by OpenIGTLink."""

import json
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyigtl.messages import TransformMessage

from core.control.setpoint_request import SetpointRequest
from core.robot.robot import Array
from station.control.task import StreamedMotion, StreamRequest
from station.service.commands import StreamAgreement
from station.service.setpoint_stream import MAX_EXTRAPOLATION_S, SetpointRefused, SetpointStream
from web.api.setpoints import _setpoint_request
from web.gateway.igtl import HEADER_BYTES, parse_head, parse_target

PERIOD = 0.002
#: Factor on the shortest braking distance, because a tip that turns while it brakes needs more.
TURNING = 1.5
EXAMPLES = 25


class Sent(NamedTuple):
    """One setpoint message of a stream."""

    arrives: float  #: time of arrival [s]
    tip: tuple[float, float, float]  #: requested position of the tip [m]
    time: float | None  #: time that the sender claims [s]; None: the sender gave none


Door = Callable[[SetpointStream, Sent], SetpointRequest]


def by_websocket(leader: SetpointStream, sent: Sent) -> SetpointRequest:
    message = {"tip": list(sent.tip)} if sent.time is None else {"tip": list(sent.tip), "time": sent.time}
    return _setpoint_request(leader, json.loads(json.dumps(message)), sent.arrives)


def by_igtl(leader: SetpointStream, sent: Sent) -> SetpointRequest:
    matrix = np.eye(4)
    matrix[:3, 3] = 1e3 * np.array(sent.tip)
    # The time of an OpenIGTLink message is a non-negative fixed-point number of seconds; 0 means no time.
    told = 0.0 if sent.time is None else min(max(sent.time, 0.0), 4e9)
    data = TransformMessage(matrix, device_name="Target", timestamp=told).pack()
    head = parse_head(data[:HEADER_BYTES])
    place = parse_target(head, data[HEADER_BYTES:])
    assert place is not None
    x, y, z = place.tolist()
    return leader.position((x, y, z), sent.arrives, head.time or None)


DOORS: dict[str, Door] = {"websocket": by_websocket, "igtl": by_igtl}


def followed(door: Door, asked: StreamAgreement, stream: Sequence[Sent]) -> Array:
    """Return positions (k, 3) of the setpoint, from the start until it rests after the last message."""
    leader, motion = SetpointStream(asked, np.zeros(3), 0.0), StreamedMotion(asked.limits(), 0.0, PERIOD)
    positions, wish, left = [np.zeros(3)], None, list(stream)
    for k in range(math.ceil((stream[-1].arrives + asked.silence + 0.5) / PERIOD)):
        while left and left[0].arrives <= PERIOD * k:
            try:
                wish = door(leader, left.pop(0))
            except SetpointRefused:
                continue
        setpoint = motion.order(PERIOD * k, 0.0, None if wish is None else StreamRequest(1, wish))
        if setpoint is None:
            break
        positions.append(setpoint.position)
    return np.array(positions)


def beyond(positions: Array, sent: Array) -> float:
    """Return how far positions leave the convex hull of start and sent positions [m], tested in 200 directions."""
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    hull = np.maximum((sent @ directions.T).max(axis=0), 0.0)
    return float(((positions @ directions.T).max(axis=0) - hull).max())


def allowed(asked: StreamAgreement, sent: Array) -> float:
    """Return the allowed distance beyond the sent positions [m]: extrapolation and braking distance."""
    apart = float(np.linalg.norm(sent[:, None] - sent[None], axis=2).max())
    return min(asked.speed * MAX_EXTRAPOLATION_S, apart) + TURNING * asked.speed**2 / (2.0 * asked.acceleration)


@st.composite
def streams(draw: st.DrawFn) -> list[Sent]:
    """Draw bunches of messages with jitter and gaps, in any order, with missing, correct or false times."""
    size = draw(st.sampled_from([1e-4, 1e-3, 1e-2, 2.8e-2]))
    offset = draw(st.sampled_from([0.0, 1e6, -1e6, 1e300]))
    clock = draw(st.sampled_from(["none", "right", "now and then", "lies"]))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    now, stream = 0.1, list[Sent]()
    for _ in range(draw(st.integers(2, 12))):
        now += draw(st.sampled_from([1e-6, 1e-3, 0.004, 0.006, 0.02, 0.04, 0.1, 0.18, 0.21, 0.5])) * random.uniform(
            0.9, 1.1
        )
        apart = draw(st.sampled_from([0.0, 1e-9, 1e-6, 1e-4, 2e-3, 5.1e-3]))
        bunch = []
        for _ in range(draw(st.integers(1, 20))):
            now += apart
            x, y, z = random.uniform(-size, size, 3).tolist()
            lie = float(random.choice([1e300, -1e300, now, now + random.normal(), 0.0, 1e-9 * random.random()]))
            right = offset + now
            told = {"none": None, "right": right, "now and then": random.choice([None, right]), "lies": lie}[clock]
            bunch.append(Sent(now, (x, y, z), told))
        order = random.permutation(len(bunch)) if draw(st.booleans()) else range(len(bunch))
        stream += [Sent(one.arrives, bunch[k].tip, bunch[k].time) for one, k in zip(bunch, order, strict=True)]
    return stream


@pytest.mark.parametrize("door", DOORS)
@given(stream=streams(), speed=st.sampled_from([0.001, 0.02, 0.1]), acceleration=st.sampled_from([0.1, 1.0]))
@settings(max_examples=EXAMPLES, deadline=None, derandomize=True)
def test_no_stream_of_positions_moves_the_setpoint_beyond_the_sent_positions(
    door: str, stream: list[Sent], speed: float, acceleration: float
) -> None:
    asked = StreamAgreement(speed=speed, acceleration=acceleration)
    positions, sent = followed(DOORS[door], asked, stream), np.array([one.tip for one in stream])
    assert np.isfinite(positions).all()
    assert beyond(positions, sent) <= allowed(asked, sent) + 1e-9
    assert np.linalg.norm(positions, axis=1).max() <= 1.0001 * asked.reach + 1e-6
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).max() <= speed * PERIOD * (1.0 + 1e-9)


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("pause", [0.04, 0.1, 0.18])
@pytest.mark.parametrize("bunch", [3, 8])
@pytest.mark.parametrize("timed", [False, True])
def test_positions_bunched_within_a_millimetre_keep_the_setpoint_within_two_millimetres(
    door: str, pause: float, bunch: int, timed: bool
) -> None:
    stream = [
        Sent(t := 0.1 + pause * k + 1e-5 * j, (5e-4 * (j % 3), 0.0, 0.0), 50.0 + t if timed else None)
        for k in range(round(4.0 / pause))
        for j in range(bunch)
    ]
    positions = followed(DOORS[door], StreamAgreement(), stream)
    assert np.linalg.norm(positions, axis=1).max() < 2e-3


@given(
    told=st.lists(
        st.tuples(st.sampled_from([1e-6, 0.002, 0.05, 0.19, 0.3]), st.tuples(*[st.floats(-1e308, 1e308)] * 3)),
        min_size=1, max_size=30,
    ),
    silence=st.sampled_from([0.05, 0.2, 2.0]),
)  # fmt: skip
@settings(max_examples=EXAMPLES, deadline=None, derandomize=True)
def test_velocities_move_the_setpoint_within_the_agreed_speed_and_silence(
    told: list[tuple[float, tuple[float, float, float]]], silence: float
) -> None:
    asked = StreamAgreement(silence=silence, end=60.0)
    leader, motion = SetpointStream(asked, np.zeros(3), 0.0), StreamedMotion(asked.limits(), 0.0, PERIOD)
    now, last, wishes = 0.0, 0.0, []
    for pause, velocity in told:
        last += pause
        wishes.append(leader.velocity(velocity, last))
        assert math.hypot(*wishes[-1].velocity) <= asked.speed * (1.0 + 1e-9)
    positions, at_last = [np.zeros(3)], np.zeros(3)
    while now < last + silence + 0.5:
        heard = [wish for wish in wishes if wish.time <= now]
        setpoint = motion.order(now, 0.0, StreamRequest(1, heard[-1]) if heard else None)
        assert setpoint is not None
        positions.append(setpoint.position)
        at_last = setpoint.position if now <= last else at_last
        now += PERIOD
    braking = asked.speed**2 / (2.0 * asked.acceleration)
    assert math.dist(positions[-1], at_last) <= asked.speed * (silence + 2.0 * PERIOD) + braking
    assert positions[-1] == pytest.approx(positions[-2], abs=1e-12)
    assert np.linalg.norm(positions, axis=1).max() <= 1.0001 * asked.reach + 1e-6


@given(stream=streams(), angle=st.sampled_from([0.01, 0.3, 1.0]))
@settings(max_examples=EXAMPLES // 2, deadline=None, derandomize=True)
def test_no_stream_of_directions_turns_the_tip_beyond_the_sent_directions(stream: list[Sent], angle: float) -> None:
    asked, up = StreamAgreement(controller={"task": "position_and_direction"}), np.array([0.0, 0.0, 1.0])
    leader, motion = SetpointStream(asked, np.zeros(3), 0.0), StreamedMotion(asked.limits(), 0.0, PERIOD, up)
    wish, turned = None, 0.0
    for k in range(math.ceil((stream[-1].arrives + 0.7) / PERIOD)):
        while stream and stream[0].arrives <= PERIOD * k:
            one = stream.pop(0)
            x, y = angle * np.array(one.tip[:2]) / max(1e-9, math.hypot(*one.tip[:2]))
            direction = (math.sin(angle) * x / angle, math.sin(angle) * y / angle, math.cos(angle))
            wish = leader.position((0.0, 0.0, 0.0), one.arrives, one.time, direction)
        setpoint = motion.order(PERIOD * k, 0.0, None if wish is None else StreamRequest(1, wish))
        assert setpoint is not None
        assert setpoint.direction is not None
        turned = max(turned, math.acos(min(1.0, float(setpoint.direction @ up))))
    # The direction turns at 0.2 rad/s at most and stops within 0.02 rad.
    assert turned <= angle + TURNING * 0.02
