"""A client streams setpoints of the tip to the control loop, with simulated devices on simulated wires."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from core.control.setpoint_request import DEFAULT_MOTION_BOUNDS, SetpointRequest
from core.control.trajectories import rotated
from station.config.controllers import DEFAULT_CONTROLLER
from station.config.motions import CircleMotion, Orders
from station.control.states import State
from station.control.task import MotionTask, Phase, StreamLimits, StreamRequest, TimedOrders
from station.service.commands import StreamAgreement
from station.service.setpoint_stream import SetpointStream
from tests.harness.cases import a_case
from tests.harness.virtual_station import VirtualStation, usual_case

CIRCLE = CircleMotion(radius=0.010, period=20.0)
SECONDS = 6.0


def started(orders: TimedOrders | StreamLimits) -> VirtualStation:
    """Return a station whose streamed motion has just started."""
    case = usual_case()
    station = VirtualStation(case).ready()
    station.loop.start(MotionTask(DEFAULT_CONTROLLER.controller(case.robot), orders, 60.0))
    station.until(lambda: station.loop.phase is Phase.MOVING)
    return station


def streamed(
    rate: float, limits: StreamLimits, position_at: Callable[[float], tuple[float, float, float] | None]
) -> VirtualStation:
    """Return a station that receives `position_at(time since the motion's start)` `rate` times a second."""
    station = started(limits)
    start, stream = station.now, SetpointStream(StreamAgreement(), np.zeros(3), station.now)
    wishes: list[SetpointRequest] = []

    def request(now: float) -> StreamRequest | None:
        if now - start >= len(sent) / rate - 1e-9:
            place = position_at(now - start)
            sent.append(place)
            if place is not None:
                wishes.append(stream.position(place, now))
        return StreamRequest(1, wishes[-1]) if wishes else None

    sent: list[object] = []
    station.request = request
    return station


def circle(time: float) -> tuple[float, float, float]:
    x, y, z = CIRCLE.setpoint(time).position.tolist()
    return x, y, z


def test_streamed_circle_is_as_accurate_as_the_same_trajectory():
    known = started(Orders(CIRCLE, usual_case().robot.robot()))
    since = known.now
    known.seconds(SECONDS)
    errors = [_largest(known, since)]
    for rate in (50.0, 500.0):
        station = streamed(rate, StreamLimits(), circle)
        since = station.now
        station.seconds(SECONDS)
        assert station.state is State.RUNNING
        errors.append(_largest(station, since))
    assert errors[1:] == pytest.approx([errors[0]] * 2, rel=0.2)


def test_slow_client_that_loses_a_tenth_of_its_messages_moves_the_tip_smoothly():
    rng = np.random.default_rng(3)
    station = streamed(10.0, StreamLimits(), lambda time: circle(time) if rng.random() > 0.1 else None)
    since = station.now
    station.seconds(SECONDS)

    assert station.state is State.RUNNING
    desired = station.of("tip_desired")[[row[0] > since for row in station.rows]]
    velocity = np.diff(desired, axis=0) / 0.002
    assert np.linalg.norm(velocity, axis=1).max() < DEFAULT_MOTION_BOUNDS.max_speed + 1e-9
    assert (
        np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() < DEFAULT_MOTION_BOUNDS.max_acceleration * 0.002 + 1e-9
    )
    assert _largest(station, since) < 1.0


def test_silence_brings_the_tip_to_rest_and_then_ends_the_run():
    station = streamed(
        50.0, StreamLimits(silence=0.2, end=2.0), lambda time: (0.0, 0.0, 0.01 * time) if time < 1.0 else None
    )
    since = station.now
    station.seconds(1.5)
    resting = station.of("tip_desired")[-1]
    station.seconds(0.5)
    assert station.state is State.RUNNING
    assert station.of("tip_desired")[-1] == pytest.approx(resting, abs=1e-12)
    station.becomes(State.READY, 5.0)
    assert 2.9 < station.now - since < 3.1


def test_disconnect_brings_the_tip_to_rest_and_ends_the_run():
    station = streamed(50.0, StreamLimits(), lambda time: (0.0, 0.0, 0.01 * time))
    station.seconds(1.0)
    assert station.state is State.RUNNING
    station.request = lambda _: StreamRequest(1, None)
    start = station.now
    station.becomes(State.READY, 1.0)
    # braking from 10 mm/s with 100 mm/s^2 takes 0.1 s
    assert station.now - start == pytest.approx(0.1, abs=0.02)


def test_telemetry_contains_the_latest_setpoint_request_and_its_time():
    station = streamed(50.0, StreamLimits(), lambda time: (0.001, 0.0, 0.0))
    since = station.now
    station.seconds(0.5)
    row = station.rows[-1]
    assert station.of("request_kind", [row])[0] == 1.0
    assert since + 0.45 < station.of("request_time", [row])[0] <= station.now
    assert station.of("request", [row])[0] == pytest.approx(station.of("request", [station.rows[-20]])[0], abs=1e-12)
    assert math.isfinite(station.of("request_velocity", [row])[0].sum())


def test_six_joints_follow_a_streamed_direction_at_constant_position_and_rest_in_silence():
    case = a_case("points", "pointing_alone")
    station = VirtualStation(case).ready()
    station.loop.start(MotionTask(case.controller, StreamLimits(silence=0.2, end=3.0), 60.0))
    station.until(lambda: station.loop.phase is Phase.MOVING)
    station.seconds(0.5)
    start_direction, place, since = (
        station.of("direction_desired")[-1],
        station.of("tip_desired")[-1],
        len(station.rows),
    )
    target_direction = rotated(
        start_direction,
        0.15 * np.cross(start_direction, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(start_direction, [0.0, 0.0, 1.0])),
    )
    stream = SetpointStream(StreamAgreement(controller=case.file.controller), np.zeros(3), station.now)

    def position_at(direction):
        return lambda now: StreamRequest(1, stream.position((0.0, 0.0, 0.0), now, direction=direction))

    station.request = position_at(tuple(2.5 * target_direction))
    station.seconds(3.0)
    rows = station.rows[since:]
    desired, true = station.of("direction_desired", rows), station.of("direction_true", rows)
    assert station.state is State.RUNNING
    assert desired[-1] == pytest.approx(target_direction, abs=1e-6)
    steps = np.linalg.norm(np.diff(desired, axis=0), axis=1)
    assert steps.max() == pytest.approx(0.2 * 0.002, rel=1e-3)
    assert _angles(true, desired)[500:].max() < math.radians(2.0)
    away = np.linalg.norm(station.of("tip_true", rows) - place, axis=1)
    assert away.max() < 4e-3  # the position error during the rotation is as large as in a jog
    assert away[1000:].max() < 1e-3

    station.request = position_at(tuple(start_direction))
    station.seconds(0.2)
    last = StreamRequest(1, stream.position((0.0, 0.0, 0.0), station.now))
    station.request = lambda _: last
    station.seconds(0.5)
    still = station.of("direction_desired")[-1]
    assert _angles(still, target_direction) > 0.05
    assert _angles(still, start_direction) > 0.02
    station.seconds(1.0)
    assert station.of("direction_desired")[-1] == pytest.approx(still, abs=1e-12)


def _angles(ones: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the angles between directions (..., 3) [rad]."""
    return np.arctan2(np.linalg.norm(np.cross(ones, others), axis=-1), (ones * others).sum(axis=-1))


def _largest(station: VirtualStation, since: float) -> float:
    """Return the largest distance of the true tip from the circle later than 3 s after the motion's start [mm]."""
    rows = [row for row in station.rows if row[0] > since + 3.0]
    times = np.array([row[0] for row in rows]) - since
    first = next(row for row in station.rows if row[0] > since)
    origin = station.of("tip_desired", [first])[0]
    desired = np.array([circle(time) for time in times])
    return 1e3 * float(np.linalg.norm(station.of("tip_true", rows) - origin - desired, axis=1).max())
