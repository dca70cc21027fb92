"""Stream of setpoints: converts each message of a streaming client to a `SetpointRequest` and rejects invalid ones."""

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from core.control.setpoint_request import SetpointRequest
from core.errors import CtrError
from core.robot.robot import Array

if TYPE_CHECKING:
    from station.service.commands import StreamAgreement

#: Largest rate of a client's messages [1/s], and time over which this rate is averaged [s]. The time is long because
#: messages that wait while this computer is busy arrive together, which is not the sender's fault.
MAX_RATE_HZ, STALL_S = 500.0, 4.0
MAX_BURST = MAX_RATE_HZ * STALL_S
#: Time span of the positions to which the velocity is fitted [s], and smallest number of these positions.
VELOCITY_WINDOW_S, MIN_WINDOW_POINTS = 0.1, 3
#: Positions that arrive within this time form a bunch [s]. Only the newest position of a bunch counts: the network
#: determines the intervals within a bunch, so differences within a bunch give no velocity.
BUNCH_S = 0.005
#: Duration of a position's extrapolation in periods of the sender, so that one message may get lost; shortest and
#: longest duration [s]. The shortest duration lets a message be some milliseconds late without stopping the tip.
EXTRAPOLATION_PERIODS, MIN_EXTRAPOLATION_S, MAX_EXTRAPOLATION_S = 2.5, 0.05, 0.2
#: Time for which a transport delay is remembered [s].
DELAY_MEMORY_S = 1.0
#: Largest delay beyond the shortest one that the sender's time compensates [s].
MAX_LATENESS_S = 0.1
#: Length of the shortest vector that is accepted as a direction.
MIN_DIRECTION_LENGTH = 1e-9


class SetpointRefused(CtrError):
    """A message of a streaming client is invalid; the previous setpoint remains."""


class RateExceeded(CtrError):
    """A streaming client sends more messages than allowed."""


class SetpointStream:
    """State of one client's stream of setpoints; times are by the receiver's clock [s]."""

    def __init__(self, agreement: "StreamAgreement", start: Array, now: float) -> None:
        """Start a stream; `start` (3,) is the tip at its start, in the world frame [m]."""
        self._reach = agreement.reach
        self.controls_direction = agreement.controls_direction  #: whether positions may have a direction
        self._direction: Array | None = None  # latest requested direction
        self._zero = start if agreement.frame == "world" else np.zeros(3)
        self._samples: deque[tuple[float, Array]] = deque()  # times and positions from which the velocity is computed
        self._credit, self._counted = MAX_BURST, now
        self._gap, self._last = 0.0, now
        self._bunch = -math.inf  # start of the newest bunch [s]
        self._speed = agreement.speed
        self._sent = -math.inf  # previous time of the sender [s]
        # Arrivals, and delays by both clocks, of the messages after which no delay was shorter [s].
        self._delays: deque[tuple[float, float]] = deque()

    def count(self, now: float) -> None:
        """Count a received message and check the rate of messages.

        Raises:
            RateExceeded: the client sends more messages than allowed.
        """
        self._credit = min(MAX_BURST, self._credit + MAX_RATE_HZ * (now - self._counted)) - 1.0
        self._counted = now
        if self._credit < 0.0:
            raise RateExceeded(f"more than {MAX_RATE_HZ:g} messages a second; send fewer")

    def position(
        self,
        position: tuple[float, ...],
        now: float,
        sent: float | None = None,
        direction: tuple[float, ...] | None = None,
    ) -> SetpointRequest:
        """Return the setpoint for a requested position, extrapolated with the velocity of the previous positions.

        The extrapolation is at most as fast as agreed. Its distance is at most that between the oldest and newest
        position of the velocity fit.

        Args:
            position: requested position of the tip [m].
            now: time of arrival [s].
            sent: time of sending on the sender's clock [s]; it compensates for variable transport delays, unless the
                sender's clock does not advance, is coarse or was set back.
            direction: requested direction of the tip in the world frame, of any length but zero; None: the latest one.

        Raises:
            SetpointRefused: the position is not three finite numbers or is beyond the reach, or the direction is
                invalid.
        """
        pointing = self._pointing(direction)
        relative = _vector("tip", position, "m") - self._zero
        distance = math.hypot(*relative)
        if distance > self._reach:
            raise SetpointRefused(
                f"tip {[round(x, 6) for x in position]} m is {1e3 * distance:.4g} mm from the start, beyond the reach"
                f" of {1e3 * self._reach:.4g} mm; the previous setpoint remains"
            )
        self._direction = pointing
        now = max(now, self._last)
        when, samples = max(self._last, now - self._lateness(now, sent)), self._samples
        if samples and when - samples[-1][0] > MAX_EXTRAPOLATION_S:
            samples.clear()  # positions before a pause give no velocity
        if samples and now - self._bunch < BUNCH_S:
            samples.pop()  # only the newest position of a bunch counts
        self._last = when
        lasts = max(EXTRAPOLATION_PERIODS * self._period(now), MIN_EXTRAPOLATION_S)
        lasts = min(lasts + now - when, MAX_EXTRAPOLATION_S)  # as long after the arrival, however late the message is
        samples.append((when, relative))
        while len(samples) > MIN_WINDOW_POINTS and when - samples[0][0] > max(VELOCITY_WINDOW_S, lasts):
            samples.popleft()
        velocity = _limit_speed(_slope(samples), self._speed)
        speed, travel = math.hypot(*velocity), math.dist(relative, samples[0][1])
        return SetpointRequest(relative, velocity, when, min(lasts, travel / speed) if speed > 0.0 else lasts, pointing)

    def velocity(self, requested: tuple[float, ...], now: float) -> SetpointRequest:
        """Return the request of a velocity [m/s], no faster than agreed, with the latest direction.

        Raises:
            SetpointRefused: the velocity is not three finite numbers.
        """
        velocity = _limit_speed(_vector("velocity", requested, "m/s"), self._speed)
        self._samples.clear()
        self._last = now = max(now, self._last)
        self._period(now)
        return SetpointRequest(None, velocity, now, math.inf, self._direction)

    def _pointing(self, direction: tuple[float, ...] | None) -> Array | None:
        """Return the unit vector (3,) of a direction, or the latest one."""
        if direction is None:
            return self._direction
        if not self.controls_direction:
            raise SetpointRefused(
                "direction: the tip's direction is not controlled in this run; start the stream with"
                ' controller.task = "position_and_direction", which needs five joints or more; the previous setpoint'
                " remains"
            )
        vector = _vector("direction", direction, "")
        largest = float(np.abs(vector).max())
        if largest < MIN_DIRECTION_LENGTH:
            raise SetpointRefused(
                f"direction {list(direction)} has the length {math.hypot(*direction):.3g}, shorter than"
                f" {MIN_DIRECTION_LENGTH:g}; send a longer vector in the world frame; the previous setpoint remains"
            )
        vector /= largest  # otherwise the square of a large finite number could overflow
        return vector / math.hypot(*vector)

    def _lateness(self, now: float, sent: float | None) -> float:
        """Return by how much a message's delay exceeds the shortest recent one [s]; 0 without a usable time."""
        if sent is None:
            return 0.0
        if sent <= self._sent:  # the sender's clock does not advance, is coarse or was set back
            self._delays.clear()
        self._sent, delay, delays = sent, now - sent, self._delays
        while delays and delays[-1][1] >= delay:
            delays.pop()
        delays.append((now, delay))
        while now - delays[0][0] > DELAY_MEMORY_S:
            delays.popleft()
        return min(delay - delays[0][1], MAX_LATENESS_S)

    def _period(self, now: float) -> float:
        """Return the sender's smoothed period between the starts of two bunches [s]; pauses are ignored."""
        gap = now - self._bunch
        if gap >= BUNCH_S:
            self._bunch = now
            if gap < MAX_EXTRAPOLATION_S:
                self._gap = gap if self._gap == 0.0 else self._gap + 0.1 * (gap - self._gap)
        return min(self._gap, MAX_EXTRAPOLATION_S)


def _vector(name: str, numbers: tuple[float, ...], unit: str) -> Array:
    if len(numbers) != 3 or not all(math.isfinite(x) for x in numbers):
        shown = f"{list(numbers)} {unit}".rstrip() if len(numbers) == 3 else f"of {len(numbers)} numbers"
        raise SetpointRefused(f"{name} {shown}: three finite numbers are needed; the previous setpoint remains")
    return np.array(numbers, dtype=np.float64)


def _limit_speed(velocity: Array, speed: float) -> Array:
    """Return a velocity (3,) shortened to at most `speed` [m/s], without overflow of large numbers."""
    largest = float(np.abs(velocity).max())
    if largest == 0.0:
        return velocity
    unit = velocity / largest
    length = math.hypot(*unit)
    return velocity if largest <= speed / length else unit * (speed / length)


def _slope(samples: deque[tuple[float, Array]]) -> Array:
    """Return the velocity (3,) [m/s] of a line fitted to the positions."""
    times = np.array([time for time, _ in samples])
    times -= times.mean()
    spread = float(times @ times)
    if times[-1] - times[0] < BUNCH_S:
        return np.zeros(3)
    return times @ np.array([position for _, position in samples]) / spread
