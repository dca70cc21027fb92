"""A tip that is led, message by message, through the whole loop on simulated wires."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from core.control.leading import BOUNDS, Wish
from core.control.trajectories import turned
from station.config.controllers import BEST
from station.config.motions import CircleMotion, Orders
from station.control.led import Asked, Lead
from station.control.motion import TimedOrders
from station.control.states import State
from station.control.task import Phase, Task
from station.service.leader import Leader, LeadIn
from tests.harness.cases import a_case
from tests.harness.virtual_station import VirtualStation, usual_case

CIRCLE = CircleMotion(radius=0.010, period=20.0)
SECONDS = 10.0


def begun(orders: TimedOrders | Lead) -> VirtualStation:
    """A station whose motion has just begun."""
    case = usual_case()
    station = VirtualStation(case).ready()
    station.loop.start(Task(BEST.controller(case.robot), orders, 60.0))
    station.until(lambda: station.loop.phase is Phase.MOVING)
    return station


def led(rate: float, lead: Lead, says: Callable[[float], tuple[float, float, float] | None]) -> VirtualStation:
    """One that is sent a place `rate` times a second, `says(seconds since the motion's start)`."""
    station = begun(lead)
    start, leader = station.now, Leader(LeadIn(), np.zeros(3), station.now)
    wishes: list[Wish] = []

    def asked(now: float) -> Asked | None:
        if now - start >= len(sent) / rate - 1e-9:
            place = says(now - start)
            sent.append(place)
            if place is not None:
                wishes.append(leader.place(place, now))
        return Asked(1, wishes[-1]) if wishes else None

    sent: list[object] = []
    station.asked = asked
    return station


def circle(time: float) -> tuple[float, float, float]:
    x, y, z = CIRCLE.trajectory().setpoint(time).position.tolist()
    return x, y, z


def test_a_streamed_circle_is_as_near_to_it_as_the_same_circle_as_a_trajectory():
    known = begun(Orders(CIRCLE, usual_case().robot.robot()))
    since = known.now
    known.seconds(SECONDS)
    errors = [_largest(known, since)]
    for rate in (50.0, 100.0, 500.0):
        station = led(rate, Lead(), circle)
        since = station.now
        station.seconds(SECONDS)
        assert station.state is State.RUNNING
        errors.append(_largest(station, since))
    assert errors[1:] == pytest.approx([errors[0]] * 3, rel=0.2)


def test_a_slow_sender_that_loses_a_tenth_leads_without_jerk_and_without_a_stop():
    rng = np.random.default_rng(3)
    station = led(10.0, Lead(), lambda time: circle(time) if rng.random() > 0.1 else None)
    since = station.now
    station.seconds(SECONDS)

    assert station.state is State.RUNNING
    desired = station.of("tip_desired")[[row[0] > since for row in station.rows]]
    velocity = np.diff(desired, axis=0) / 0.002
    assert np.linalg.norm(velocity, axis=1).max() < BOUNDS.max_speed + 1e-9
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() < BOUNDS.max_acceleration * 0.002 + 1e-9
    assert _largest(station, since) < 1.0


def test_silence_lets_the_tip_come_to_rest_and_then_ends_the_run():
    station = led(50.0, Lead(silence=0.2, end=2.0), lambda time: (0.0, 0.0, 0.01 * time) if time < 1.0 else None)
    since = station.now
    station.seconds(1.5)
    resting = station.of("tip_desired")[-1]
    station.seconds(0.5)
    assert station.state is State.RUNNING
    assert station.of("tip_desired")[-1] == pytest.approx(resting, abs=1e-12)
    station.becomes(State.READY, 5.0)
    assert 2.9 < station.now - since < 3.1


def test_whoever_leaves_lets_the_tip_come_to_rest_and_that_is_the_end():
    station = led(50.0, Lead(), lambda time: (0.0, 0.0, 0.01 * time))
    station.seconds(1.0)
    assert station.state is State.RUNNING
    station.asked = lambda _: Asked(1, None)
    begin = station.now
    station.becomes(State.READY, 1.0)
    # 10 mm/s at 100 mm/s^2
    assert station.now - begin == pytest.approx(0.1, abs=0.02)


def test_what_was_asked_for_and_when_is_in_the_rows():
    station = led(50.0, Lead(), lambda time: (0.001, 0.0, 0.0))
    since = station.now
    station.seconds(0.5)
    row = station.rows[-1]
    assert station.of("asked_kind", [row])[0] == 1.0
    assert since + 0.45 < station.of("asked_time", [row])[0] <= station.now
    assert station.of("asked", [row])[0] - station.of("asked", [station.rows[-20]])[0] == pytest.approx(0.0, abs=1e-12)
    assert math.isfinite(station.of("asked_velocity", [row])[0].sum())


def test_six_joints_point_where_is_told_and_keep_the_place_and_in_silence_they_stop_turning():
    case = a_case("points", "pointing_alone")
    station = VirtualStation(case).ready()
    station.loop.start(Task(case.controller, Lead(silence=0.2, end=3.0), 60.0))
    station.until(lambda: station.loop.phase is Phase.MOVING)
    station.seconds(0.5)
    begin, place, since = station.of("direction_desired")[-1], station.of("tip_desired")[-1], len(station.rows)
    told = turned(begin, 0.15 * np.cross(begin, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(begin, [0.0, 0.0, 1.0])))
    leader = Leader(LeadIn(controller=case.file.controller), np.zeros(3), station.now)

    def says(direction):
        return lambda now: Asked(1, leader.place((0.0, 0.0, 0.0), now, direction=direction))

    station.asked = says(tuple(2.5 * told))
    station.seconds(3.0)
    rows = station.rows[since:]
    desired, true = station.of("direction_desired", rows), station.of("direction_true", rows)
    assert station.state is State.RUNNING
    assert desired[-1] == pytest.approx(told, abs=1e-6)
    steps = np.linalg.norm(np.diff(desired, axis=0), axis=1)
    assert steps.max() == pytest.approx(0.2 * 0.002, rel=1e-3)
    assert _angles(true, desired)[500:].max() < math.radians(2.0)
    away = np.linalg.norm(station.of("tip_true", rows) - place, axis=1)
    assert away.max() < 4e-3  # on the way, as when it is turned by hand
    assert away[1000:].max() < 1e-3

    station.asked = says(tuple(begin))
    station.seconds(0.2)
    last = Asked(1, leader.place((0.0, 0.0, 0.0), station.now))
    station.asked = lambda _: last
    station.seconds(0.5)
    still = station.of("direction_desired")[-1]
    assert _angles(still, told) > 0.05
    assert _angles(still, begin) > 0.02
    station.seconds(1.0)
    assert station.of("direction_desired")[-1] == pytest.approx(still, abs=1e-12)


def _angles(ones: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Between directions (..., 3) [rad]."""
    return np.arctan2(np.linalg.norm(np.cross(ones, others), axis=-1), (ones * others).sum(axis=-1))


def _largest(station: VirtualStation, since: float) -> float:
    """Largest distance of the true tip from the circle 3 s and more after the motion's start [mm]."""
    rows = [row for row in station.rows if row[0] > since + 3.0]
    times = np.array([row[0] for row in rows]) - since
    first = next(row for row in station.rows if row[0] > since)
    origin = station.of("tip_desired", [first])[0]
    wanted = np.array([circle(time) for time in times])
    return 1e3 * float(np.linalg.norm(station.of("tip_true", rows) - origin - wanted, axis=1).max())
