"""A Zaber daisy chain as the host sees it: what to send when, and where the axes are. Sans-I/O.

The line carries 160 messages a second. Of three velocities one poll is made: 40 velocities and 13 polls
a second for each of three axes. A velocity waits in one place per axis, where the latest wins, never in a
queue; a stop goes before everything.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from station.devices.zaber.backlog import Backlog
from station.devices.zaber.dialogue import Answer, Ask, Complaint, Happening, Lost, ResetDone, UnexpectedMotion
from station.devices.zaber.estimate import UNEXPECTED_READINGS, Estimate
from station.devices.zaber.protocol import (
    ACCELERATION_UNIT,
    ERRORS,
    GAP,
    MESSAGE_TIME,
    MOST_POSITION,
    SPEED_UNIT,
    Command,
    Message,
    Parser,
    Status,
    encode,
)
from station.devices.zaber.shifts import IGNORED, sayable

STATUSES = frozenset(int(status) for status in Status)
#: Replies that nobody waits for, or that come late.
UNSOLICITED = frozenset(
    {
        *(Command.HOME, Command.MOVE_TRACKING, Command.LIMIT_ACTIVE, Command.MANUAL_MOVE),
        *(Command.MOVE_ABSOLUTE, Command.MOVE_RELATIVE, Command.MOVE_SPEED, Command.STOP),
        *(Command.SET_MODE, Command.SET_ACCELERATION, Command.SET_MAXIMUM, Command.SET_POSITION),
        *(Command.SET_RESOLUTION, Command.SET_HOME_SPEED, Command.SET_HOME_OFFSET),
    }
)


@dataclass(frozen=True)
class Axis:
    """What the scheduler knows of a unit."""

    device: int  #: its number on the chain, 1 ... 254
    top: int  #: largest speed that is sent [speed units]
    acceleration: int  #: as set in the unit [acceleration units]
    maximum: int  #: maximum position as set in the unit [microsteps]
    alias: int | None = None  #: its second number, by which it is called once positions are asked for


@dataclass(frozen=True)
class Line:
    """Times of the line; the manufacturer gives none for the unit and the adapter, so they can be changed."""

    lead: float = 0.002  #: a message is handed over so long before the line is free [s]
    processing: float = 0.0  #: from the last byte of a command to its effect [s]
    deadline: float = 0.050  #: for a reply, from the start of its request [s]
    misses: int = 2  #: replies in a row whose absence means that a unit is lost
    #: A reply with a longer silence inside is dropped [s]: not the 10 ms that the manufacturer recommends, since
    #: a USB adapter may hold bytes back for 16 ms.
    silence: float = 0.025
    pause: float = 0.0  #: after each forward speed; 0.0125 and more excludes any misreading (`shifts.py`) [s]
    refresh: float = 0.25  #: an unchanged velocity is repeated after that, in case it was not heard [s]
    stop_tries: int = 3  #: stops that a homing unit may ignore before it is reset
    restart: float = 1.0  #: a unit says nothing after a reset [s]
    repeat_stop: float = 0.25  #: lost units are told to stop so often, in case they hear again [s]


@dataclass
class Counts:
    """What an axis has got."""

    velocities: int = 0
    polls: int = 0
    readings: int = 0  #: positions accepted
    rejected: int = 0  #: positions that nothing confirmed
    missed: int = 0


class _Waited(NamedTuple):
    """A reply that should come."""

    deadline: float  #: [s]
    axis: int
    poll: bool
    due: float = 0.0  #: when its last byte is expected [s]
    idle: bool = True  #: its request found the line idle


class Chain:
    """The units on one line."""

    def __init__(self, axes: Sequence[Axis], line: Line | None = None) -> None:
        line = line or Line()
        self.axes, self.line = tuple(axes), line
        self.parser = Parser(self._plausible, line.silence)
        count = range(len(self.axes))
        self.estimates = [
            Estimate(axis.top * SPEED_UNIT, axis.acceleration * ACCELERATION_UNIT, axis.maximum) for axis in self.axes
        ]
        self.counts = [Counts() for _ in count]
        self.sent = [0 for _ in count]  #: speeds that went out [speed units]
        self.lost: set[int] = set()
        self.polling = False  #: positions are asked for
        self.stopping: dict[int, int] = {}  #: axes told to stop that have not said that they rest, and tries
        self._index = {axis.device: i for i, axis in enumerate(self.axes)}
        self._listeners = {number for axis in self.axes for number in (axis.device, axis.alias or axis.device)}
        self._sayable: dict[int, int] = {}  # of the speeds so far
        self._wanted = [0 for _ in count]
        self._sent_at: list[float] = [math.inf for _ in count]  # infinite: not under way
        self._misses = [0 for _ in count]
        self._away: list[float] = [-math.inf for _ in count]
        self._urgent: deque[tuple[int, int]] = deque()  # axis (-1: all), command
        self._ask: Ask | None = None
        self._asked = False
        self._pending: dict[tuple[int, int], _Waited] = {}
        self._backlog = Backlog()
        self._turn = self._poll_turn = 0
        self._since_poll = 0
        self._free = self._quiet = self._looked = self._told_again = -math.inf

    # What the driver asks for

    def command(self, axis: int, speed: int) -> None:
        """A speed for an axis [speed units]; the latest wins, when its turn comes."""
        top = self.axes[axis].top
        speed = speed if -top <= speed <= top else int(math.copysign(top, speed))
        wanted = self._sayable.get(speed)
        if wanted is None:
            wanted = self._sayable[speed] = sayable(speed, self._listeners)
        self._wanted[axis] = wanted

    def stop(self) -> None:
        """Stop every axis before anything else is sent, and see that they do."""
        self._wanted = [0 for _ in self.axes]
        self.cancel()
        reachable = [i for i in range(len(self.axes)) if i not in self.lost]
        if all(i in self.stopping for i in reachable) and (reachable or self._urgent):
            return  # they have been told and are being watched
        # One message reaches all; then each again, because nothing tells whether it was heard.
        self._urgent = deque([(-1, Command.STOP), *((i, Command.STOP) for i in range(len(self.axes)))])
        self.stopping = dict.fromkeys(reachable, 0)

    def ask(self, ask: Ask) -> None:
        """Send one question or setting; its `Answer` comes out of `feed`. One at a time."""
        self._ask, self._asked = ask, False

    def cancel(self) -> None:
        """Wait for no answer any more."""
        self._ask = None
        self._pending = {key: waited for key, waited in self._pending.items() if waited.poll}

    # Bytes and time in

    def feed(self, data: bytes, now: float) -> list[Happening]:
        """Take in bytes that have arrived by `now` [s]; notices what has not."""
        for estimate in self.estimates:
            estimate.advance(now)
        happenings: list[Happening] = []
        if data:
            for message in self.parser.feed(data, now, self._looked):
                self._take(message, happenings, now)
        self._looked = now
        if self._ask is not None and self._asked and self._ask.reply is None:
            self._ask = None
            happenings.append(Answer())
        while self._pending:
            # They wait in the order of their deadlines.
            key = next(iter(self._pending))
            waited = self._pending[key]
            if waited.deadline >= now:
                break
            del self._pending[key]
            self._miss(waited.axis, waited.poll, happenings, now)
        return happenings

    # Bytes out

    def is_free(self, now: float) -> bool:
        """Whether the line would take a message at `now` [s]."""
        return now >= self._free - self.line.lead - 1e-9 and now >= self._quiet

    def due(self, now: float) -> bytes:
        """What goes out at `now` [s]: one message at most, and none while the line is busy."""
        if not self.is_free(now):
            return b""
        chosen = self._next(now)
        if chosen is None:
            return b""
        device, command, data = chosen
        if self._free < now:
            self._free = now
        self._free += MESSAGE_TIME
        effect = self._free + self.line.processing
        if command in (Command.STOP, Command.RESET, Command.MOVE_SPEED):
            speed = data if command == Command.MOVE_SPEED else 0
            if speed > 0 and self.line.pause > 0.0:
                self._quiet = max(self._quiet, self._free + self.line.pause)
            for i, axis in enumerate(self.axes):
                if device in (0, axis.device, axis.alias):
                    self.sent[i] = speed
                    self.estimates[i].command(speed * SPEED_UNIT, effect)
        return encode(chosen)

    def _next(self, now: float) -> Message | None:
        if self.lost and not self._urgent and now - self._told_again > self.line.repeat_stop:
            self._told_again = now
            self._urgent.extend((i, int(Command.STOP)) for i in sorted(self.lost))
        if self._urgent:
            return self._next_urgent(now)
        ask = self._ask
        if ask is not None and not self._asked and now >= self._away[ask.axis]:
            device = self.axes[ask.axis].device
            if (device, ask.reply) not in self._pending:
                self._asked = True
                if ask.reply is not None:
                    self._pending[device, ask.reply] = _Waited(now + self.line.deadline, ask.axis, poll=False)
                # Its data may read as anything to a unit that has lost the frame: in a pause it finds it again.
                self._quiet = max(self._free, now) + MESSAGE_TIME + 1.25 * GAP
                return Message(device, ask.command, ask.data)
        if self._since_poll < len(self.axes):
            velocity = self._next_velocity(now)
            if velocity is not None:
                self._since_poll += 1
                return velocity
        self._since_poll = 0
        poll = self._next_poll(now) if self.polling or self.stopping else None
        return poll or self._next_velocity(now)

    def _next_urgent(self, now: float) -> Message:
        axis, command = self._urgent.popleft()
        if not self._urgent:
            # Units that lost the frame find it again in this pause.
            self._quiet = max(self._free, now) + MESSAGE_TIME + 1.25 * GAP
        for i in range(len(self.axes)) if axis < 0 else (axis,):
            self._sent_at[i] = math.inf
            if command == Command.RESET:
                self._away[i] = now + self.line.restart
        return Message(0 if axis < 0 else self.axes[axis].device, command, IGNORED)

    def _next_velocity(self, now: float) -> Message | None:
        count = len(self.axes)
        for k in range(count):
            i = (self._turn + k) % count
            wanted = self._wanted[i]
            if wanted != self.sent[i] or now - self._sent_at[i] > self.line.refresh:
                self._turn = i + 1
                self._sent_at[i] = now
                self.stopping.pop(i, None)
                self.counts[i].velocities += 1
                if wanted == 0:
                    return Message(self._address(i), Command.STOP, IGNORED)
                return Message(self._address(i), Command.MOVE_SPEED, wanted)
        return None

    def _address(self, axis: int) -> int:
        """The number to call a unit by."""
        own = self.axes[axis]
        return own.alias if self.polling and own.alias is not None else own.device

    def _next_poll(self, now: float) -> Message | None:
        count = len(self.axes)
        for k in range(count):
            i = (self._poll_turn + k) % count
            if i in self.lost or now < self._away[i]:
                continue
            device = self.axes[i].device
            # A stopping axis is asked in turn whether it rests and where.
            status = i in self.stopping and self.counts[i].polls % 2 == 0
            command = Command.STATUS if status else Command.POSITION
            if (device, Command.POSITION) in self._pending or (device, Command.STATUS) in self._pending:
                continue
            self._poll_turn = i if self.estimates[i].doubtful else i + 1
            read = max(self._free, now) + MESSAGE_TIME + self.line.processing
            deadline = now + self.line.deadline
            self._pending[device, command] = _Waited(deadline, i, True, read + MESSAGE_TIME, self._free < now)
            self.counts[i].polls += 1
            if not status:
                self.estimates[i].expect(read)
            return Message(self._address(i), command, IGNORED)
        return None

    def _plausible(self, message: Message) -> bool:
        """A reply that is waited for or may come by itself, from a unit of this chain."""
        device, command, data = message
        if (device, command) in self._pending:
            return command != Command.POSITION or -MOST_POSITION <= data <= MOST_POSITION
        if device not in self._index:
            return False
        if command == Command.ERROR:
            return data in ERRORS or 4000 <= data <= 4031
        return command in UNSOLICITED and -MOST_POSITION <= data <= MOST_POSITION

    def _take(self, message: Message, happenings: list[Happening], now: float) -> None:
        device, command, data = message
        axis, ask = self._index[device], self._ask
        waited = self._pending.get((device, command))
        if waited is None:
            if command == Command.ERROR:
                if ask is not None and ask.axis == axis:  # perhaps it is about the setting before
                    self._pending.pop((device, ask.reply or -1), None)
                    self._ask = None
                    happenings.append(Answer(error=data))
                else:
                    happenings.append(Complaint(axis, data))
            return
        if waited.poll and command == Command.STATUS and data not in STATUSES:
            self.counts[axis].rejected += 1
            return  # the deadline goes on
        del self._pending[device, command]
        self._misses[axis] = 0
        if waited.poll:
            # The line is free so much later than it was believed to be.
            self._free += self._backlog.heard(now - waited.due, waited.idle)
        if not waited.poll:
            self._ask = None
            happenings.append(Answer(data))
        elif command == Command.STATUS:
            self._see_stop(axis, data, happenings)
        elif self.estimates[axis].correct(data):
            self.counts[axis].readings += 1
        else:
            self._doubt(axis, happenings)

    def _doubt(self, axis: int, happenings: list[Happening]) -> None:
        """A reading that was not expected: it, or a command before it, was damaged on its way."""
        self.counts[axis].rejected += 1
        self._poll_turn = axis
        if self._sent_at[axis] < math.inf:
            self._sent_at[axis] = -math.inf  # say the velocity again
        if self.estimates[axis].rejected >= UNEXPECTED_READINGS:
            self.estimates[axis].forget()
            happenings.append(UnexpectedMotion(axis))

    def _see_stop(self, axis: int, status: int, happenings: list[Happening]) -> None:
        """What a stopping axis says that it does."""
        if status == Status.IDLE:
            self.stopping.pop(axis, None)
        elif axis in self.stopping and status != Status.STOPPING:
            self.stopping[axis] += 1
            if status == Status.HOMING and self.stopping[axis] >= self.line.stop_tries:
                self.stopping[axis] = 0
                self._urgent.append((axis, Command.RESET))
                happenings.append(ResetDone(axis))
            else:
                self._urgent.append((axis, Command.STOP))

    def _miss(self, axis: int, poll: bool, happenings: list[Happening], now: float) -> None:
        self.counts[axis].missed += 1
        # The units may have lost the frame; in a pause they find it again.
        self._quiet = max(self._quiet, max(self._free, now) + 1.25 * GAP)
        if not poll:
            self._ask = None
            happenings.append(Answer())
            return
        self._poll_turn = axis
        self._misses[axis] += 1
        if self._misses[axis] >= self.line.misses and axis not in self.lost:
            self.lost.add(axis)
            self.stopping.pop(axis, None)
            happenings.append(Lost(axis))
