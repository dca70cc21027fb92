"""The host's side of a Zaber daisy chain: schedules messages and estimates positions. Without I/O.

The line transmits 160 messages per second. With three axes, the host sends one position query after every three
velocities: 40 velocities and 13 queries per second for each axis. Velocities are not queued: a newer velocity
replaces the pending velocity of its axis. A stop precedes all other messages.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from station.devices.zaber.estimate import MAX_UNEXPECTED_READINGS, AxisEstimate, Backlog
from station.devices.zaber.protocol import (
    ACCELERATION_UNIT,
    ERRORS,
    MAX_POSITION,
    MESSAGE_TIME_S,
    NO_DATA,
    RESYNC_GAP_S,
    SPEED_UNIT,
    Happening,
    Reply,
    ReplyLost,
    Request,
    ResetDone,
    UnexpectedMotion,
    UnsolicitedError,
    ZaberCommand,
    ZaberMessage,
    ZaberParser,
    ZaberStatus,
    encode,
    safe_speed,
)

# Times of units and adapter; the manufacturer does not specify them.
LEAD_S = 0.002  #: a message is passed to the port this long before the line is free [s]
MAX_MISSES = 2  #: missing replies in a row after which a unit counts as lost
#: A reply is dropped if its bytes have a longer gap between them [s]. The manufacturer recommends 10 ms, but a USB
#: adapter may delay bytes by 16 ms.
REPLY_GAP_S = 0.025
REFRESH_S = 0.25  #: an unchanged velocity is repeated after this time, in case it was not received [s]
STOP_ATTEMPTS = 3  #: number of stop commands that a homing unit may ignore before the host resets the unit
RESTART_S = 1.0  #: time after a reset in which a unit does not answer [s]
REPEAT_STOP_S = 0.25  #: interval of stop commands to lost units, in case they receive again [s]
STATUSES = frozenset(int(status) for status in ZaberStatus)
#: Commands of messages that a unit may send without a request, or later than expected.
UNSOLICITED = frozenset(
    {
        *(ZaberCommand.HOME, ZaberCommand.MOVE_TRACKING, ZaberCommand.LIMIT_ACTIVE, ZaberCommand.MANUAL_MOVE),
        *(ZaberCommand.MOVE_ABSOLUTE, ZaberCommand.MOVE_RELATIVE, ZaberCommand.MOVE_SPEED, ZaberCommand.STOP),
        *(ZaberCommand.SET_MODE, ZaberCommand.SET_ACCELERATION, ZaberCommand.SET_MAXIMUM, ZaberCommand.SET_POSITION),
        *(ZaberCommand.SET_RESOLUTION, ZaberCommand.SET_HOME_SPEED, ZaberCommand.SET_HOME_OFFSET),
    }
)


@dataclass(frozen=True)
class Axis:
    """Parameters of one Zaber unit that the scheduler needs."""

    device: int  #: device number on the chain, 1 ... 254
    top: int  #: largest speed that the host sends [speed units]
    acceleration: int  #: acceleration setting of the unit [acceleration units]
    maximum: int  #: maximum position setting of the unit [microsteps]
    alias: int | None = None  #: second device number, which the host uses while it polls positions


@dataclass(frozen=True)
class LineSettings:
    """Timing of the serial line that depends on the adapter and on the computer."""

    deadline: float = 0.050  #: longest time from the start of a request to its reply [s]
    pause: float = 0.0  #: pause after each forward speed [s]; 0.0125 or more prevents misreading (`safe_speed`)


@dataclass
class LineCounts:
    """Message counters of an axis."""

    velocities: int = 0  #: velocities sent
    polls: int = 0  #: position and status queries sent
    readings: int = 0  #: position readings accepted
    rejected: int = 0  #: implausible position and status readings
    missed: int = 0  #: replies that did not arrive in time


class _ExpectedReply(NamedTuple):
    """A reply that the host waits for."""

    deadline: float  #: time after which the reply counts as missing [s]
    axis: int
    poll: bool  #: whether the request was a poll of position or status
    due: float = 0.0  #: expected arrival time of the reply's last byte [s]
    idle: bool = True  #: whether the line was idle before the request


class ZaberChain:
    """The Zaber units on one serial line: sends their messages and processes their replies."""

    def __init__(self, axes: Sequence[Axis], line: LineSettings | None = None) -> None:
        self.axes, self.line = tuple(axes), line or LineSettings()
        self.parser = ZaberParser(self._plausible, REPLY_GAP_S)
        count = range(len(self.axes))
        self.estimates = [
            AxisEstimate(axis.top * SPEED_UNIT, axis.acceleration * ACCELERATION_UNIT, axis.maximum)
            for axis in self.axes
        ]
        self.counts = [LineCounts() for _ in count]
        self.sent = [0 for _ in count]  #: last speed sent to each axis [speed units]
        self.lost: set[int] = set()  #: axes whose units no longer answer
        self.polling = False  #: whether the host polls positions
        self.stopping: dict[int, int] = {}  #: axes with an unconfirmed stop, and how often each stop was ignored
        self._index = {axis.device: i for i, axis in enumerate(self.axes)}
        self._listeners = {number for axis in self.axes for number in (axis.device, axis.alias or axis.device)}
        self._safe_speeds: dict[int, int] = {}  # cache of `safe_speed`
        self._desired = [0 for _ in count]
        self._sent_at: list[float] = [math.inf for _ in count]  # infinite: not moving
        self._misses = [0 for _ in count]
        self._away: list[float] = [-math.inf for _ in count]
        self._urgent: deque[tuple[int, int]] = deque()  # axis (-1: all), command
        self._request: Request | None = None
        self._requested = False
        self._pending: dict[tuple[int, int], _ExpectedReply] = {}
        self._backlog = Backlog()
        self._turn = self._poll_turn = 0
        self._since_poll = 0
        self._free = self._quiet = self._last_feed = self._stop_repeated = -math.inf

    # Commands of the driver

    def command(self, axis: int, speed: int) -> None:
        """Set the speed of an axis [speed units]; `due` sends the latest speed when the line is free."""
        top = self.axes[axis].top
        self._desired[axis] = speed if -top <= speed <= top else int(math.copysign(top, speed))

    def stop(self) -> None:
        """Send stops to all axes before any other message, and poll each axis until it confirms its stop."""
        self._desired = [0 for _ in self.axes]
        self.cancel()
        reachable = [i for i in range(len(self.axes)) if i not in self.lost]
        if all(i in self.stopping for i in reachable) and (reachable or self._urgent):
            return  # all axes have been commanded to stop and are polled
        # One message stops all units. Then each unit gets its own stop, because no unit confirms the common one.
        self._urgent = deque([(-1, ZaberCommand.STOP), *((i, ZaberCommand.STOP) for i in range(len(self.axes)))])
        self.stopping = dict.fromkeys(reachable, 0)

    def send_request(self, request: Request) -> None:
        """Send one query or setting; `feed` returns its `Reply`. Only one request can be pending."""
        self._request, self._requested = request, False

    def cancel(self) -> None:
        """Cancel the pending request."""
        self._request = None
        self._pending = {key: expected for key, expected in self._pending.items() if expected.poll}

    # Bytes and time in

    def feed(self, data: bytes, now: float) -> list[Happening]:
        """Process bytes that have arrived by `now` [s], detect missing replies, and return events."""
        for estimate in self.estimates:
            estimate.advance(now)
        events: list[Happening] = []
        if data:
            for message in self.parser.feed(data, now, self._last_feed):
                self._take(message, events, now)
        self._last_feed = now
        if self._request is not None and self._requested and self._request.reply is None:
            self._request = None
            events.append(Reply())
        while self._pending:
            # The pending replies are sorted by their deadlines.
            key = next(iter(self._pending))
            expected = self._pending[key]
            if expected.deadline >= now:
                break
            del self._pending[key]
            self._miss(expected.axis, expected.poll, events, now)
        return events

    # Bytes out

    def is_free(self, now: float) -> bool:
        """Return whether the line can transmit a message at `now` [s]."""
        return now >= self._free - LEAD_S - 1e-9 and now >= self._quiet

    def due(self, now: float) -> bytes:
        """Return the bytes to send at `now` [s]: at most one message, and none while the line is busy."""
        if not self.is_free(now):
            return b""
        chosen = self._next(now)
        if chosen is None:
            return b""
        device, command, data = chosen
        if self._free < now:
            self._free = now
        self._free += MESSAGE_TIME_S
        effect = self._free
        if command in (ZaberCommand.STOP, ZaberCommand.RESET, ZaberCommand.MOVE_SPEED):
            speed = data if command == ZaberCommand.MOVE_SPEED else 0
            if speed > 0 and self.line.pause > 0.0:
                self._quiet = max(self._quiet, self._free + self.line.pause)
            for i, axis in enumerate(self.axes):
                if device in (0, axis.device, axis.alias):
                    self.sent[i] = speed
                    self.estimates[i].command(speed * SPEED_UNIT, effect)
        return encode(chosen)

    def _next(self, now: float) -> ZaberMessage | None:
        if self.lost and not self._urgent and now - self._stop_repeated > REPEAT_STOP_S:
            self._stop_repeated = now
            self._urgent.extend((i, int(ZaberCommand.STOP)) for i in sorted(self.lost))
        if self._urgent:
            return self._next_urgent(now)
        request = self._request
        if request is not None and not self._requested and now >= self._away[request.axis]:
            device = self.axes[request.axis].device
            if (device, request.reply) not in self._pending:
                self._requested = True
                if request.reply is not None:
                    self._pending[device, request.reply] = _ExpectedReply(
                        now + self.line.deadline, request.axis, poll=False
                    )
                # A unit that has lost the message frame may misread this data; the pause resynchronises the unit.
                self._quiet = max(self._free, now) + MESSAGE_TIME_S + 1.25 * RESYNC_GAP_S
                return ZaberMessage(device, request.command, request.data)
        if self._since_poll < len(self.axes):
            velocity = self._next_velocity(now)
            if velocity is not None:
                self._since_poll += 1
                return velocity
        self._since_poll = 0
        poll = self._next_poll(now) if self.polling or self.stopping else None
        return poll or self._next_velocity(now)

    def _next_urgent(self, now: float) -> ZaberMessage:
        axis, command = self._urgent.popleft()
        if not self._urgent:
            # This pause resynchronises units that have lost the message frame.
            self._quiet = max(self._free, now) + MESSAGE_TIME_S + 1.25 * RESYNC_GAP_S
        for i in range(len(self.axes)) if axis < 0 else (axis,):
            self._sent_at[i] = math.inf
            if command == ZaberCommand.RESET:
                self._away[i] = now + RESTART_S
        return ZaberMessage(0 if axis < 0 else self.axes[axis].device, command, NO_DATA)

    def _next_velocity(self, now: float) -> ZaberMessage | None:
        count = len(self.axes)
        for k in range(count):
            i = (self._turn + k) % count
            desired = self._safe_speed(self._desired[i])
            if desired != self.sent[i] or now - self._sent_at[i] > REFRESH_S:
                self._turn = i + 1
                self._sent_at[i] = now
                self.stopping.pop(i, None)
                self.counts[i].velocities += 1
                if desired == 0:
                    return ZaberMessage(self._address(i), ZaberCommand.STOP, NO_DATA)
                return ZaberMessage(self._address(i), ZaberCommand.MOVE_SPEED, desired)
        return None

    def _safe_speed(self, speed: int) -> int:
        """Return `safe_speed` of a desired speed, from the cache if possible."""
        safe = self._safe_speeds.get(speed)
        if safe is None:
            safe = self._safe_speeds[speed] = safe_speed(speed, self._listeners)
        return safe

    def _address(self, axis: int) -> int:
        """Return the device number that addresses the unit of an axis: its alias during polling."""
        unit = self.axes[axis]
        return unit.alias if self.polling and unit.alias is not None else unit.device

    def _next_poll(self, now: float) -> ZaberMessage | None:
        count = len(self.axes)
        for k in range(count):
            i = (self._poll_turn + k) % count
            if i in self.lost or now < self._away[i]:
                continue
            device = self.axes[i].device
            # A stopping axis is polled alternately for its status and its position.
            status = i in self.stopping and self.counts[i].polls % 2 == 0
            command = ZaberCommand.STATUS if status else ZaberCommand.POSITION
            if (device, ZaberCommand.POSITION) in self._pending or (device, ZaberCommand.STATUS) in self._pending:
                continue
            self._poll_turn = i if self.estimates[i].doubtful else i + 1
            read = max(self._free, now) + MESSAGE_TIME_S
            deadline = now + self.line.deadline
            self._pending[device, command] = _ExpectedReply(deadline, i, True, read + MESSAGE_TIME_S, self._free < now)
            self.counts[i].polls += 1
            if not status:
                self.estimates[i].expect(read)
            return ZaberMessage(self._address(i), command, NO_DATA)
        return None

    def _plausible(self, message: ZaberMessage) -> bool:
        """Return whether a message is an expected or unsolicited reply from a unit of this chain."""
        device, command, data = message
        if (device, command) in self._pending:
            return command != ZaberCommand.POSITION or -MAX_POSITION <= data <= MAX_POSITION
        if device not in self._index:
            return False
        if command == ZaberCommand.ERROR:
            return data in ERRORS or 4000 <= data <= 4031
        return command in UNSOLICITED and -MAX_POSITION <= data <= MAX_POSITION

    def _take(self, message: ZaberMessage, events: list[Happening], now: float) -> None:
        device, command, data = message
        axis, request = self._index[device], self._request
        expected = self._pending.get((device, command))
        if expected is None:
            if command == ZaberCommand.ERROR:
                if request is not None and request.axis == axis:  # the error may belong to the previous setting
                    self._pending.pop((device, request.reply or -1), None)
                    self._request = None
                    events.append(Reply(error=data))
                else:
                    events.append(UnsolicitedError(axis, data))
            return
        if expected.poll and command == ZaberCommand.STATUS and data not in STATUSES:
            self.counts[axis].rejected += 1
            return  # the deadline remains
        del self._pending[device, command]
        self._misses[axis] = 0
        if expected.poll:
            # A backlog delays the time at which the line is free.
            self._free += self._backlog.observe(now - expected.due, expected.idle)
        if not expected.poll:
            self._request = None
            events.append(Reply(data))
        elif command == ZaberCommand.STATUS:
            self._check_stop(axis, data, events)
        elif self.estimates[axis].correct(data):
            self.counts[axis].readings += 1
        else:
            self._doubt(axis, events)

    def _doubt(self, axis: int, events: list[Happening]) -> None:
        """Process an implausible position reading: the reading, or an earlier command, was damaged in transit."""
        self.counts[axis].rejected += 1
        self._poll_turn = axis
        if self._sent_at[axis] < math.inf:
            self._sent_at[axis] = -math.inf  # repeat the velocity
        if self.estimates[axis].rejected >= MAX_UNEXPECTED_READINGS:
            self.estimates[axis].forget()
            events.append(UnexpectedMotion(axis))

    def _check_stop(self, axis: int, status: int, events: list[Happening]) -> None:
        """Process the status of a stopping axis: repeat the stop if the unit ignored it."""
        if status == ZaberStatus.IDLE:
            self.stopping.pop(axis, None)
        elif axis in self.stopping and status != ZaberStatus.STOPPING:
            self.stopping[axis] += 1
            if status == ZaberStatus.HOMING and self.stopping[axis] >= STOP_ATTEMPTS:
                self.stopping[axis] = 0
                self._urgent.append((axis, ZaberCommand.RESET))
                events.append(ResetDone(axis))
            else:
                self._urgent.append((axis, ZaberCommand.STOP))

    def _miss(self, axis: int, poll: bool, events: list[Happening], now: float) -> None:
        self.counts[axis].missed += 1
        # The units may have lost the message frame; this pause resynchronises them.
        self._quiet = max(self._quiet, max(self._free, now) + 1.25 * RESYNC_GAP_S)
        if not poll:
            self._request = None
            events.append(Reply())
            return
        self._poll_turn = axis
        self._misses[axis] += 1
        if self._misses[axis] >= MAX_MISSES and axis not in self.lost:
            self.lost.add(axis)
            self.stopping.pop(axis, None)
            events.append(ReplyLost(axis))
