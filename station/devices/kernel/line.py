"""Common parts of all lines with stages: events, counters, turns of the axes, and the interface `Line`. Without I/O."""

import math
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeVar

from station.devices.kernel.estimate import MAX_UNEXPECTED_READINGS, AxisEstimate
from station.devices.kernel.quality import quoted

RequestIn = TypeVar("RequestIn", contravariant=True)
Message = TypeVar("Message")

LEAD_S = 0.002  #: a message is passed to the port this long before the line is free [s]
REFRESH_S = 0.25  #: an unchanged velocity is repeated after this time, in case it was not received [s]
REPEAT_STOP_S = 0.25  #: interval of stop commands to lost axes, in case they receive again [s]
KEPT_BYTES = 40  #: number of the newest unreadable bytes that are kept


class Unread:
    """Received bytes that belong to no message: their number, and the newest of them."""

    def __init__(self) -> None:
        self.count = 0
        self.last = b""

    def add(self, data: bytes) -> None:
        """Add bytes that were dropped."""
        self.count += len(data)
        self.last = (self.last + data)[-KEPT_BYTES:]


def no_answer(who: str, unread: bytes, expected: str, check: str, silent: str = "does not answer") -> str:
    """Return why a device that has not answered cannot be used: it is silent, or its bytes cannot be read.

    Args:
        who: the device.
        unread: bytes that came instead of its answer; empty: none.
        expected: what its answer looks like.
        check: question to the operator.
        silent: predicate of the sentence if no byte came.
    """
    return f"{who} {f'sends {quoted(unread, KEPT_BYTES)}, expected {expected}' if unread else silent}; {check}"


@dataclass
class LineCounts:
    """Message counters of an axis."""

    velocities: int = 0  #: velocities sent
    polls: int = 0  #: position and status queries sent
    readings: int = 0  #: position readings accepted
    rejected: int = 0  #: implausible position and status readings
    missed: int = 0  #: replies that did not arrive in time


class AxisLost(NamedTuple):
    """Event: an axis no longer answers."""

    axis: int
    why: str


class UnexpectedMotion(NamedTuple):
    """Event: an axis does not move as commanded."""

    axis: int
    why: str


class LineFault(NamedTuple):
    """Event: the device that drives all axes cannot continue; `must_home`: it has lost their positions."""

    text: str
    must_home: bool


class TwoDevices(NamedTuple):
    """Event: two devices answer with the number of an axis."""

    axis: int
    what: str
    values: tuple[object, object]


class LineAxes:
    """The host's state of the axes on one line: what it has sent to them, and what they have reported."""

    def __init__(self, estimates: Iterable[AxisEstimate]) -> None:
        self.estimates = list(estimates)  #: positions, counted from each axis's minimum [counts]
        self.counts = [LineCounts() for _ in self.estimates]
        self.sent = [0 for _ in self.estimates]  #: last velocity sent to each axis [data of a velocity command]
        self.answered = list(self.sent)  #: value of `sent` when each axis reported its last position
        self.lost: set[int] = set()  #: axes that no longer answer
        self.stopping: dict[int, float] = {}  #: axes that have not confirmed their stop; a protocol chooses the values
        self._constants: dict[tuple[int, str], dict[object, int]] = {}  # times each value of a constant was reported

    @property
    def reachable(self) -> list[int]:
        """Axes that answer."""
        return [i for i in range(len(self.estimates)) if i not in self.lost]

    def advance(self, now: float) -> None:
        """Advance the estimates to `now` [s]."""
        for estimate in self.estimates:
            estimate.advance(now)

    def correct(self, i: int, reading: int, events: list[Any]) -> bool:
        """Process the position that an axis reports [counts]; return whether it is plausible.

        Too many implausible positions in a row are an event, and the estimate forgets its position.
        """
        estimate, counts = self.estimates[i], self.counts[i]
        if estimate.correct(reading):
            counts.readings += 1
            self.answered[i] = self.sent[i]
            return True
        counts.rejected += 1
        if estimate.rejected >= MAX_UNEXPECTED_READINGS:
            events.append(UnexpectedMotion(i, estimate.disobedience))
            estimate.forget()
        return False

    def identified(self, i: int, what: str, value: object, events: list[Any], times: int = 1) -> None:
        """Process a reported value that never changes, such as a serial number.

        If two different values were reported at least `times` each, two devices answer: add the event `TwoDevices`.
        """
        values = self._constants.setdefault((i, what), {})
        values[value] = values.get(value, 0) + 1
        often = [one for one, count in values.items() if count >= times]
        if len(often) > 1:
            events.append(TwoDevices(i, what, (often[0], often[1])))

    def lose(self, i: int, why: str, events: list[Any]) -> None:
        """Mark an axis as lost, and add the event `AxisLost`."""
        self.lost.add(i)
        self.stopping.pop(i, None)
        events.append(AxisLost(i, why))

    def give_up(self) -> None:
        """Mark every axis as lost, because the port is lost."""
        self.stopping.clear()
        self.lost |= set(range(len(self.estimates)))


class Turns:
    """Turns of the axes on a slow line: one position query after as many velocities as the line has axes."""

    def __init__(self, axes: LineAxes, misses: int) -> None:
        """`misses` is the number of missing replies in a row after which an axis counts as lost."""
        count = len(axes.estimates)
        self.desired = [0 for _ in range(count)]  #: velocity of each axis [data of a velocity command]
        self.sent_at = [math.inf for _ in range(count)]  #: time of the last velocity [s]; infinite: do not repeat it
        self._axes, self._most = axes, misses
        self._misses = [-math.inf for _ in range(count)]  # infinite before the first reply: the device may be starting
        self._velocity = self._poll = self._since_poll = 0
        self.owed: int | None = None  #: axis that could not be queried at its turn, and is queried before others

    def message(
        self, velocity: Callable[[], Message | None], poll: Callable[[], Message | None] | None
    ) -> Message | None:
        """Return the next message that is due: a velocity or a position query; without `poll` never a query."""
        if self._since_poll < len(self.desired) and (message := velocity()):
            self._since_poll += 1
            return message
        self._since_poll = 0
        return (poll() if poll else None) or velocity()

    def velocity(self, now: float, waiting: Container[int] = ()) -> int | None:
        """Return the next axis that must receive its velocity now, or None; `waiting`: axes that cannot receive one."""
        axes, count = self._axes, len(self.desired)
        for k in range(count):
            i = (self._velocity + k) % count
            if i in waiting or (self.desired[i] == axes.sent[i] and now - self.sent_at[i] <= REFRESH_S):
                continue
            self._velocity, self.sent_at[i] = i + 1, now
            axes.stopping.pop(i, None)
            axes.counts[i].velocities += 1
            return i
        return None

    def poll(self, waits: Callable[[int], bool]) -> int | None:
        """Return the next axis whose position is queried now; `waits` returns whether an axis cannot answer now."""
        axes, count = self._axes, len(self.desired)
        first = self._poll if self.owed is None else self.owed
        for k in range(count):
            i = (first + k) % count
            if i in axes.lost:
                continue
            if waits(i):
                self.owed = i if self.owed is None else self.owed
                continue
            if self.owed in (None, i):
                self._poll = i if axes.estimates[i].doubtful else i + 1
            self.owed = None if self.owed == i or self.owed in axes.lost else self.owed
            axes.counts[i].polls += 1
            return i
        return None

    def poll_next(self, i: int) -> None:
        """Send the next position query to this axis."""
        self._poll = i

    def read(self, i: int, reading: int, events: list[Any]) -> None:
        """Process a position; if it is implausible, send velocity and query again, as a message may be damaged."""
        if not self._axes.correct(i, reading, events):
            self._poll = i
            if self.sent_at[i] < math.inf:
                self.sent_at[i] = -math.inf

    def answers(self, i: int) -> None:
        """Record that an axis has replied."""
        self._misses[i] = 0

    def miss(self, i: int, events: list[Any], what: str) -> None:
        """Record that a reply of an axis is missing; after too many in a row it is lost. `what` names the device."""
        self._misses[i] += 1
        if self._misses[i] >= self._most and i not in self._axes.lost:
            self._axes.lose(i, f"{self._most} replies of {what} are missing", events)


class Line(Protocol[RequestIn]):
    """The axes on one line: sends their messages and processes their replies, without I/O."""

    @property
    def axes(self) -> LineAxes:
        """State of the axes: what was sent to them, and what they have reported."""
        ...

    def command(self, axis: int, speed: int) -> None:
        """Set the velocity of an axis [data of a velocity command]; only the latest velocity is sent."""
        ...

    def stop(self) -> None:
        """Stop all axes before any other command, until each axis has confirmed its stop."""
        ...

    def send_request(self, request: RequestIn) -> None:
        """Send one request; `feed` returns its answer."""
        ...

    def cancel(self) -> None:
        """Cancel the pending request."""
        ...

    def feed(self, data: bytes, now: float) -> Sequence[Any]:
        """Process bytes that have arrived by `now` [s]; return answers and events, such as `AxisLost`."""
        ...

    def is_free(self, now: float) -> bool:
        """Return whether the line can transmit a command at `now` [s]."""
        ...

    def due(self, now: float) -> bytes:
        """Return the bytes to send at `now` [s]."""
        ...
