"""The host's side of a chain of Zaber ASCII devices: schedules commands and estimates positions. Without I/O.

Every command is answered, so an axis receives its next command when it has answered the last one. The host sends one
position query after as many velocities as the chain has axes. Velocities are not queued: a newer velocity replaces the
pending velocity of its axis. A stop precedes all other commands.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from station.devices.stages_on_line import AxisLost
from station.devices.zaber.chain import LEAD_S, REFRESH_S, REPEAT_STOP_S, LineCounts
from station.devices.zaber.estimate import MAX_UNEXPECTED_READINGS, AxisEstimate
from station.devices.zaber_ascii.protocol import (
    ACCELERATION_FACTOR,
    BYTE_TIME_S,
    MAX_ID,
    SPEED_FACTOR,
    Alert,
    LineReader,
    Reply,
    encode,
)

MAX_MISSES = 4  #: missing replies in a row after which an axis counts as lost
#: Rejections of a velocity in a row that are reported; single ones are caused by a damaged line.
MAX_REJECTIONS = 3
#: Time after which a stop is repeated if the axis still moves: longer than a stage brakes, because some firmware takes
#: a second stop for an abrupt one [s].
REPEAT_UNCONFIRMED_STOP_S = 1.0
#: Default of the longest time from sending a command to its reply: a USB adapter may delay bytes by 16 ms [s].
DEADLINE_S = 0.030


@dataclass(frozen=True)
class Axis:
    """Parameters of one axis that the scheduler needs."""

    device: int  #: address of the device on the chain, 1 ... 99
    number: int  #: number of the axis on its device, 1 ... 9
    top: int  #: largest speed that the host sends [speed data]
    acceleration: int  #: acceleration setting [acceleration data]
    minimum: int  #: setting limit.min [microsteps]
    maximum: int  #: setting limit.max [microsteps]


class Request(NamedTuple):
    """One query, setting or motion of one axis or of its device."""

    axis: int
    text: str
    whole_device: bool = False


class Answer(NamedTuple):
    """Result of a `Request`; without a reply in time it is a rejection without data."""

    accepted: bool = False
    data: str = ""
    busy: bool = False
    flag: str = ""


class UnexpectedMotion(NamedTuple):
    """Event: an axis does not move as commanded."""

    axis: int


class FlagChanged(NamedTuple):
    """Event: an axis reports another warning flag than before."""

    axis: int
    flag: str


class Rejected(NamedTuple):
    """Event: an axis has rejected its velocity several times."""

    axis: int
    reason: str


Event = Answer | AxisLost | UnexpectedMotion | FlagChanged | Rejected


class _Sent(NamedTuple):
    """A command whose reply is expected."""

    axis: int
    kind: Literal["velocity", "position", "request"]
    deadline: float  #: time after which the reply counts as missing [s]


class AsciiChain:
    """The axes on one serial line: sends their commands and processes their replies."""

    def __init__(self, axes: Sequence[Axis], deadline: float = DEADLINE_S) -> None:
        self.axes = tuple(axes)
        self.reader = LineReader()
        count = range(len(self.axes))
        #: Estimates of the positions, counted from each axis's minimum [microsteps].
        self.estimates = [
            AxisEstimate(axis.top / SPEED_FACTOR, axis.acceleration / ACCELERATION_FACTOR, axis.maximum - axis.minimum)
            for axis in self.axes
        ]
        self.counts = [LineCounts() for _ in count]
        self.sent = [0 for _ in count]  #: last speed sent to each axis [speed data]
        self.flags = ["" for _ in count]  #: last warning flag of each axis; "" before its first message
        self.lost: set[int] = set()  #: axes that no longer answer
        self.stopping: dict[int, float] = {}  #: axes with an unconfirmed stop, and when it was sent [s]
        self.polling = False  #: whether the host polls positions
        self._deadline = deadline
        self._index = {(axis.device, axis.number): i for i, axis in enumerate(self.axes)}
        self._desired = [0 for _ in count]
        self._sent_at: list[float] = [math.inf for _ in count]  # of the last velocity; infinite: not moving
        self._misses = [0 for _ in count]
        self._rejections = [0 for _ in count]
        self._pending: dict[int, _Sent] = {}  # by message ID, in the order of sending
        self._waiting: set[int] = set()  # axes with a pending command
        self._request: Request | None = None
        self._requested = self._urgent = False
        self._identity = self._turn = self._poll_turn = self._since_poll = 0
        self._free = self._stop_repeated = -math.inf

    # Commands of the driver

    def command(self, axis: int, speed: int) -> None:
        """Set the speed of an axis [speed data]; `due` sends the latest speed when line and axis are free."""
        top = self.axes[axis].top
        self._desired[axis] = min(max(speed, -top), top)

    def stop(self) -> None:
        """Stop all axes before any other command, and poll each axis until it confirms its stop."""
        self._desired = [0 for _ in self.axes]
        self.cancel()
        reachable = [i for i in range(len(self.axes)) if i not in self.lost]
        if self._urgent or (reachable and all(i in self.stopping for i in reachable)):
            return
        self._urgent = True
        self.stopping = dict.fromkeys(reachable, math.inf)

    def send_request(self, request: Request) -> None:
        """Send one request; `feed` returns its `Answer`. Only one request can be pending."""
        self._request, self._requested = request, False

    def cancel(self) -> None:
        """Cancel the pending request."""
        self._request = None
        for identity in [key for key, sent in self._pending.items() if sent.kind == "request"]:
            self._forget(identity)

    def give_up(self) -> None:
        """Count every axis as lost, because the port is lost."""
        self.stopping.clear()
        self.lost |= set(range(len(self.axes)))

    # Bytes and time in

    def feed(self, data: bytes, now: float) -> list[Event]:
        """Process bytes that have arrived by `now` [s], detect missing replies, and return events."""
        for estimate in self.estimates:
            estimate.advance(now)
        events: list[Event] = []
        for message in self.reader.feed(data):
            self._take(message, events, now)
        while self._pending:
            identity, sent = next(iter(self._pending.items()))
            if sent.deadline >= now:
                break
            self._forget(identity)
            self._miss(sent, events)
        return events

    # Bytes out

    def is_free(self, now: float) -> bool:
        """Return whether the line can transmit a command at `now` [s]."""
        return now >= self._free - LEAD_S - 1e-9

    def due(self, now: float) -> bytes:
        """Return the bytes to send at `now` [s]: at most one command, and none while the line is busy."""
        if not self.is_free(now):
            return b""
        if self._urgent or (self.lost and now - self._stop_repeated > REPEAT_STOP_S):
            return self._stop_all(now)
        return self._next_request(now) or self._next_motion(now)

    def _stop_all(self, now: float) -> bytes:
        """Return the stop of every axis on the chain."""
        self._urgent, self._stop_repeated = False, now
        # A reply to an earlier command must not count as the confirmation of this stop.
        for identity in [key for key, sent in self._pending.items() if sent.kind != "request"]:
            self._forget(identity)
        data = self._line(0, 0, "stop", now)
        self.stopping = dict.fromkeys(self.stopping, now)
        for i, estimate in enumerate(self.estimates):
            self.sent[i], self._sent_at[i] = 0, math.inf
            estimate.command(0.0, self._free)
        return data

    def _next_request(self, now: float) -> bytes:
        request = self._request
        if request is None or self._requested or request.axis in self._waiting:
            return b""
        self._requested = True
        number = 0 if request.whole_device else self.axes[request.axis].number
        data = self._line(self.axes[request.axis].device, number, request.text, now)
        self._expect(request.axis, "request", now)
        return data

    def _next_motion(self, now: float) -> bytes:
        """Return the next velocity or position query."""
        if self._since_poll < len(self.axes) and (velocity := self._next_velocity(now)):
            self._since_poll += 1
            return velocity
        self._since_poll = 0
        poll = self._next_poll(now) if self.polling or self.stopping else b""
        return poll or self._next_velocity(now)

    def _next_velocity(self, now: float) -> bytes:
        count = len(self.axes)
        for k in range(count):
            i = (self._turn + k) % count
            desired = self._desired[i]
            if i in self._waiting or (desired == self.sent[i] and now - self._sent_at[i] <= REFRESH_S):
                continue
            self._turn, self._sent_at[i], self.sent[i] = i + 1, now, desired
            self.stopping.pop(i, None)
            self.counts[i].velocities += 1
            data = self._to(i, "stop" if desired == 0 else f"move vel {desired}", now)
            self._expect(i, "velocity", now)
            self.estimates[i].command(desired / SPEED_FACTOR, self._free)
            return data
        return b""

    def _next_poll(self, now: float) -> bytes:
        count = len(self.axes)
        for k in range(count):
            i = (self._poll_turn + k) % count
            if i in self._waiting or i in self.lost:
                continue
            self._poll_turn = i if self.estimates[i].doubtful else i + 1
            self.counts[i].polls += 1
            data = self._to(i, "get pos", now)
            self._expect(i, "position", now)
            self.estimates[i].expect(self._free)
            return data
        return b""

    def _to(self, i: int, text: str, now: float) -> bytes:
        return self._line(self.axes[i].device, self.axes[i].number, text, now)

    def _line(self, device: int, axis: int, text: str, now: float) -> bytes:
        self._identity = (self._identity + 1) % (MAX_ID + 1)
        if self._identity in self._pending:
            self._forget(self._identity)
        data = encode(device, axis, self._identity, text)
        self._free = max(self._free, now) + len(data) * BYTE_TIME_S
        return data

    def _expect(self, axis: int, kind: Literal["velocity", "position", "request"], now: float) -> None:
        self._pending[self._identity] = _Sent(axis, kind, now + self._deadline)
        self._waiting.add(axis)

    def _forget(self, identity: int) -> None:
        self._waiting.discard(self._pending.pop(identity).axis)

    # Replies

    def _take(self, message: Reply | Alert, events: list[Event], now: float) -> None:
        axes = (
            [i for i, axis in enumerate(self.axes) if axis.device == message.device]
            if message.axis == 0
            else [i for i in [self._index.get((message.device, message.axis))] if i is not None]
        )
        for i in axes:
            if message.flag != self.flags[i]:
                self.flags[i] = message.flag
                events.append(FlagChanged(i, message.flag))
        if isinstance(message, Alert) or message.identity is None:
            return
        sent = self._pending.get(message.identity)
        if sent is None or sent.axis not in axes:
            return
        self._forget(message.identity)
        i = sent.axis
        self._misses[i] = 0
        if i in self.stopping and sent.kind == "position":
            self._check_stop(i, message.busy, now)
        if sent.kind == "request":
            self._request = None
            events.append(Answer(message.accepted, message.data, message.busy, message.flag))
        elif sent.kind == "velocity":
            self._rejections[i] = 0 if message.accepted else self._rejections[i] + 1
            if not message.accepted:
                self._sent_at[i] = -math.inf  # the velocity is sent again
            if self._rejections[i] >= MAX_REJECTIONS:
                events.append(Rejected(i, message.data))
        elif message.accepted and message.data.lstrip("-").isdigit():
            self._read_position(i, int(message.data), events)
        else:
            self.counts[i].rejected += 1

    def _read_position(self, i: int, position: int, events: list[Event]) -> None:
        if self.estimates[i].correct(position - self.axes[i].minimum):
            self.counts[i].readings += 1
            return
        # The reading is implausible: the stage was moved otherwise, or did not receive its velocity.
        self.counts[i].rejected += 1
        self._poll_turn = i
        if self._sent_at[i] < math.inf:
            self._sent_at[i] = -math.inf
        if self.estimates[i].rejected >= MAX_UNEXPECTED_READINGS:
            self.estimates[i].forget()
            events.append(UnexpectedMotion(i))

    def _check_stop(self, i: int, busy: bool, now: float) -> None:
        """Process the status of a stopping axis: repeat the stop if the axis continues to move."""
        if not busy:
            del self.stopping[i]
        elif now - self.stopping[i] > REPEAT_UNCONFIRMED_STOP_S:
            self._urgent = True

    def _miss(self, sent: _Sent, events: list[Event]) -> None:
        i = sent.axis
        self.counts[i].missed += 1
        if sent.kind == "velocity":
            self._sent_at[i] = -math.inf  # the velocity is sent again
        if sent.kind == "request":
            self._request = None
            events.append(Answer())
            return
        self._misses[i] += 1
        if self._misses[i] >= MAX_MISSES and i not in self.lost:
            self.lost.add(i)
            self.stopping.pop(i, None)
            events.append(AxisLost(i, f"{MAX_MISSES} replies of a device are missing"))
