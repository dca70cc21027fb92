"""The host's side of a G-code board: short segments, position queries, stops and requests. Without I/O.

The firmware executes motions, not velocities. So the host integrates the velocities to targets and sends one line for
each segment of 10 ms. The board always has a few segments in its planner and never more, which makes the latency
constant. If the host is silent, the stages stop at the end of the last segment.
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import Literal, NamedTuple

from station.devices.gcode.protocol import (
    BAUDS,
    FULL_FEED,
    JOG_CANCEL,
    QUERY,
    RESET,
    RESUME,
    Alarm,
    Busy,
    Dialect,
    Failure,
    Info,
    LineReader,
    Message,
    Ok,
    Position,
    Resend,
    Started,
    alarm_text,
    numbered,
    parse,
)
from station.devices.gcode.setup import DEADLINE_S, VELOCITY_DATA, AxisSetup
from station.devices.kernel.estimate import AxisEstimate
from station.devices.kernel.line import AxisLost, LineAxes, LineFault, UnexpectedMotion

SEGMENT_S = 0.010  #: duration of one segment [s]
#: The next segment is sent when the queue lasts for this time [s]. Marlin does not replan the segment that runs.
QUEUE_S: dict[Dialect, float] = {"grbl": 0.030, "marlin": 0.040}
POLL_S = 0.020  #: time between two position queries [s]
PROCESSING_S = 0.001  #: time from the end of a line to its execution; assumed [s]
SPEED_MEMORY = 0.7  #: fraction of a reading's speed that widens the next one's tolerance, because of the long queue
PACE_GAIN = 0.5  #: fraction of the queue's error that one reading corrects
PACE_WEIGHT = 1e-4  #: weight of a queue error of one segment, relative to a position error of one segment at top speed
PATH_SEGMENTS = 32  #: number of segments that are compared with a reading; the planner has up to 16 blocks
SLOWEST_S = 0.03  #: longest duration of one motion; Marlin drops short ones, so slow axes move in steps [s]
MIN_STEPS = 6  #: Marlin drops shorter motions [microsteps]
#: If positions arrive, but a stop has no effect for this time [s], GRBL is reset, and Marlin is halted by M112.
UNCONFIRMED_STOP_S = 0.5
MAX_REJECTIONS = 3  #: rejected segments in a row that are a fault
RESEND_S = 0.020  #: time in which repeated requests for a line are ignored; lines in transit cause them [s]
BLIND = 0.5  #: after this fraction of the deadline without a valid position, the axes stop until one arrives
MAX_SKEW_S = 0.002  #: longest time between the two positions of one Marlin reply [s]
MAX_PROJECTED = 5  #: reported positions in a row that equal the end of the queue; this number is a fault
#: States of GRBL in which it executes no motion, and what ends them.
UNUSABLE = {
    "Door": "close its safety door",
    "Check": "end its check mode by `$C`",
    "Sleep": "switch it off and on",
    "Tool": "end the change of its tool",
    "Pendant": "give the control back at its pendant",
}
#: Ends an unfinished line of GRBL and makes it invalid, so that the board does not execute a part of a command.
END_LINE = b"#\n"
OWN_RESET_S = 3.0  #: time after a reset by the host in which its banner and alarm are expected [s]


class Request(NamedTuple):
    """One command; `feed` returns its answer."""

    text: str
    timeout: float = 1.0  #: longest time until its answer [s]
    homing: bool = False


class Answer(NamedTuple):
    """Result of a `Request`: the lines before `ok`, or the meaning of the error; `missing`: no reply in time."""

    accepted: bool = False
    lines: tuple[str, ...] = ()
    error: str = ""
    missing: bool = False


Event = Answer | AxisLost | LineFault | UnexpectedMotion


class GcodeBoard:
    """The axes of one board: sends lines and processes replies."""

    def __init__(self, setups: Sequence[AxisSetup], dialect: Dialect, baud: int = 0, deadline: float = DEADLINE_S):
        self.setups = tuple(setups)
        self.dialect: Dialect = dialect
        self.reader = LineReader()
        count = range(len(self.setups))
        # The planner slows the axes at corners, so the board may execute a segment later than estimated, by up to the
        # queue.
        self.axes = LineAxes(
            AxisEstimate(s.top, s.acceleration, s.maximum - s.minimum, QUEUE_S[dialect], SPEED_MEMORY)
            for s in self.setups
        )
        self.polling = False  #: whether the host queries positions
        self.checking = False  #: whether `offset` is known, so that Marlin's two positions must agree
        self.origin = [0.0 for _ in count]  #: the board's count at the coordinate 0 of each axis
        self.offset = [0.0 for _ in count]  #: Marlin: logical coordinate minus the stepper's coordinate [unit]
        self.state, self.code = "", 0  #: GRBL's last state, and the number behind it
        self.order = ""  #: GRBL: order of the axes in positions and settings; empty: unknown
        self.fluidnc = False  #: whether the firmware is FluidNC, which has its own alarms
        self.starting = False  #: whether a restart of the board is not a fault, because the host sets it up afterwards
        self.restarted = False  #: whether the board has restarted
        self._pendant = False  # whether a pendant has the control of grblHAL
        self.received_at = -math.inf  #: time of the last received line, position reports excepted [s]
        self.reading: Position | None = None  #: last reading
        self._letters = [s.letter for s in self.setups]
        self._byte_time, self._deadline = 10.0 / (baud or BAUDS[dialect]), deadline
        self._desired = [0.0 for _ in count]  # commanded velocities [counts/s]
        self._target: list[float] | None = None  # end of the last segment, from each axis's minimum [counts]
        self._last: list[float] = []  # target of the last segment that was sent [counts]
        self._path: deque[list[float]] = deque(maxlen=PATH_SEGMENTS)  # ends of the last segments [counts]
        self._accumulated = 0.0  # time since the end of the last segment that was sent [s]
        self._planned = -math.inf  # time at which the board has executed every segment [s]
        self._speeds = [0.0 for _ in count]  # last speeds for the estimates [counts/s]
        self._future: deque[tuple[float, int, float]] = deque()  # speeds that start later: time [s], axis, speed
        self._free = self._next_poll = self._stopped_at = -math.inf
        self._answering_since = math.inf  # time of the first position after a stop was sent [s]
        self._reset_until = self._next_stop = -math.inf
        self._unverified: float | None = None  # time of the first query after the last accepted reading [s]
        self._doubt = ""  # why the last reading was not accepted
        self._waiting: deque[tuple[float, Literal["segment", "query", "request"]]] = deque()  # lines without `ok`
        self._request: Request | None = None
        self._requested: float | None = None
        self._lines: list[str] = []
        self._refusal = ""  # error of Marlin before the `ok` of the request
        self._urgent = self._home_ended = self._killed = self._must_reset = False
        self._number = 0
        self._resent = (-1, -math.inf)  # number that Marlin requested last, and when [s]
        self._blind = False  # whether the axes stop because their positions are missing
        self._skip_ok = False  # whether the next `ok` belongs to Marlin's request for a line, not to a line
        self._rejections = self._projected = 0

    # Commands from the driver

    def command(self, axis: int, speed: int) -> None:
        """Set the velocity of an axis [velocity data]."""
        top = self.setups[axis].top
        self._desired[axis] = min(max(speed / VELOCITY_DATA, -top), top)

    def stop(self) -> None:
        """Send a stop, which empties the planner, before any other command; repeat it until the board is at rest."""
        self._desired = [0.0 for _ in self.setups]
        self.cancel()
        self._blind, self.axes.sent = False, [0 for _ in self.setups]
        if self.axes.stopping and not self._home_ended:
            return
        self._begin_stop()
        self._killed, self._stopped_at, self._answering_since = False, math.inf, math.inf

    def send_request(self, request: Request) -> None:
        """Send one request; `feed` returns its `Answer`."""
        self._request, self._requested, self._lines = request, None, []

    def cancel(self) -> None:
        """Cancel the pending request; if it is a homing, the next stop ends the motion."""
        if self._request is not None and self._requested is not None and self._request.homing:
            self._home_ended = True
        self._request = None
        self._waiting.clear()
        self._unverified, self._skip_ok = None, False

    def reset_board(self) -> None:
        """Reset GRBL, because some alarms end only by a reset."""
        self._must_reset = self._urgent = True

    def _begin_stop(self) -> None:
        self.axes.stopping, self._urgent = dict.fromkeys(range(len(self.setups)), 0.0), True

    # Input: received bytes and the time

    def feed(self, data: bytes, now: float) -> list[Event]:
        """Process bytes that have arrived by `now` [s], detect missing replies, and return events."""
        while self._future and self._future[0][0] <= now:
            when, i, speed = self._future.popleft()
            self.axes.estimates[i].command(speed, when)
        self.axes.advance(now)
        events: list[Event] = []
        if data:
            for line in self.reader.feed(data):
                message = parse(self.dialect, line, self._letters, self.order)
                if not isinstance(message, Position):  # some boards send positions without a query
                    self.received_at = now
                self._take(message, events, now)
        if self._request is not None and self._requested is not None:
            if now - self._requested > self._request.timeout:
                self.cancel()
                events.append(Answer(missing=True))
        elif self._unverified is None or self.starting or self.axes.lost:
            pass
        elif now - self._unverified > self._deadline:
            self.axes.give_up()
            why = f"no {'valid position' if self._doubt else 'answer'} of the board"
            why += f" for {1e3 * (now - self._unverified):.0f} ms{self._doubt}"
            events += [AxisLost(i, why) for i in sorted(self.axes.lost)]
        elif now - self._unverified > BLIND * self._deadline and any(self.axes.sent) and not self.axes.stopping:
            self._begin_stop()  # a damaged line may move an axis anywhere
            self._blind = True
        if self._waiting and self._request is None and now - self._waiting[0][0] > 0.5 * self._deadline:
            self._waiting.clear()  # a reply was damaged
            self.axes.counts[0].missed += 1
        return events

    def _take(self, message: Message, events: list[Event], now: float) -> None:
        match message:
            case Ok() | Failure():
                self._acknowledge(message, events)
            case Position():
                self._pendant = self._pendant if message.pendant is None else message.pendant
                message = message._replace(state="Pendant") if self._pendant else message
                self.state, self.code = message.state, message.code
                self._read(message, events, now)
            case Busy():
                if self._request is not None and self._requested is not None and not self._request.homing:
                    self._requested = now
            case Resend(number):
                self._send_again(number, now)
            case Started():
                self._number, self.restarted, self._pendant = 0, True, False
                self._answering_since = math.inf
                for estimate in self.axes.estimates:
                    estimate.forget()
                if now > self._reset_until and not self.starting:
                    self._break(events, "has reset itself and lost its position", True)
            case Alarm(text, number):
                text = alarm_text(number, self.fluidnc) if number else text
                if now > self._reset_until and not self.starting:
                    self._break(events, f"reports: {text}", True)
            case Info(text):
                self._lines.append(text)
                if "MPos" in text or "Count" in text:
                    self._doubt = "; its replies are damaged"

    def _break(self, events: list[Event], text: str, must_home: bool) -> None:
        self._waiting.clear()
        self._target = None
        events.append(LineFault(f"the board {text}", must_home))

    def _acknowledge(self, message: Ok | Failure, events: list[Event]) -> None:
        """Assign `ok` or an error to the oldest line without a reply."""
        if self.dialect == "marlin" and isinstance(message, Failure):
            self._refusal = self._refusal or message.text  # `ok` follows
            return
        if self._skip_ok:
            self._skip_ok = False
            return
        kind = self._waiting.popleft()[1] if self._waiting else ""
        error = message.text if isinstance(message, Failure) else ""
        if kind == "request" and self._request is not None:
            error = error or self._refusal or next((line for line in self._lines if "Unknown command" in line), "")
            answer = Answer(not error, tuple(self._lines), error)
            self._request = None
            events.append(answer)
        elif kind == "segment":
            self._rejections = self._rejections + 1 if error else 0
            if self._rejections >= MAX_REJECTIONS:
                self._break(events, f"rejects its motions: {error}", False)

    def _send_again(self, number: int, now: float) -> None:
        """Continue with the line number that Marlin requested; Marlin has dropped all later lines."""
        last, when = self._resent
        self._skip_ok = True
        if number == last and now - when < RESEND_S:
            return
        self._resent, self._number = (number, now), number - 1
        self._waiting.clear()  # targets are absolute, so the next segment replaces the dropped ones
        self._next_poll = now
        if self._request is not None:
            self._requested = None

    def _read(self, position: Position, events: list[Event], now: float) -> None:
        """Process a position; drop it if its values are inconsistent or disagree with the estimates."""
        raw = self.raw(position)
        if not self._agrees(position):
            self._doubt = "; its coordinates disagree with its counts of steps"
            self.axes.counts[0].rejected += 1
            return
        if position.work and not self.starting:
            self._doubt = "; it reports WPos, because its setting $10 was changed"
            return
        if (
            position.state in UNUSABLE
            and not self.starting
            and self.reading is not None
            and self.reading.state == position.state
        ):
            self._break(events, f"reports the state '{position.state}': {UNUSABLE[position.state]}", False)
        before, self.reading = self.reading, position
        self._answering_since = min(self._answering_since, now)
        moved = before is not None and before.values != position.values
        if moved:  # a board at rest has no queue
            self._check_projection(raw, events, now)
            self._follow_pace(raw, now)
        accepted = True
        for i, (estimate, setup) in enumerate(zip(self.axes.estimates, self.setups, strict=True)):
            if self.axes.correct(i, round(raw[i] - self.origin[i]) - setup.minimum, events):
                continue
            accepted = False
            self._doubt = f"; {setup.joint.name} does not move as commanded"
            if not estimate.rejected:  # the estimate has forgotten its position
                self._waiting.clear()
                self._target = None
            elif estimate.rejected == 1 and not self.axes.stopping:
                self._begin_stop()  # a damaged line may have moved an axis
        if accepted:
            self._unverified, self._doubt = None, ""
        if self.axes.stopping and not self._urgent and before is not None and not moved:
            doubtful = any(estimate.doubtful for estimate in self.axes.estimates)
            at_rest = position.state not in ("Jog", "Run", "Home") and not doubtful
            queued = any(kind == "segment" for _, kind in self._waiting)
            if at_rest and not queued and now - self._stopped_at > POLL_S:
                self.axes.stopping.clear()
                self._blind, self._target = False, None
                self.axes.sent = [0 for _ in self.setups]

    def _agrees(self, position: Position) -> bool:
        """Return whether Marlin's coordinates agree with its counts of steps."""
        if not self.checking or not position.logical:
            return True
        return all(
            abs(logical - offset - steps * setup.unit) <= 0.006 + (2.0 + MAX_SKEW_S * setup.top) * setup.unit
            for logical, offset, steps, setup in zip(
                position.logical, self.offset, position.values, self.setups, strict=True
            )
        )

    def _check_projection(self, raw: Sequence[float], events: list[Event], now: float) -> None:
        """Detect a firmware that ignores the R of `M114 R` and so reports the end of its queue as its position."""
        if self.dialect == "grbl" or self._planned - now < 2.0 * SEGMENT_S or not self._last:
            return
        ends = [last + s.minimum + origin for last, s, origin in zip(self._last, self.setups, self.origin, strict=True)]
        ahead = max(abs(last - e.position) for last, e in zip(self._last, self.axes.estimates, strict=True))
        at_end = ahead > 8.0 * MIN_STEPS and all(abs(a - b) < 2.0 for a, b in zip(raw, ends, strict=True))
        self._projected = self._projected + 1 if at_end else 0
        if self._projected == MAX_PROJECTED:
            self._break(
                events, "reports the end of its queue as its position: build the firmware with M114_REALTIME", False
            )

    def _follow_pace(self, raw: Sequence[float], now: float) -> None:
        """Correct the time at which the queue is empty by the segment in which the board was at the reading `raw`.

        The board executes segments more slowly than planned at corners and while it accelerates. Without a correction
        its queue would fill, and the latency would grow to the length of the queue.
        """
        expected, best, behind = (self._planned - now) / SEGMENT_S, math.inf, 0
        for later, target in enumerate(reversed(self._path)):
            # The board receives only changes of some microsteps, so smaller errors mean nothing.
            errors = (
                max(0.0, abs(value - origin - setup.minimum - goal) - MIN_STEPS - 1.0) / (setup.top * SEGMENT_S)
                for value, origin, setup, goal in zip(raw, self.origin, self.setups, target, strict=True)
            )
            # Positions of slow motions are ambiguous; then the expected segment counts.
            cost = sum(error * error for error in errors) + PACE_WEIGHT * (later - expected) ** 2
            if cost < best:
                best, behind = cost, later
        if self._path and expected > 0.0:
            for _ in range(len(self._path) - behind - 1):
                self._path.popleft()  # segments that the board has executed
            self._planned += PACE_GAIN * SEGMENT_S * (behind - expected)

    def raw(self, position: Position) -> list[float]:
        """Return the board's counts at a reading."""
        if self.dialect == "marlin":
            return list(position.values)
        return [value / setup.unit for value, setup in zip(position.values, self.setups, strict=True)]

    # Output: bytes to send

    def is_free(self, now: float) -> bool:
        """Return whether the line can transmit at `now` [s]."""
        return self._urgent or now >= self._free - SEGMENT_S

    def due(self, now: float) -> bytes:
        """Return the bytes to send at `now` [s]: a stop first, then a request, a query, and segments."""
        if self.axes.lost and not self._urgent:
            return b""
        self._free = max(self._free, now)
        if self._must_reset:
            self._must_reset = self._urgent = False
            self._reset_until = now + OWN_RESET_S
            return RESET
        if self.axes.stopping and (self._urgent or now >= self._next_stop):
            data = self._stop_bytes(now)
        elif self._request is not None:
            return self._request_bytes(now)
        else:
            data = b""
        if (self.polling or self.axes.stopping) and now >= self._next_poll:
            self._next_poll = now + POLL_S
            data += self._query(now)
        if not self.axes.stopping:
            data += self._segments(now)
        return data

    def _stop_bytes(self, now: float) -> bytes:
        first, self._urgent, self._next_stop = self._urgent, False, now + POLL_S
        if first:
            self._stopped_at = now
            if not self._blind:  # otherwise a lost axis would seem to be at rest
                self.axes.sent = [0 for _ in self.setups]
            self._future.clear()
            self._speeds = [math.nan for _ in self.setups]
            for i in range(len(self.setups)):
                self._estimate(i, 0.0, now + PROCESSING_S)
            self._planned, self._accumulated = -math.inf, 0.0
        data = JOG_CANCEL if self.dialect == "grbl" else b"\nM410\n"
        if first and self.dialect == "grbl":
            data += FULL_FEED + END_LINE
        if first or self.dialect == "marlin":
            self._waiting.append((now, "query"))
        answers = self._unverified is None or now - self._unverified < self._deadline
        # A starting board is silent. Only a board that has answered for a while can disobey. M112 halts a board until
        # a manual reset.
        disobeys = answers and now - max(self._stopped_at, self._answering_since) > UNCONFIRMED_STOP_S
        if self._home_ended or (disobeys and not self._killed):
            self._killed, self._home_ended = True, False
            if self.dialect == "grbl":
                data += RESET
                self._reset_until = now + OWN_RESET_S
            elif disobeys:
                data += b"M112\n"
        self._free += len(data) * self._byte_time
        return data

    def _query(self, now: float) -> bytes:
        if self._unverified is None:
            self._unverified = now
        if self.dialect == "grbl":
            data = RESUME + QUERY if self.state == "Hold" else QUERY
            self._free += len(data) * self._byte_time
        else:
            data = self._line("M114 R", "query", now)
        for i, estimate in enumerate(self.axes.estimates):
            self.axes.counts[i].polls += 1
            estimate.expect(self._free + (PROCESSING_S if self.dialect == "marlin" else 0.0))
        return data

    def _request_bytes(self, now: float) -> bytes:
        request = self._request
        if request is None or self._requested is not None or self._waiting:
            return b""
        self._requested, self._unverified, self._refusal = now, None, ""
        self._lines.clear()
        self.reader.last = b""
        if request.text.startswith("M110"):
            self._number = -1
        return self._line(request.text, "request", now)

    def _line(self, text: str, kind: Literal["segment", "query", "request"], now: float) -> bytes:
        if self.dialect == "marlin":
            self._number += 1
            data = numbered(self._number, text)
        else:
            data = f"{text}\n".encode("ascii")
        self._waiting.append((now, kind))
        self._free += len(data) * self._byte_time
        return data

    def _segments(self, now: float) -> bytes:
        """Return the segments that fill the queue to `QUEUE_S` again."""
        if not any(self._desired) and not any(self._speeds):
            return b""
        if not all(estimate.known for estimate in self.axes.estimates):
            return b""
        data = b""
        if not any(self._desired):
            for i in range(len(self.setups)):
                self._estimate(i, 0.0, max(self._planned, now))
                self.axes.sent[i] = 0
            return b""
        if self._target is None:
            self._target, self._accumulated = [estimate.position for estimate in self.axes.estimates], 0.0
            self._last = list(self._target)
            self._path.clear()
        while self._planned - now <= QUEUE_S[self.dialect]:
            start = self._planned if self._planned > now else self._free + PROCESSING_S + 40 * self._byte_time
            self._planned = start + SEGMENT_S
            before = list(self._target)
            self._accumulated += SEGMENT_S
            for i, (setup, desired) in enumerate(zip(self.setups, self._desired, strict=True)):
                self._target[i] = min(max(self._target[i] + desired * SEGMENT_S, 0.0), setup.maximum - setup.minimum)
                self._estimate(i, desired, start)
                self.axes.sent[i] = round(desired * VELOCITY_DATA)
                self.axes.counts[i].velocities += 1
            self._path.append(list(self._target))
            if self._target == before:  # every moving axis is at the end of its travel
                self._accumulated = 0.0
            elif max(abs(a - b) for a, b in zip(self._target, self._last, strict=True)) >= MIN_STEPS:
                data += self._line(self._motion(self._target), "segment", now)
                self._last, self._accumulated = list(self._target), 0.0
        return data

    def _motion(self, target: Sequence[float]) -> str:
        """Return the command that reaches the target in the accumulated time."""
        words, linear, rotary = "", 0.0, 0.0
        for i, setup in enumerate(self.setups):
            change = (target[i] - self._last[i]) * setup.unit
            at = (target[i] + setup.minimum + self.origin[i]) * setup.unit + self.offset[i]
            words += f"{setup.letter}{at:.4f}"
            if self.dialect == "marlin" and setup.letter in "ABC":
                rotary += change * change
            else:
                linear += change * change
        # Time beyond `SLOWEST_S` does not count; otherwise a slow start would delay all later motions.
        feed = 60.0 * math.sqrt(linear or rotary) / min(self._accumulated, SLOWEST_S)  # [unit/min]
        return f"$J=G53{words}F{feed:.3f}" if self.dialect == "grbl" else f"G1{words}F{feed:.3f}"

    def _estimate(self, i: int, speed: float, when: float) -> None:
        if speed != self._speeds[i]:
            self._speeds[i] = speed
            self._future.append((when, i, speed))
