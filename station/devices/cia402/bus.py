"""The host's side of a CAN bus of drives: cyclic velocities, positions, requests, heartbeat. Without I/O.

In every period the host sends one SYNC, then the controlword and the velocity of each drive. At the SYNC every drive
measures its position, and sends it with its statusword. A stop precedes all other frames.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from station.devices.cia402.protocol import (
    BOOT_UP,
    COMMAND,
    EMERGENCY,
    ENABLE,
    ENABLED,
    FAULT_BIT,
    HEARTBEAT,
    HOST_NODE,
    NMT,
    OPEN_ADAPTER,
    OPERATIONAL,
    QUICK_STOP,
    SDO_REPLY,
    SDO_REQUEST,
    SERIAL_NUMBER,
    STATE_MASK,
    STATUS,
    STOPPED,
    SYNC,
    Frame,
    FrameReader,
    download,
    encode,
    sdo_reply,
    signed,
    upload,
)
from station.devices.cia402.setup import DEADLINE_S, DriveSetup
from station.devices.kernel.estimate import AxisEstimate
from station.devices.kernel.line import AxisLost, LineAxes, TwoDevices, UnexpectedMotion

PERIOD_S = 0.004  #: time between two SYNCs; six drives use 40 % of the bus [s]
HEARTBEAT_S = 0.020  #: time between two heartbeats of the host [s]
MAX_UNANSWERED = 3  #: SYNCs without an answer after which the next position is assigned to the next SYNC
MAX_SDO_S = 0.5  #: longest time from a request to its answer; a drive may store a value meanwhile [s]


class Request(NamedTuple):
    """Request to read an object of a drive, or to write a `value` of `size` bytes to the object."""

    axis: int
    entry: tuple[int, int]
    value: int | None = None
    size: int = 4


class Answer(NamedTuple):
    """Result of a `Request`: the value read, or the abort code of a rejection."""

    accepted: bool = False
    value: int = 0
    missing: bool = False


class Restarted(NamedTuple):
    """Event: a drive has restarted."""

    axis: int


class Emergency(NamedTuple):
    """Event: a drive reports an error."""

    axis: int
    code: int


class InFault(NamedTuple):
    """Event: a drive's statusword reports a fault."""

    axis: int


class SwitchedOff(NamedTuple):
    """Event: a drive that receives velocities is switched off, but not by the host."""

    axis: int
    status: int  #: statusword


Event = Answer | AxisLost | Restarted | Emergency | InFault | SwitchedOff | TwoDevices | UnexpectedMotion


class DriveBus:
    """The drives on one bus: sends their frames and processes their replies."""

    def __init__(self, setups: Sequence[DriveSetup], deadline: float = DEADLINE_S) -> None:
        self.setups, self.reader = tuple(setups), FrameReader()
        count = range(len(self.setups))
        self.axes = LineAxes(
            AxisEstimate(s.top * s.velocity_unit, s.acceleration * s.acceleration_unit, s.maximum - s.minimum)
            for s in self.setups
        )
        self.status = [0 for _ in count]  #: last statusword of each axis
        self.driven: set[int] = set()  #: axes that receive velocities; requests control all other axes
        self._on: set[int] = set()  # axes of `driven` that have reported that they are switched on
        self._deadline = deadline
        self._axis = {setup.node: i for i, setup in enumerate(self.setups)}
        self._desired = [0 for _ in count]
        self._quick = [True for _ in count]  # whether the axis is commanded to stop quickly
        self._cyclic: set[int] = set()  # axes that answer to each SYNC
        self._answered = [-math.inf for _ in count]  # time of the last position [s]
        self._unanswered = [0 for _ in count]  # SYNCs since the last position
        self._marked = [False for _ in count]  # whether the estimate expects the position of an unanswered SYNC
        self._last = [math.nan for _ in count]  # last position [counts]
        self._extra: list[bytes] = [OPEN_ADAPTER]
        self._request: Request | None = None
        self._requested: float | None = None  # time at which the pending request was sent [s]
        self._urgent = False
        self._next_cycle = self._next_heartbeat = self._free = -math.inf

    # Commands from the driver

    def command(self, axis: int, speed: int) -> None:
        """Set the velocity of an axis [velocity unit]; the next cycle sends the latest velocity."""
        top = self.setups[axis].top
        self._desired[axis] = min(max(speed, -top), top)
        if self._desired[axis]:
            self._quick[axis] = False

    def stop(self) -> None:
        """Stop all axes before any other frame, by a quick stop that each cycle repeats until the next velocity."""
        self._desired = [0 for _ in self.setups]
        self.cancel()
        reachable = self._cyclic - self.axes.lost
        if all(self._quick[i] for i in reachable) and self.driven >= reachable:
            return
        self._urgent, self._quick = True, [True for _ in self.setups]
        self.driven |= self._cyclic
        self.axes.stopping = dict.fromkeys(reachable, 0.0)

    def open_adapter(self) -> None:
        """Open the adapter again, because it may have been starting at the first attempt."""
        self._extra.append(OPEN_ADAPTER)

    def start_cycle(self, axis: int) -> None:
        """Expect an answer of the axis to each SYNC, from the next one on."""
        self._cyclic.add(axis)
        self._answered[axis] = math.inf

    def release(self, axis: int) -> None:
        """Let requests control an axis, which receives no velocities until it is in `driven` again."""
        self.driven.discard(axis)
        self._on.discard(axis)

    def manage(self, axis: int, command: int) -> None:
        """Send a command of CANopen's network management to a drive."""
        self._extra.append(encode(Frame(NMT, bytes([command, self.setups[axis].node]))))

    def send_request(self, request: Request) -> None:
        """Send one request; `feed` returns its `Answer`. Only one request can be pending."""
        self._request, self._requested = request, None

    def cancel(self) -> None:
        """Cancel the pending request."""
        self._request = None

    # Input: received bytes and the time

    def feed(self, data: bytes, now: float) -> list[Event]:
        """Process bytes that have arrived by `now` [s], detect missing replies, and return events."""
        self.axes.advance(now)
        events: list[Event] = []
        for frame in self.reader.feed(data) if data else ():
            self._take(frame, events, now)
        for i in self._cyclic - self.axes.lost:
            if now - self._answered[i] > self._deadline:
                self.axes.lose(i, f"no position for {1e3 * (now - self._answered[i]):.0f} ms", events)
        if self._requested is not None and self._request is not None and now - self._requested > MAX_SDO_S:
            self.axes.counts[self._request.axis].missed += 1
            self._request = None
            events.append(Answer(missing=True))
        return events

    def _take(self, frame: Frame, events: list[Event], now: float) -> None:
        node, data = frame.identifier & 0x7F, frame.data
        i = self._axis.get(node)
        if i is None:
            return
        match frame.identifier - node:
            case base if base == STATUS and len(data) == 6:
                self._read(i, data, events, now)
            case base if base == SDO_REPLY:
                reply, request = sdo_reply(data), self._request
                pending = request is not None and self._requested is not None and request.axis == i
                if reply and reply.accepted and reply.entry == SERIAL_NUMBER:
                    self.axes.identified(i, "serial number", reply.value, events)
                if reply and pending and request and reply.entry == request.entry:
                    self._request = None
                    events.append(Answer(reply.accepted, reply.value))
            case base if base == SDO_REQUEST:  # an echo of the host's own request
                self.reader.dropped.add(encode(frame))
            case base if base == EMERGENCY and len(data) == 8 and data[:2] != b"\0\0":
                events.append(Emergency(i, int.from_bytes(data[:2], "little")))
            case base if base == HEARTBEAT and data == bytes([BOOT_UP]) and i in self._cyclic:
                events.append(Restarted(i))

    def _read(self, i: int, data: bytes, events: list[Event], now: float) -> None:
        """Process statusword and position of an axis."""
        status, position = int.from_bytes(data[:2], "little"), signed(int.from_bytes(data[2:], "little"))
        before, last = self.status[i], self._last[i]
        self.status[i], self._last[i], self._answered[i], self._unanswered[i] = status, position, now, 0
        # A state counts when two frames in a row report it, because a line of the adapter may be damaged.
        if status & before & FAULT_BIT:
            events.append(InFault(i))
        elif status & STATE_MASK in (ENABLED, STOPPED):
            self._on |= {i} & self.driven
        elif i in self._on and before & STATE_MASK not in (ENABLED, STOPPED):
            self._on.discard(i)
            events.append(SwitchedOff(i, status))
        if i in self.axes.stopping and status & STATE_MASK == STOPPED and position == last:
            del self.axes.stopping[i]
        if self._marked[i]:
            self._marked[i] = False
            self.axes.correct(i, position - self.setups[i].minimum, events)

    # Output: bytes to send

    def is_free(self, now: float) -> bool:
        """Return whether there is something to send at `now` [s]."""
        return self._urgent or now >= self._next_cycle - 1e-9 or self._request is not None or bool(self._extra)

    def due(self, now: float) -> bytes:
        """Return the lines to send at `now` [s]: a stop first, then the cycle, then a request."""
        lines: list[bytes] = []
        self._free = max(self._free, now)
        if self._urgent:
            self._urgent = False
            lines += self._commands()
        lines += self._extra
        self._extra.clear()
        if now >= self._next_cycle - 1e-9:
            self._next_cycle = max(self._next_cycle + PERIOD_S, now)
            lines += self._cycle(now)
        request = self._request
        if request is not None and self._requested is None:
            self._requested = now
            node = self.setups[request.axis].node
            lines.append(
                self._line(
                    upload(node, request.entry)
                    if request.value is None
                    else download(node, request.entry, request.value, request.size)
                )
            )
        return b"".join(lines)

    def _cycle(self, now: float) -> list[bytes]:
        lines: list[bytes] = []
        if self._cyclic:
            lines.append(self._line(Frame(SYNC, b"")))
            for i in self._cyclic:
                self._expect(i, now)
            lines += self._commands()
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + HEARTBEAT_S
            lines.append(self._line(Frame(HEARTBEAT + HOST_NODE, bytes([OPERATIONAL]))))
        return lines

    def _expect(self, i: int, now: float) -> None:
        """Expect the position of an axis at the SYNC that has just been sent."""
        if math.isinf(self._answered[i]):
            self._answered[i] = now
        if not 0 < self._unanswered[i] <= MAX_UNANSWERED:
            self.axes.counts[i].polls += 1
            self.axes.estimates[i].expect(self._free)
            self._marked[i], self._unanswered[i] = True, 0
        self._unanswered[i] += 1

    def _commands(self) -> list[bytes]:
        """Return controlword and velocity of each axis."""
        lines: list[bytes] = []
        for i in sorted(self.driven):
            speed, setup = self._desired[i], self.setups[i]
            word = QUICK_STOP if self._quick[i] else ENABLE
            data = word.to_bytes(2, "little") + speed.to_bytes(4, "little", signed=True)
            lines.append(self._line(Frame(COMMAND + setup.node, data)))
            self.axes.counts[i].velocities += 1
            if speed != self.axes.sent[i]:
                self.axes.sent[i] = speed
                self.axes.estimates[i].command(speed * setup.velocity_unit, self._free)
        return lines

    def _line(self, frame: Frame) -> bytes:
        self._free += frame.duration
        return encode(frame)
