"""Checks whether a driver keeps the contract of `interfaces.py`, on a running bench or a simulated one, in real time.

The checks report what they measure. They refuse what would mislead the control loop or endanger the robot: a wrong or
missing position, a stage that moves by itself, a stop or an emergency stop without effect.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import JointFile
from station.devices.interfaces import BaseSensors, Clock, Condition, Device, EmergencyStop, Stages, Tracker

TICK_S = 0.002  #: time between two polls, as in the control loop [s]
CONNECT_S, HOME_S = 60.0, 600.0  #: longest time to connect and to home [s]
SPEED, RUN_S = 0.3, 1.0  #: speed of the check's motion, as a share of the joint's speed, and its duration [s]
STILL = 50.0  #: motion that counts as none [microsteps]
MAX_SPEED_ERROR = 0.05  #: largest error of the mean speed, as a share of the commanded speed
MAX_STOP_S = 0.5  #: largest time from a stop to rest, in addition to the braking time [s]
WATCH_S = 3.0  #: duration for which a tracker or the force sensors are observed [s]


class Finding(NamedTuple):
    """Result of one check."""

    subject: str
    good: bool
    text: str


class _Broken(CtrError):
    """A check has failed, so that the following checks are impossible; the text states what happened."""


class _Running:
    """Stages that are polled and commanded as in the control loop."""

    def __init__(self, stages: Stages, clock: Clock) -> None:
        self.stages, self._clock = stages, clock
        self.reading = stages.poll(clock.now())

    def run(self, seconds: float, velocities: Array | None = None, until: Callable[[], bool] = lambda: False) -> float:
        """Poll and command the stages for `seconds`, or until a condition holds; return the time that it took [s]."""
        start = self._clock.now()
        while (now := self._clock.now()) - start < seconds and not until():
            self.reading = self.stages.poll(now)
            if velocities is not None:
                self.stages.command(velocities, now)
            self._clock.sleep(TICK_S)
        return now - start

    @property
    def cause(self) -> str:
        """Text of the present fault."""
        return str(self.stages.trouble(self._clock.now()) or "no cause reported")

    def connect(self) -> float:
        """Connect the stages; return the time that it took [s].

        Raises:
            _Broken: the stages are not connected.
        """
        self.stages.connect(self._clock.now())
        took = self.run(CONNECT_S, until=lambda: self.stages.condition is not Condition.CONNECTING)
        if self.stages.condition is not Condition.CONNECTED:
            raise _Broken(f"not connected after {took:.1f} s: {self.cause}")
        return took

    def time_to_rest(self, seconds: float, steps: Array) -> float:
        """Return the time until the positions no longer change [s]; infinite if they change for `seconds`."""
        start = since = self._clock.now()
        last = self.reading.positions
        while since - start < seconds:
            self.run(0.01)
            if (np.abs(self.reading.positions - last) > steps).any():
                since, last = self._clock.now(), self.reading.positions
            elif self._clock.now() - since > 0.1:
                return since - start
        return math.inf


def check_stages(
    opens: Callable[[], Stages], joints: Sequence[JointFile], clock: Clock, stop: EmergencyStop | None, moves: bool
) -> Iterator[Finding]:
    """Check a driver of stages; `moves` permits motions, a homing among them. The last session is closed."""
    running = _Running(opens(), clock)
    try:
        yield from _check_at_rest(running, joints)
        if moves:
            yield from _check_motions(running, joints, clock)
            running.run(0.2, _away_from_limits(running.reading.positions, joints))
            running.stages.close()
            yield _check_emergency_stop(stop, clock)
            running = _Running(opens(), clock)
            running.connect()
            before = running.reading.positions
            running.run(0.3)
            still = _moved(before, running.reading.positions, joints) <= STILL
            yield Finding("reopening", still, "the stages are at rest" if still else "the stages still move")
        else:
            yield Finding("motions", True, "not checked; they need --move")
    except CtrError as error:
        yield Finding("session", False, str(error))
    finally:
        running.stages.stop(clock.now())
        running.stages.close()


def _check_at_rest(running: _Running, joints: Sequence[JointFile]) -> Iterator[Finding]:
    stages, positions = running.stages, running.reading.positions
    unknown = positions.shape == (len(joints),) and bool(np.isnan(positions).all())
    yield Finding("before connecting", unknown and not stages.ready, f"positions {positions}, ready {stages.ready}")
    took = running.connect()
    yield Finding("connecting", True, f"connected after {took:.2f} s")
    running.run(0.2)
    before = running.reading.positions
    running.run(0.5)
    moved = _moved(before, running.reading.positions, joints)
    yield Finding("at rest", not moved > STILL, f"the positions change by {moved:.1f} microsteps in 0.5 s")


def _check_motions(running: _Running, joints: Sequence[JointFile], clock: Clock) -> Iterator[Finding]:
    stages = running.stages
    if not stages.ready:
        stages.home(clock.now())
        took = running.run(HOME_S, until=lambda: stages.condition is not Condition.HOMING)
        if not stages.ready:
            raise _Broken(f"not homed after {took:.0f} s: {running.cause}")
        yield Finding("homing", True, f"homed after {took:.0f} s")
    running.run(0.2, np.zeros(len(joints)))
    steps = np.array([joint.microstep for joint in joints])
    velocities = _away_from_limits(running.reading.positions, joints)
    ramps = np.array([joint.acceleration for joint in joints])
    start, before = clock.now(), running.reading.positions
    running.run(0.5 * RUN_S, velocities)  # the stages accelerate, so only the second half shows their speed
    middle = running.reading.positions
    took = running.run(0.5 * RUN_S, velocities)
    speeds = (running.reading.positions - middle) / took
    if not running.reading.sent.all():
        raise _Broken(f"a stage was stopped during the motion: {running.cause}")
    error = float(np.abs(speeds / running.reading.sent - 1.0).max())
    yield Finding("speed", error <= MAX_SPEED_ERROR, f"differs by at most {100.0 * error:.1f} % from the one sent")
    # A motion of constant acceleration, then of constant speed, is behind one at full speed by half the ramp's time.
    lost = clock.now() - start - (running.reading.positions - before) / velocities - 0.5 * np.abs(velocities) / ramps
    yield Finding("latency", True, f"about {1e3 * max(0.0, float(lost.max())):.0f} ms from a command to the motion")
    stages.stop(clock.now())
    braking = float((np.abs(velocities) / ramps).max())
    rest = running.time_to_rest(2.0 + braking, 2.0 * steps)
    good = rest <= MAX_STOP_S + braking and not running.reading.sent.any()
    yield Finding("stop", good, f"at rest after {1e3 * rest:.0f} ms; braking alone takes {1e3 * braking:.0f} ms")
    running.run(0.5, velocities)
    running.run(0.01, np.where(np.arange(len(joints)) == 0, math.nan, velocities))
    rest = running.time_to_rest(2.0 + braking, 2.0 * steps)
    yield Finding("velocity nan", rest <= MAX_STOP_S + braking, f"all axes at rest after {1e3 * rest:.0f} ms")
    running.run(0.2, 100.0 * _away_from_limits(running.reading.positions, joints))
    share = float((np.abs(running.reading.sent) / [joint.speed for joint in joints]).max())
    yield Finding("speed limit", share <= 1.01, f"sends at most {100.0 * share:.0f} % of a joint's largest speed")
    stages.stop(clock.now())
    running.time_to_rest(2.0 + braking, 2.0 * steps)


def _check_emergency_stop(stop: EmergencyStop | None, clock: Clock) -> Finding:
    if stop is None:
        return Finding("emergency stop", False, "the driver has none: nothing stops the stages after a crash")
    start = clock.now()
    try:
        text = stop(clock)
    except Exception as error:  # a foreign function can raise anything
        return Finding("emergency stop", False, f"{type(error).__name__}: {error}")
    took = clock.now() - start
    return Finding("emergency stop", bool(text) and took <= 2.0, f"{text} ({took:.2f} s)")


def check_tracker(opens: Callable[[], Tracker], clock: Clock) -> Iterator[Finding]:
    """Check a driver of a tracker, whose coil must be visible."""
    tracker = opens()
    try:
        yield _connected(tracker, tracker.poll, clock)
        start, frames = clock.now(), []
        while (now := clock.now()) - start < WATCH_S:
            if (reading := tracker.poll(now)) is not None:
                frames.append((now, reading))
            clock.sleep(TICK_S)
        numbers, times = [r.frame for _, r in frames], [r.time for _, r in frames]
        rate = len(frames) / WATCH_S
        yield Finding("frames", len(frames) >= 2, f"{rate:.1f} a second with a valid position")
        rising = all(b > a for a, b in pairwise(numbers))
        yield Finding("frame numbers", rising, "increase" if rising else "do not increase")
        good = all(b > a for a, b in pairwise(times)) and all(r.time <= now for now, r in frames)
        ages = [1e3 * (now - r.time) for now, r in frames] or [math.nan]
        yield Finding("times", good, f"frames are {min(ages):.0f} to {max(ages):.0f} ms old")
        valid = all(r.position.shape == (3,) and np.isfinite(r.position).all() for _, r in frames)
        yield Finding("positions", valid, "finite" if valid else "not finite, or not of shape (3,)")
    finally:
        tracker.close()


def check_sensors(opens: Callable[[], BaseSensors], tubes: int, clock: Clock) -> Iterator[Finding]:
    """Check a driver of the force sensors of `tubes` tubes."""
    sensors = opens()
    try:
        yield _connected(sensors, sensors.poll, clock)
        start, times, valid, usable = clock.now(), set[float](), True, True
        while (now := clock.now()) - start < WATCH_S:
            reading = sensors.poll(now)
            times.add(reading.time)
            valid &= reading.wrenches.shape == (tubes, 6) and bool(np.isfinite(reading.wrenches).all())
            usable &= reading.usable
            clock.sleep(TICK_S)
        yield Finding("samples", len(times) > 1, f"{len(times) / WATCH_S:.0f} a second, as far as each poll sees them")
        yield Finding(
            "wrenches", valid and usable, "finite and usable" if valid and usable else "missing or not finite"
        )
    finally:
        sensors.close()


def _connected(device: Device, poll: Callable[[float], object], clock: Clock) -> Finding:
    start = clock.now()
    device.connect(start)
    while device.condition is Condition.CONNECTING and clock.now() - start < CONNECT_S:
        poll(clock.now())
        clock.sleep(TICK_S)
    cause = device.trouble(clock.now())
    good = device.condition is Condition.CONNECTED
    return Finding(
        "connecting", good, f"{device.condition.value} after {clock.now() - start:.2f} s; {cause or 'no fault'}"
    )


def _away_from_limits(positions: Array, joints: Sequence[JointFile]) -> Array:
    """Return velocities toward the middle of each joint's travel."""
    middle = np.array([0.5 * (joint.lower + joint.upper) for joint in joints])
    speeds = np.array([SPEED * joint.speed for joint in joints])
    return np.where(positions < middle, speeds, -speeds)


def _moved(before: Array, after: Array, joints: Sequence[JointFile]) -> float:
    """Return the largest change of a position [microsteps]; NaN: no position is known."""
    return float((np.abs(after - before) / [joint.microstep for joint in joints]).max())
