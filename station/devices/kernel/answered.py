"""A line whose axes answer each command by one message: schedules the commands and estimates positions. Without I/O.

A command has a number, which its answer repeats. An axis receives its next command when it has answered the last one.
The host sends one position query after as many velocities as the line has axes. Velocities are not queued: a newer
velocity replaces the pending velocity of its axis. A stop precedes all other commands.

A protocol provides a `Wire`, which encodes its commands and decodes its messages. `conversation.py` has the requests
that its scripts send, and `emergency.py` has its emergency stop.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple, Protocol

from station.devices.kernel.estimate import AxisEstimate
from station.devices.kernel.line import LEAD_S, REPEAT_STOP_S, AxisLost, LineAxes, Turns, TwoDevices, UnexpectedMotion

MAX_MISSES = 4  #: missing answers in a row after which an axis counts as lost
#: Number of rejected velocities in a row that is reported; a damaged line causes single rejections.
MAX_REJECTIONS = 3
#: Time after which a stop is repeated if the axis still moves [s]: longer than the braking of a stage, because some
#: firmware stops abruptly at a second stop.
REPEAT_UNCONFIRMED_STOP_S = 1.0


class Request(NamedTuple):
    """One query, setting or motion of one axis or of its device."""

    axis: int
    text: str
    whole_device: bool = False


class Answer(NamedTuple):
    """Answer to a command; `Answer()`, a rejection without data, means that no message came in time."""

    accepted: bool = False
    data: str = ""  #: value, or the reason of a rejection
    busy: bool = False  #: whether the axis moves
    flag: str = ""  #: further state or warning of the axis, as the protocol names it


class Message(NamedTuple):
    """A message of a device."""

    axes: Sequence[int]  #: the axes that the message is about
    number: int | None  #: number of the command that the message answers; None: it answers no command
    answer: Answer


class FlagChanged(NamedTuple):
    """Event: an axis reports another flag than before."""

    axis: int
    flag: str


class Rejected(NamedTuple):
    """Event: an axis has rejected its velocity several times."""

    axis: int
    reason: str


Event = Answer | AxisLost | UnexpectedMotion | FlagChanged | Rejected | TwoDevices


class AnsweringAxis(NamedTuple):
    """An axis on the line."""

    top: int  #: largest speed that the host sends [data of a velocity command]
    minimum: int  #: lower limit of the travel [counts]
    estimate: AxisEstimate  #: estimate of the axis's position, counted from `minimum`


class Wire(Protocol):
    """Encoding of the commands of a protocol, and decoding of its messages."""

    byte_time: float  #: transmission time of a byte [s]
    max_number: int  #: largest number of a command
    stop: str  #: text of the command that stops an axis
    serial_number: str  #: text of the query of a device's serial number
    position: str  #: text of the query whose answer has the position of an axis [counts] as data

    def velocity(self, data: int) -> str:
        """Return the text of the command that moves an axis at a velocity."""
        ...

    def speed(self, data: int) -> float:
        """Convert the data of a velocity command to a speed [counts/s]."""
        ...

    def encode(self, axis: int | None, text: str, number: int, *, whole_device: bool = False) -> bytes:
        """Return the bytes of a command to an axis or to its whole device; `axis` None: to all devices."""
        ...

    def read(self, data: bytes) -> Iterable[Message]:
        """Return the messages that `data` completes, however the bytes are damaged or divided."""
        ...


class _Sent(NamedTuple):
    """A command whose answer is expected."""

    axis: int
    kind: Literal["velocity", "position", "request"]
    deadline: float  #: time after which the answer counts as missing [s]


class AnsweringLine:
    """The axes on one serial line: sends their commands and processes their answers."""

    def __init__(self, wire: Wire, axes: Sequence[AnsweringAxis], deadline: float) -> None:
        """`deadline` is the longest time from sending a command to its answer [s]."""
        self.wire, self._setups, self.axes = wire, tuple(axes), LineAxes(axis.estimate for axis in axes)
        self.flags = ["" for _ in axes]  #: last warning flag of each axis; "" before its first message
        self.polling = False  #: whether the host polls positions
        self._deadline = deadline
        self._turns = Turns(self.axes, MAX_MISSES)
        self._rejections = [0 for _ in self._setups]
        self._pending: dict[int, _Sent] = {}  # pending commands by number, in the order of sending
        self._waiting: set[int] = set()  # axes with a pending command
        self._identifying: dict[int, int] = {}  # axis whose serial number was requested, by number
        self._request: Request | None = None
        self._requested = self._urgent = False
        self._number = 0
        self._free = self._stop_repeated = -math.inf

    # Commands from the driver

    def command(self, axis: int, speed: int) -> None:
        """Set the speed of an axis [speed data]; `due` sends the latest speed when line and axis are free."""
        top = self._setups[axis].top
        self._turns.desired[axis] = min(max(speed, -top), top)

    def stop(self) -> None:
        """Stop all axes before any other command, and poll each axis until it confirms its stop."""
        self._turns.desired = [0 for _ in self._setups]
        self.cancel()
        reachable = self.axes.reachable
        if self._urgent or (reachable and all(i in self.axes.stopping for i in reachable)):
            return
        self._urgent = True
        self.axes.stopping = dict.fromkeys(reachable, math.inf)

    def send_request(self, request: Request) -> None:
        """Send one request; `feed` returns its `Answer`. Only one request can be pending."""
        self._request, self._requested = request, False

    def cancel(self) -> None:
        """Cancel the pending request."""
        self._request = None
        for number in [key for key, sent in self._pending.items() if sent.kind == "request"]:
            self._forget(number)

    # Input: received bytes and the time

    def feed(self, data: bytes, now: float) -> list[Event]:
        """Process bytes that have arrived by `now` [s], detect missing answers, and return events."""
        self.axes.advance(now)
        events: list[Event] = []
        for message in self.wire.read(data) if data else ():
            self._take(message, events, now)
        while self._pending:
            number, sent = next(iter(self._pending.items()))
            if sent.deadline >= now:
                break
            self._forget(number)
            self._miss(sent, events)
        return events

    # Output: bytes to send

    def is_free(self, now: float) -> bool:
        """Return whether the line can transmit a command at `now` [s]."""
        return now >= self._free - LEAD_S - 1e-9

    def due(self, now: float) -> bytes:
        """Return the bytes to send at `now` [s]: at most one command, and none while the line is busy."""
        if not self.is_free(now):
            return b""
        if self._urgent or (self.axes.lost and now - self._stop_repeated > REPEAT_STOP_S):
            return self._stop_all(now)
        polls = self.polling or self.axes.stopping
        velocity, poll = lambda: self._next_velocity(now), lambda: self._next_poll(now)
        return self._next_request(now) or self._turns.message(velocity, poll if polls else None) or b""

    def _stop_all(self, now: float) -> bytes:
        """Return the bytes of a stop of every axis on the line."""
        self._urgent, self._stop_repeated = False, now
        # An answer to an earlier command must not count as the confirmation of this stop.
        for number in [key for key, sent in self._pending.items() if sent.kind != "request"]:
            self._forget(number)
        data = self._line(None, self.wire.stop, now)
        self.axes.stopping = dict.fromkeys(self.axes.stopping, now)
        for i, estimate in enumerate(self.axes.estimates):
            self.axes.sent[i], self._turns.sent_at[i] = 0, math.inf
            estimate.command(0.0, self._free)
        return data

    def _next_request(self, now: float) -> bytes:
        request = self._request
        if request is None or self._requested or request.axis in self._waiting:
            return b""
        self._requested = True
        data = self._line(request.axis, request.text, now, request.whole_device)
        self._expect(request.axis, "request", now)
        if request.text == self.wire.serial_number:
            self._identifying[self._number] = request.axis
        return data

    def _next_velocity(self, now: float) -> bytes:
        # The axis `owed` receives no velocity now: if it waited for an answer at each turn, it would never be queried.
        owed = self._turns.owed
        i = self._turns.velocity(now, self._waiting if owed is None else {*self._waiting, owed})
        if i is None:
            return b""
        desired = self.axes.sent[i] = self._turns.desired[i]
        data = self._line(i, self.wire.stop if desired == 0 else self.wire.velocity(desired), now)
        self._expect(i, "velocity", now)
        self.axes.estimates[i].command(self.wire.speed(desired), self._free)
        return data

    def _next_poll(self, now: float) -> bytes:
        i = self._turns.poll(self._waiting.__contains__)
        if i is None:
            return b""
        data = self._line(i, self.wire.position, now)
        self._expect(i, "position", now)
        self.axes.estimates[i].expect(self._free)
        return data

    def _line(self, axis: int | None, text: str, now: float, whole_device: bool = False) -> bytes:
        self._number = (self._number + 1) % (self.wire.max_number + 1)
        if self._number in self._pending:
            self._forget(self._number)
        self._identifying.pop(self._number, None)
        data = self.wire.encode(axis, text, self._number, whole_device=whole_device)
        self._free = max(self._free, now) + len(data) * self.wire.byte_time
        return data

    def _expect(self, axis: int, kind: Literal["velocity", "position", "request"], now: float) -> None:
        self._pending[self._number] = _Sent(axis, kind, now + self._deadline)
        self._waiting.add(axis)

    def _forget(self, number: int) -> None:
        self._waiting.discard(self._pending.pop(number).axis)

    # Answers

    def _take(self, message: Message, events: list[Event], now: float) -> None:
        axes, number, answer = message
        for i in axes:
            if answer.flag != self.flags[i]:
                self.flags[i] = answer.flag
                events.append(FlagChanged(i, answer.flag))
        sent = None if number is None else self._pending.get(number)
        identified = None if number is None else self._identifying.get(number)
        if answer.accepted and identified is not None and identified in axes:
            self.axes.identified(identified, "serial number", answer.data, events)
        if number is None or sent is None or sent.axis not in axes:
            return
        self._forget(number)
        i = sent.axis
        self._turns.answers(i)
        if i in self.axes.stopping and sent.kind == "position":
            self._check_stop(i, answer.busy, now)
        if sent.kind == "request":
            self._request = None
            events.append(answer)
        elif sent.kind == "velocity":
            self._rejections[i] = 0 if answer.accepted else self._rejections[i] + 1
            if not answer.accepted:
                self._turns.sent_at[i] = -math.inf  # the velocity is sent again
            if self._rejections[i] >= MAX_REJECTIONS:
                events.append(Rejected(i, answer.data))
        elif answer.accepted and answer.data.lstrip("-").isdigit():
            self._turns.read(i, int(answer.data) - self._setups[i].minimum, events)
        else:
            self.axes.counts[i].rejected += 1

    def _check_stop(self, i: int, busy: bool, now: float) -> None:
        """Process the status of a stopping axis: repeat the stop if the axis continues to move."""
        if not busy:
            del self.axes.stopping[i]
        elif now - self.axes.stopping[i] > REPEAT_UNCONFIRMED_STOP_S:
            self._urgent = True

    def _miss(self, sent: _Sent, events: list[Event]) -> None:
        i = sent.axis
        self.axes.counts[i].missed += 1
        if sent.kind == "velocity":
            self._turns.sent_at[i] = -math.inf  # the velocity is sent again
        if sent.kind == "request":
            self._request = None
            events.append(Answer())
            return
        self._turns.miss(i, events, "a device")
