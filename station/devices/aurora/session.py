"""The host's side of an Aurora: runs the communication script, requests frames, and determines their times and quality.

The session does no I/O: it receives bytes and the time, and returns measurements and commands for the port. The
communication is a script (`dialogue.py`). Any failure ends the script and sets the dialogue's `trouble` to the reason;
then the script starts again.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from station.devices.aurora.dialogue import (
    REPLY_TIMEOUT_S,
    RETRY_ERRORS,
    RETRY_WAIT_S,
    TOOL_TIMEOUT_S,
    AuroraRequest,
    AuroraSettings,
    Dialogue,
    Pause,
    RateChange,
    Reply,
    Script,
    SerialBreak,
    find_unit,
    identify,
    is_okay,
    prepare_tools,
)
from station.devices.aurora.protocol import (
    HARDWARE_FAILURE,
    NOT_IN_THIS_MODE,
    OUT_OF_VOLUME,
    PARTLY_OUT_OF_VOLUME,
    PORT_OCCUPIED,
    AuroraError,
    FrameReply,
    ReplyReader,
    ToolFrame,
    ToolState,
    error_code,
    error_words,
    framed,
    parse_bx,
    parse_tx,
    system_words,
)
from station.devices.jump_gate import JumpGate


class FrameQuality(IntEnum):
    """Quality of the newest frame; telemetry contains the number."""

    GOOD = 0
    MISSING = 1  #: the unit does not detect the tool
    OUT_OF_VOLUME = 2  #: the tool is fully or partly outside the measurement volume
    DISABLED = 3  #: the tool is disabled or unplugged
    JUMP = 4  #: the position is further from the last one than a coil can move in the time between
    FAULT = 5  #: the unit reports a fault of the sensor or of itself
    SILENT = 6  #: no frame for `SILENCE_TIMEOUT_S`
    CONNECTING = 7
    LOST = 8  #: the port is lost


class TrackerFrame(NamedTuple):
    """One new frame of the tip's coil."""

    frame: int
    time: float  #: time of the measurement, from the frame number [s]
    quality: FrameQuality
    position: tuple[float, ...] | None  #: robot's tip in the field generator's frame, only when GOOD [mm]
    error: float = 0.0  #: error indicator of the unit [mm]
    target: tuple[float, ...] | None = None  #: target's coil in the generator's frame, only when good [mm]
    axis: tuple[float, ...] | None = (
        None  #: axis of the tip's coil, unit vector in the generator's frame, only when GOOD
    )


@dataclass
class FrameCounts:
    """Counters since the session was created."""

    frames: int = 0  #: new frames received
    repeated: int = 0  #: replies that repeat the last frame
    skipped: int = 0  #: frames that were not requested in time
    implausible: int = 0  #: frame numbers that do not fit the clock
    jumps: int = 0  #: frames whose position a coil cannot have reached
    malformed: int = 0  #: replies with a correct CRC and wrong content
    stray: int = 0  #: texts that answer no request
    timeouts: int = 0  #: requests without a reply in time
    connects: int = 0  #: how many times tracking has started


#: Largest drift between the clocks of tracker and computer [s/s], tolerance of a frame's time [frames], and number of
#: consistent frames after which a count that does not fit the clock is accepted: the unit has restarted it.
MAX_CLOCK_DRIFT, TOLERANCE_FRAMES, FRAMES_TO_RESTART = 5e-4, 1.5, 5
MAX_MISSES = 5  #: number of failed frame requests in a row after which the session restarts


class FrameClock:
    """Converts frame numbers to host time, by the lower envelope of the arrival times.

    A reply can be late but never early. Therefore the smallest difference between the arrival of a reply and the time
    since frame 0 is the best estimate. This estimate may rise slowly, because the two clocks drift apart.
    """

    def __init__(self, rate: float) -> None:
        """`rate` is the number of frames per second."""
        self._rate, self._tolerance = rate, TOLERANCE_FRAMES / rate
        self.restart()

    def restart(self) -> None:
        """Discard the estimate, because the unit may restart its frame count."""
        self._frame, self._arrival, self._offset, self._time = -1, 0.0, math.nan, -math.inf
        self._doubts, self._doubted = 0, (0, 0.0)

    def soonest(self, frame: int, arrival: float) -> float | None:
        """Return the earliest possible arrival of the reply with `frame` [s]; None if the number is implausible."""
        offset = arrival - frame / self._rate
        if math.isnan(self._offset):
            return self._anchor(frame, arrival)
        envelope = self._offset + MAX_CLOCK_DRIFT * (arrival - self._arrival)
        if frame <= self._frame or not -self._tolerance <= offset - envelope <= 1.0:
            return self._doubt(frame, arrival)
        self._doubts = 0
        self._frame, self._arrival, self._offset = frame, arrival, min(offset, envelope)
        self._time = max(self._offset + frame / self._rate, self._time + 1e-6)
        return self._time

    def _anchor(self, frame: int, arrival: float) -> float:
        self._frame, self._arrival, self._offset = frame, arrival, arrival - frame / self._rate
        self._time = max(arrival, self._time + 1e-6)
        self._doubts = 0
        return self._time

    def _doubt(self, frame: int, arrival: float) -> float | None:
        """Count frames that are consistent with one another but not with the clock: the unit restarted its count."""
        frames, time = frame - self._doubted[0], arrival - self._doubted[1]
        if self._doubts and frames == 0:
            return None  # a repetition: the frame was requested again before the next frame was measured
        agrees = frames > 0 and abs(time - frames / self._rate) <= self._tolerance
        self._doubts = self._doubts + 1 if self._doubts and agrees else 1
        self._doubted = (frame, arrival)
        return self._anchor(frame, arrival) if self._doubts >= FRAMES_TO_RESTART else None


NO_SUCH_COMMAND = (0x01, 0x33)
#: Duration of one tool's BX reply at 115200 baud, which `latency` includes [s].
USUAL_REPLY_S = 10.0 * 53 / 115200


class AuroraSession:
    """The complete communication with one Aurora unit, from the first byte to frames; without I/O."""

    def __init__(self, settings: AuroraSettings) -> None:
        self.dialogue = Dialogue(settings)  #: state of the unit: identity, tools, fault
        self.quality = FrameQuality.CONNECTING
        self.tracking = False
        self.system_status = 0
        self.counts = FrameCounts()
        self.reader = ReplyReader()
        self.last_arrival = -math.inf  #: time when the last new frame arrived [s]
        self._clock = FrameClock(settings.frame_rate)
        self._gate = JumpGate()
        self._target_gate = JumpGate()
        self.target_quality = FrameQuality.CONNECTING  #: quality of the target coil's newest frame
        self._newest: int | None = None  # frame number
        self._orders: list[bytes | RateChange | SerialBreak] = []
        self._script = self._whole()
        self._step: Pause | AuroraRequest = Pause(-math.inf)
        self._deadline = math.inf  # of the present request [s]
        self.wake = -math.inf  #: time of the next action if no bytes arrive [s]

    def receive(self, data: bytes, now: float) -> list[TrackerFrame]:
        """Process bytes that arrived by `now` [s]; return new frames of the tip's coil."""
        self.dialogue.now = now
        measurements: list[TrackerFrame] = []
        for reply in self.reader.feed(data):
            if reply == "RESET" and not (isinstance(self._step, AuroraRequest) and not self._step.command):
                self._restart("the unit was reset")
            elif isinstance(reply, str) and not (self.tracking and self.dialogue.tx and error_code(reply) is None):
                self._text(reply)
            else:
                measurements += self._frame(reply)
        return measurements

    def due(self, now: float) -> list[bytes | RateChange | SerialBreak]:
        """Return the commands that the port must execute at `now` [s], in their order."""
        self.dialogue.now = now
        while not self._orders:
            if isinstance(self._step, Pause):
                if now < self._step.until:
                    break
            elif now < self._deadline:
                break
            else:
                self.counts.timeouts += 1
            self._advance(None)
        orders, self._orders = self._orders, []
        self.wake = self._step.until if isinstance(self._step, Pause) else self._deadline
        return orders

    def farewell(self) -> list[bytes | RateChange | SerialBreak]:
        """Return the command that stops tracking before the port is closed."""
        return [framed("TSTOP:")] if self.tracking else []

    # -- replies ------------------------------------------------------------------------------

    def _text(self, text: str) -> None:
        """Process a text reply: the reply to the present request, or a stray text."""
        step = self._step
        if isinstance(step, AuroraRequest) and (error_code(text) is not None or (step.answers and step.answers(text))):
            self._advance(text)
        else:
            self.counts.stray += 1

    def _frame(self, raw: str | bytes) -> list[TrackerFrame]:
        """Process a BX or TX reply; a late reply is valid, too, because the reply contains the frame's number."""
        try:
            reply = parse_tx(raw) if isinstance(raw, str) else parse_bx(raw)
        except AuroraError:
            self.counts.malformed += 1
            return []
        if not self.tracking:
            self.counts.stray += 1
            return []
        self.system_status = reply.system_status
        tool = reply.tool(self.dialogue.handle)
        measurements: list[TrackerFrame] = []
        if tool is None or tool.frame is None:
            self.quality = FrameQuality.DISABLED
        else:
            measurements = self._measure(tool, tool.frame, len(raw) + (5 if isinstance(raw, str) else 8))
            if self.dialogue.settings.target_serial:
                measurements = [each._replace(target=self._target(reply, each.time)) for each in measurements]
        if isinstance(self._step, AuroraRequest) and self._step.answers is None:
            self._advance(reply)
        return measurements

    def _measure(self, tool: ToolFrame, frame: int, size: int) -> list[TrackerFrame]:
        """Determine time and quality of a frame of the tip's coil, from its entry in a reply of `size` bytes."""
        if frame == self._newest:
            self.counts.repeated += 1
            return []
        arrival = self._clock.soonest(frame, self.dialogue.now - 10.0 * size / self.dialogue.baud)
        if arrival is None:
            self.counts.implausible += 1
            return []
        self.counts.frames += 1
        if self._newest is not None and frame > self._newest:
            self.counts.skipped += frame - self._newest - 1
        self._newest, self.last_arrival = frame, self.dialogue.now
        time = arrival - (self.dialogue.settings.latency - USUAL_REPLY_S)
        self.quality = self._judge(tool, time, self._gate)
        transform = tool.transform if self.quality is FrameQuality.GOOD else None
        if transform is None:
            return [TrackerFrame(frame, time, self.quality, None)]
        tip = transform.ahead(self.dialogue.settings.coil_to_tip)
        return [TrackerFrame(frame, time, self.quality, tip, transform.error, axis=transform.axis)]

    def _target(self, reply: FrameReply, time: float) -> tuple[float, ...] | None:
        """Return the position of the target's coil in the frame measured at `time` [s]; None if it is not valid."""
        tool = reply.tool(self.dialogue.target)
        self.target_quality = FrameQuality.DISABLED if tool is None else self._judge(tool, time, self._target_gate)
        if tool is None or tool.transform is None or self.target_quality is not FrameQuality.GOOD:
            return None
        return tool.transform.position

    def _judge(self, tool: ToolFrame, time: float, gate: JumpGate) -> FrameQuality:
        if self.system_status & HARDWARE_FAILURE or tool.port_status & self.dialogue.settings.fault_bits:
            return FrameQuality.FAULT
        if tool.port_status & (OUT_OF_VOLUME | PARTLY_OUT_OF_VOLUME):
            return FrameQuality.OUT_OF_VOLUME
        if tool.state is ToolState.DISABLED:
            return FrameQuality.DISABLED
        if tool.transform is None:
            return FrameQuality.MISSING
        if not gate.passes(time, tool.transform.position):
            self.counts.jumps += 1
            return FrameQuality.JUMP
        return FrameQuality.GOOD

    # -- the engine of the script ---------------------------------------------------------------

    def _advance(self, reply: Reply) -> None:
        """Run the script up to the next step that waits."""
        while True:
            try:
                step = self._script.send(reply)
            except AuroraError as error:
                self._restart(str(error))
                return
            except StopIteration:
                self._restart("")
                return
            reply = None
            if isinstance(step, (RateChange, SerialBreak)):
                self._orders.append(step)
                if isinstance(step, RateChange):
                    self.dialogue.baud = step.baud
                self.reader.drop()
                continue
            self._step = step
            if isinstance(step, AuroraRequest):
                self._deadline = self.dialogue.now + step.timeout
                self.reader.drop()
                if step.command:
                    self._orders.append(framed(step.command))
            return

    def _restart(self, trouble: str) -> None:
        self.tracking, self.quality = False, FrameQuality.CONNECTING
        self.dialogue.trouble = trouble
        self._script.close()
        self._script = self._whole()
        self._step = Pause(self.dialogue.now + RETRY_WAIT_S)
        self._orders.clear()

    # -- the script -----------------------------------------------------------------------------

    def _whole(self) -> Script:
        """Find the unit, set it up, and request frames until a failure."""
        yield from find_unit(self.dialogue)
        yield from identify(self.dialogue)
        while True:
            yield from prepare_tools(self.dialogue)
            yield from self._track()
            yield from self.dialogue.query("TSTOP:", is_okay, REPLY_TIMEOUT_S)

    def _track(self) -> Script:
        """Request frames; return when a tool has to be set up again."""
        settings = self.dialogue.settings
        reply = yield from self.dialogue.query("TSTART:", is_okay, TOOL_TIMEOUT_S)
        if error_code(str(reply)) == NOT_IN_THIS_MODE:  # the unit tracks already
            yield from self.dialogue.command("TSTOP:", REPLY_TIMEOUT_S)
            yield from self.dialogue.command("TSTART:", TOOL_TIMEOUT_S)
        elif (code := error_code(str(reply))) is not None:
            raise AuroraError(f"TSTART: {error_words(code)}")
        self._clock.restart()
        self._newest, self.dialogue.trouble, self.tracking = None, "", True
        self.counts.connects += 1
        self.last_arrival = self.dialogue.now
        misses = gone = 0
        due, period = self.dialogue.now, 1.0 / settings.frame_rate
        while True:
            before = self._newest
            timeout = settings.frame_timeout + 10.0 * 120 / self.dialogue.baud
            reply = yield AuroraRequest("TX:0801" if self.dialogue.tx else "BX:0801", None, timeout)
            if isinstance(reply, FrameReply):
                misses = 0
                self.dialogue.trouble = system_words(reply.system_status)
                tool = reply.tool(self.dialogue.handle)
                gone = gone + 1 if tool is None or tool.frame is None else 0
                if gone and (gone >= MAX_MISSES or reply.system_status & PORT_OCCUPIED):
                    self.tracking, self.dialogue.trouble = False, "the tool is unplugged"
                    self.quality = FrameQuality.DISABLED
                    return None
                target = reply.tool(self.dialogue.target)
                unplugged = target is None or target.frame is None
                if reply.system_status & PORT_OCCUPIED and settings.target_serial and unplugged:
                    self.tracking, self.dialogue.trouble = False, "the target is plugged in and not set up yet"
                    return None
                # Each request is sent slightly earlier, until a frame is requested before it is measured. So the
                # driver receives every frame early, with only a few more requests than frames.
                if self._newest != before or gone:
                    due = max(due + period - 5e-4, self.dialogue.now - period)
                    if due > self.dialogue.now:
                        yield Pause(due)
                        continue
                due = self.dialogue.now
                continue
            code = error_code(str(reply))
            if code in NO_SUCH_COMMAND and not self.dialogue.tx:
                self.dialogue.tx = True
            elif code is None or code in RETRY_ERRORS:
                misses += 1
                if misses >= MAX_MISSES:
                    raise AuroraError(f"no frame in {misses} replies in a row")
            else:
                raise AuroraError(f"frames refused: {error_words(code)}")
            due = self.dialogue.now
