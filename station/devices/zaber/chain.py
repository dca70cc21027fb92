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

from station.devices.kernel.estimate import AxisEstimate
from station.devices.kernel.line import LEAD_S, REPEAT_STOP_S, LineAxes, Turns
from station.devices.zaber.backlog import Backlog
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
    Request,
    ResetDone,
    UnsolicitedError,
    ZaberCommand,
    ZaberMessage,
    ZaberParser,
    ZaberStatus,
    encode,
    safe_speed,
)

# Times of units and adapter; the manufacturer does not specify them.
MAX_MISSES = 2  #: missing replies in a row after which a unit counts as lost
#: A reply is dropped if its bytes have a longer gap between them [s]. The manufacturer recommends 10 ms, but a USB
#: adapter may delay bytes by 16 ms.
REPLY_GAP_S = 0.025
STOP_ATTEMPTS = 3  #: number of stop commands that a homing unit may ignore before the host resets the unit
RESTART_S = 1.0  #: time after a reset in which a unit does not answer [s]
STATUSES = frozenset(int(status) for status in ZaberStatus)
#: Command numbers of messages that a unit may send without a request, or later than expected.
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
        self.units, self.line = tuple(axes), line or LineSettings()
        self.parser = ZaberParser(self._plausible, REPLY_GAP_S)
        self.axes = LineAxes(
            AxisEstimate(axis.top * SPEED_UNIT, axis.acceleration * ACCELERATION_UNIT, axis.maximum)
            for axis in self.units
        )
        self.polling = False  #: whether the host polls positions
        self._index = {axis.device: i for i, axis in enumerate(self.units)}
        self._listeners = {number for axis in self.units for number in (axis.device, axis.alias or axis.device)}
        self._safe_speeds: dict[int, int] = {}  # cache of `safe_speed`
        self._turns = Turns(self.axes, MAX_MISSES)
        self._away: list[float] = [-math.inf for _ in self.units]
        self._urgent: deque[tuple[int, int]] = deque()  # axis (-1: all), command
        self._request: Request | None = None
        self._requested = False
        self._pending: dict[tuple[int, int], _ExpectedReply] = {}
        self._backlog = Backlog()
        self._free = self._quiet = self._last_feed = self._stop_repeated = -math.inf

    # Commands from the driver

    def command(self, axis: int, speed: int) -> None:
        """Set the speed of an axis [speed units]; `due` sends the latest speed when the line is free."""
        top = self.units[axis].top
        self._turns.desired[axis] = self._safe_speed(min(max(speed, -top), top))

    def stop(self) -> None:
        """Send stops to all axes before any other message, and poll each axis until it confirms its stop."""
        self._turns.desired = [0 for _ in self.units]
        self.cancel()
        reachable = self.axes.reachable
        if all(i in self.axes.stopping for i in reachable) and (reachable or self._urgent):
            return  # all axes have been commanded to stop and are polled
        self.send_stops()
        self.axes.stopping = dict.fromkeys(reachable, 0)

    def send_stops(self) -> None:
        """Send stops to all axes before any other message, also to units that may not answer; await no confirmation."""
        # One message stops all units. Then each unit gets its own stop, because no unit confirms the common one.
        self._urgent = deque([(-1, ZaberCommand.STOP), *((i, ZaberCommand.STOP) for i in range(len(self.units)))])

    def send_request(self, request: Request) -> None:
        """Send one query or setting; `feed` returns its `Reply`. Only one request can be pending."""
        self._request, self._requested = request, False

    def cancel(self) -> None:
        """Cancel the pending request."""
        self._request = None
        self._pending = {key: expected for key, expected in self._pending.items() if expected.poll}

    # Input: received bytes and the time

    def feed(self, data: bytes, now: float) -> list[Happening]:
        """Process bytes that have arrived by `now` [s], detect missing replies, and return events."""
        self.axes.advance(now)
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

    # Output: bytes to send

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
            for i, axis in enumerate(self.units):
                if device in (0, axis.device, axis.alias):
                    self.axes.sent[i] = speed
                    self.axes.estimates[i].command(speed * SPEED_UNIT, effect)
        return encode(chosen)

    def _next(self, now: float) -> ZaberMessage | None:
        if self.axes.lost and not self._urgent and now - self._stop_repeated > REPEAT_STOP_S:
            self._stop_repeated = now
            self._urgent.extend((i, int(ZaberCommand.STOP)) for i in sorted(self.axes.lost))
        if self._urgent:
            return self._next_urgent(now)
        request = self._request
        if request is not None and not self._requested and now >= self._away[request.axis]:
            device = self.units[request.axis].device
            if (device, request.reply) not in self._pending:
                self._requested = True
                if request.reply is not None:
                    self._pending[device, request.reply] = _ExpectedReply(
                        now + self.line.deadline, request.axis, poll=False
                    )
                # A unit that has lost the message boundaries may misread these data; the pause resynchronises the unit.
                self._quiet = max(self._free, now) + MESSAGE_TIME_S + 1.25 * RESYNC_GAP_S
                return ZaberMessage(device, request.command, request.data)
        polls = self.polling or self.axes.stopping
        return self._turns.message(lambda: self._next_velocity(now), (lambda: self._next_poll(now)) if polls else None)

    def _next_urgent(self, now: float) -> ZaberMessage:
        axis, command = self._urgent.popleft()
        if not self._urgent:
            # This pause resynchronises units that have lost the message boundaries.
            self._quiet = max(self._free, now) + MESSAGE_TIME_S + 1.25 * RESYNC_GAP_S
        for i in range(len(self.units)) if axis < 0 else (axis,):
            self._turns.sent_at[i] = math.inf
            if command == ZaberCommand.RESET:
                self._away[i] = now + RESTART_S
        return ZaberMessage(0 if axis < 0 else self.units[axis].device, command, NO_DATA)

    def _next_velocity(self, now: float) -> ZaberMessage | None:
        i = self._turns.velocity(now)
        if i is None:
            return None
        desired = self._turns.desired[i]
        if desired == 0:
            return ZaberMessage(self._address(i), ZaberCommand.STOP, NO_DATA)
        return ZaberMessage(self._address(i), ZaberCommand.MOVE_SPEED, desired)

    def _safe_speed(self, speed: int) -> int:
        """Return `safe_speed` of a desired speed, from the cache if possible."""
        safe = self._safe_speeds.get(speed)
        if safe is None:
            safe = self._safe_speeds[speed] = safe_speed(speed, self._listeners)
        return safe

    def _address(self, axis: int) -> int:
        """Return the device number that addresses the unit of an axis: its alias during polling."""
        unit = self.units[axis]
        return unit.alias if self.polling and unit.alias is not None else unit.device

    def _next_poll(self, now: float) -> ZaberMessage | None:
        i = self._turns.poll(lambda i: now < self._away[i] or self._polled(self.units[i].device))
        if i is None:
            return None
        # A stopping axis is polled alternately for its status and its position.
        status = i in self.axes.stopping and self.axes.counts[i].polls % 2 == 1
        command = ZaberCommand.STATUS if status else ZaberCommand.POSITION
        read, deadline = max(self._free, now) + MESSAGE_TIME_S, now + self.line.deadline
        expected = _ExpectedReply(deadline, i, True, read + MESSAGE_TIME_S, self._free < now)
        self._pending[self.units[i].device, command] = expected
        if not status:
            self.axes.estimates[i].expect(read)
        return ZaberMessage(self._address(i), command, NO_DATA)

    def _polled(self, device: int) -> bool:
        """Return whether a unit has not answered its last poll yet."""
        return (device, ZaberCommand.POSITION) in self._pending or (device, ZaberCommand.STATUS) in self._pending

    def _plausible(self, message: ZaberMessage) -> bool:
        """Return whether a message is an expected or unsolicited reply from a unit of this chain."""
        device, command, data = message
        if command == ZaberCommand.SERIAL_NUMBER and device in self._index and not self.polling:
            return True  # a second unit with this number may have sent it; `identified` detects this
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
        if command == ZaberCommand.SERIAL_NUMBER:
            self.axes.identified(axis, "serial number", data, events, 2)
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
            self.axes.counts[axis].rejected += 1
            return  # continue to wait for the reply
        del self._pending[device, command]
        self._turns.answers(axis)
        if expected.poll:
            # A backlog delays the time at which the line is free.
            self._free += self._backlog.observe(now - expected.due, expected.idle)
        if not expected.poll:
            self._request = None
            events.append(Reply(data))
        elif command == ZaberCommand.STATUS:
            self._check_stop(axis, data, events)
        else:
            self._turns.read(axis, data, events)

    def _check_stop(self, axis: int, status: int, events: list[Happening]) -> None:
        """Process the status of a stopping axis: repeat the stop if the unit ignored it."""
        if status == ZaberStatus.IDLE:
            self.axes.stopping.pop(axis, None)
        elif axis in self.axes.stopping and status != ZaberStatus.STOPPING:
            self.axes.stopping[axis] += 1
            if status == ZaberStatus.HOMING and self.axes.stopping[axis] >= STOP_ATTEMPTS:
                self.axes.stopping[axis] = 0
                self._urgent.append((axis, ZaberCommand.RESET))
                events.append(ResetDone(axis))
            else:
                self._urgent.append((axis, ZaberCommand.STOP))

    def _miss(self, axis: int, poll: bool, events: list[Happening], now: float) -> None:
        self.axes.counts[axis].missed += 1
        # The units may have lost the message boundaries; this pause resynchronises them.
        self._quiet = max(self._quiet, max(self._free, now) + 1.25 * RESYNC_GAP_S)
        if not poll:
            self._request = None
            events.append(Reply())
            return
        self._turns.poll_next(axis)
        self._turns.miss(axis, events, "a unit")
