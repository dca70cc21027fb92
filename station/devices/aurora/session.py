"""The host's side of an Aurora: runs the communication script, requests frames, and determines their times and quality.

The session does no I/O: it receives bytes and the time, and returns measurements and commands for the port. The
communication is a script (`dialogue.py`). Any failure ends the script and sets the dialogue's `trouble` to the reason;
then the script starts again.
"""

import math
from dataclasses import dataclass
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
from station.devices.kernel.quality import Quality, quoted
from station.devices.kernel.sampled import SampleClock


class TrackerFrame(NamedTuple):
    """One new frame of the tip's coil."""

    frame: int
    time: float  #: time of the measurement, from the frame number [s]
    quality: Quality
    position: tuple[float, ...] | None  #: robot's tip in the field generator's frame, only when GOOD [mm]
    error: float = 0.0  #: error indicator of the unit [mm]
    target: tuple[float, ...] | None = None  #: target's coil in the generator's frame, only when good [mm]
    axis: tuple[float, ...] | None = None  #: unit vector along the tip's coil, in the generator's frame, only when GOOD


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


#: Largest drift between the clocks of tracker and computer [s/s], and number of different frame numbers.
MAX_CLOCK_DRIFT, FRAME_NUMBERS = 5e-4, 1 << 32
MAX_UNREADABLE_BYTES = 64  #: number of newest unreadable bytes that are kept: more than an incomplete frame has
MAX_MISSES = 5  #: number of failed frame requests in a row after which the session restarts


NO_SUCH_COMMAND = (0x01, 0x33)  #: error codes of a unit that does not have the command BX
#: Duration of one tool's BX reply at 115200 baud, which `latency` includes [s].
USUAL_REPLY_S = 10.0 * 53 / 115200


class AuroraSession:
    """The complete communication with one Aurora unit, from the first byte to frames; without I/O."""

    def __init__(self, settings: AuroraSettings) -> None:
        self.dialogue = Dialogue(settings)  #: state of the unit: identity, tools, fault
        self.quality = Quality.CONNECTING
        self.tracking = False
        self.system_status = 0
        self.counts = FrameCounts()
        self.reader = ReplyReader()
        self.last_arrival = -math.inf  #: time when the last new frame arrived [s]
        self.clock = SampleClock(settings.frame_rate, MAX_CLOCK_DRIFT, settings.latency - USUAL_REPLY_S, FRAME_NUMBERS)
        self._gate = JumpGate()
        self._target_gate = JumpGate()
        self.target_quality = Quality.CONNECTING  #: quality of the target coil's newest frame
        self._newest: int | None = None  # number of the newest frame; None: no frame since tracking has started
        self._orders: list[bytes | RateChange | SerialBreak] = []
        self._script = self._whole()
        self._step: Pause | AuroraRequest = Pause(-math.inf)
        self._deadline = math.inf  # time at which the present request fails without a reply [s]
        self.wake = -math.inf  #: time of the next action if no bytes arrive [s]

    def receive(self, data: bytes, now: float) -> list[TrackerFrame]:
        """Process bytes that arrived by `now` [s]; return new frames of the tip's coil."""
        self.dialogue.now = now
        self.dialogue.unreadable = (self.dialogue.unreadable + data)[-MAX_UNREADABLE_BYTES:]
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
        """Process a BX or TX reply; a late reply is valid, too, because it contains the number of its frame."""
        try:
            reply = parse_tx(raw) if isinstance(raw, str) else parse_bx(raw)
        except AuroraError:
            self.counts.malformed += 1
            return []
        if not self.tracking:
            self.counts.stray += 1
            return []
        self.system_status, self.dialogue.unreadable = reply.system_status, b""
        tool = reply.tool(self.dialogue.handle)
        measurements: list[TrackerFrame] = []
        if tool is None or tool.frame is None:
            self.quality = Quality.DISABLED
        else:
            measurements = self._measure(tool, tool.frame, len(raw) + (5 if isinstance(raw, str) else 8))
            if self.dialogue.settings.target:
                measurements = [each._replace(target=self._target(reply, each.time)) for each in measurements]
        if isinstance(self._step, AuroraRequest) and self._step.answers is None:
            self._advance(reply)
        return measurements

    def _measure(self, tool: ToolFrame, frame: int, size: int) -> list[TrackerFrame]:
        """Determine time and quality of a frame of the tip's coil, from its entry in a reply of `size` bytes."""
        if frame == self._newest:
            self.counts.repeated += 1
            return []
        time = self.clock.measured(frame, self.dialogue.now - 10.0 * size / self.dialogue.baud)
        if time is None:
            self.counts.implausible += 1
            return []
        self.counts.frames += 1
        if self._newest is not None and frame > self._newest:
            self.counts.skipped += frame - self._newest - 1
        self._newest, self.last_arrival = frame, self.dialogue.now
        self.quality = self._judge(tool, time, self._gate)
        transform = tool.transform if self.quality is Quality.GOOD else None
        if transform is None:
            return [TrackerFrame(frame, time, self.quality, None)]
        tip = transform.ahead(self.dialogue.settings.coil_to_tip)
        return [TrackerFrame(frame, time, self.quality, tip, transform.error, axis=transform.axis)]

    def _target(self, reply: FrameReply, time: float) -> tuple[float, ...] | None:
        """Return the position of the target's coil in the frame measured at `time` [s]; None if it is not valid."""
        tool = reply.tool(self.dialogue.target)
        self.target_quality = Quality.DISABLED if tool is None else self._judge(tool, time, self._target_gate)
        if tool is None or tool.transform is None or self.target_quality is not Quality.GOOD:
            return None
        return tool.transform.position

    def _judge(self, tool: ToolFrame, time: float, gate: JumpGate) -> Quality:
        if self.system_status & HARDWARE_FAILURE or tool.port_status & self.dialogue.settings.fault_bits:
            return Quality.DEVICE_FAULT
        if tool.port_status & (OUT_OF_VOLUME | PARTLY_OUT_OF_VOLUME):
            return Quality.OUT_OF_VOLUME
        if tool.state is ToolState.DISABLED:
            return Quality.DISABLED
        if tool.transform is None:
            return Quality.MISSING
        if not gate.passes(time, tool.transform.position):
            self.counts.jumps += 1
            return Quality.JUMP
        return Quality.GOOD

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
        self.tracking, self.quality = False, Quality.CONNECTING
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
        self.clock.restart()
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
                    self.quality = Quality.DISABLED
                    return None
                target = reply.tool(self.dialogue.target)
                unplugged = target is None or target.frame is None
                if reply.system_status & PORT_OCCUPIED and settings.target and unplugged:
                    self.tracking, self.dialogue.trouble = False, "the target is plugged in but not set up yet"
                    return None
                # Each request is sent slightly earlier than one period after the last one, until a request comes before
                # its frame is measured. So every frame arrives early, with only a few more requests than frames.
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
                    sent = f"; it sent {quoted(self.dialogue.unreadable)}" if self.dialogue.unreadable else ""
                    raise AuroraError(f"no frame in {misses} replies in a row{sent}")
            else:
                raise AuroraError(f"frames refused: {error_words(code)}")
            due = self.dialogue.now
