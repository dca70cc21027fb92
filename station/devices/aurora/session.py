"""The host's side of an Aurora: running the conversation, asking for frames, timing and judging them.

Sans-I/O: bytes and time in, measurements and orders to the port out. The conversation is a script
(`aurora_dialogue`); whatever goes wrong ends it, is told in the dialogue's `trouble`, and it begins anew.
"""

import math

from station.devices.aurora.dialogue import DISTURBED, Ask, Break, Dialogue, Pause, Rate, Reply, Script, is_okay
from station.devices.aurora.measurement import Counts, Measurement, Quality
from station.devices.aurora.protocol import AuroraError, ReplyReader, framed
from station.devices.aurora.replies import (
    HARDWARE_FAILURE,
    NOT_IN_THIS_MODE,
    OUT_OF_VOLUME,
    PARTLY_OUT_OF_VOLUME,
    PORT_OCCUPIED,
    FrameReply,
    ToolFrame,
    ToolState,
    error_code,
    error_words,
    parse_bx,
    parse_tx,
    system_words,
)
from station.devices.aurora.settings import AuroraSettings
from station.devices.aurora.setup import contact, identify, prepare_tools
from station.devices.aurora.timing import FrameClock, JumpGate

NO_SUCH_COMMAND = (0x01, 0x33)
#: One tool's BX reply on the line at the usual rate, which `latency` includes [s].
USUAL_REPLY = 10.0 * 53 / 115200


class AuroraSession:
    """One unit, from the first byte to frames; sans-I/O."""

    def __init__(self, settings: AuroraSettings) -> None:
        self.talk = Dialogue(settings)  #: with the unit: who it is, its tools, its trouble
        self.quality = Quality.CONNECTING
        self.tracking = False
        self.system_status = 0
        self.counts = Counts()
        self.reader = ReplyReader()
        self.last_arrival = -math.inf  #: of a new frame [s]
        self._clock = FrameClock(settings.frame_rate)
        self._gate = JumpGate(settings.fastest, settings.jitter, settings.confirm_jump)
        self._target_gate = JumpGate(settings.fastest, settings.jitter, settings.confirm_jump)
        self.target_quality = Quality.CONNECTING  #: what the newest frame of the target's coil is worth
        self._newest: int | None = None  # frame number
        self._orders: list[bytes | Rate | Break] = []
        self._script = self._whole()
        self._step: Pause | Ask = Pause(-math.inf)
        self._deadline = math.inf  # of what was asked [s]
        self.wake = -math.inf  #: until then there is nothing to do unless bytes come [s]

    def receive(self, data: bytes, now: float) -> list[Measurement]:
        """Take bytes that arrived by `now` [s]; new frames of the tip's coil."""
        self.talk.now = now
        measurements: list[Measurement] = []
        for reply in self.reader.feed(data):
            if reply == "RESET" and not (isinstance(self._step, Ask) and not self._step.command):
                self._begin_anew("the unit was reset")
            elif isinstance(reply, str) and not (self.tracking and self.talk.tx and error_code(reply) is None):
                self._text(reply)
            else:
                measurements += self._frame(reply)
        return measurements

    def due(self, now: float) -> list[bytes | Rate | Break]:
        """What the port has to do by `now` [s], in this order."""
        self.talk.now = now
        while not self._orders:
            if isinstance(self._step, Pause):
                if now < self._step.until:
                    break
            elif now < self._deadline:
                break
            else:
                self.counts.timeouts += 1
            self._go_on(None)
        orders, self._orders = self._orders, []
        self.wake = self._step.until if isinstance(self._step, Pause) else self._deadline
        return orders

    def farewell(self) -> list[bytes | Rate | Break]:
        """What to send before the port is closed: the unit need not track for nobody."""
        return [framed("TSTOP:")] if self.tracking else []

    # -- replies ------------------------------------------------------------------------------

    def _text(self, text: str) -> None:
        """A text reply: the answer to what was asked, or stray."""
        step = self._step
        if isinstance(step, Ask) and (error_code(text) is not None or (step.answers and step.answers(text))):
            self._go_on(text)
        else:
            self.counts.stray += 1

    def _frame(self, raw: str | bytes) -> list[Measurement]:
        """A BX or TX reply, asked for or late: it says itself which frame it is."""
        try:
            reply = parse_tx(raw) if isinstance(raw, str) else parse_bx(raw)
        except AuroraError:
            self.counts.malformed += 1
            return []
        if not self.tracking:
            self.counts.stray += 1
            return []
        self.system_status = reply.system_status
        tool = next((tool for tool in reply.tools if tool.handle == self.talk.handle), None)
        measurements: list[Measurement] = []
        if tool is None or tool.frame is None:
            self.quality = Quality.DISABLED
        else:
            measurements = self._measure(tool, tool.frame, len(raw) + (5 if isinstance(raw, str) else 8))
            if self.talk.settings.target_serial:
                measurements = [each._replace(target=self._target(reply, each.time)) for each in measurements]
        if isinstance(self._step, Ask) and self._step.answers is None:
            self._go_on(reply)
        return measurements

    def _measure(self, tool: ToolFrame, frame: int, size: int) -> list[Measurement]:
        """Time and judge one entry of the tip's coil, from a reply of `size` bytes."""
        if frame == self._newest:
            self.counts.repeated += 1
            return []
        begin = self._clock.soonest(frame, self.talk.now - 10.0 * size / self.talk.baud)
        if begin is None:
            self.counts.implausible += 1
            return []
        self.counts.frames += 1
        if self._newest is not None and frame > self._newest:
            self.counts.skipped += frame - self._newest - 1
        self._newest, self.last_arrival = frame, self.talk.now
        time = begin - (self.talk.settings.latency - USUAL_REPLY)
        self.quality = self._judge(tool, time, self._gate)
        transform = tool.transform if self.quality is Quality.GOOD else None
        if transform is None:
            return [Measurement(frame, time, self.quality, None)]
        tip = transform.ahead(self.talk.settings.coil_to_tip)
        return [Measurement(frame, time, self.quality, tip, transform.error, axis=transform.axis)]

    def _target(self, reply: FrameReply, time: float) -> tuple[float, ...] | None:
        """Where the target's coil was at `time` [s]; None when nobody can tell."""
        tool = next((tool for tool in reply.tools if tool.handle == self.talk.target), None)
        self.target_quality = Quality.DISABLED if tool is None else self._judge(tool, time, self._target_gate)
        if tool is None or tool.transform is None or self.target_quality is not Quality.GOOD:
            return None
        return tool.transform.position

    def _judge(self, tool: ToolFrame, time: float, gate: JumpGate) -> Quality:
        if self.system_status & HARDWARE_FAILURE or tool.port_status & self.talk.settings.fault_bits:
            return Quality.FAULT
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

    def _unplugged_target(self, reply: FrameReply) -> bool:
        return not any(tool.handle == self.talk.target and tool.frame is not None for tool in reply.tools)

    # -- the engine of the script ---------------------------------------------------------------

    def _go_on(self, reply: Reply) -> None:
        """Run the script to its next wait."""
        while True:
            try:
                step = self._script.send(reply)
            except AuroraError as error:
                self._begin_anew(str(error))
                return
            except StopIteration:
                self._begin_anew("")
                return
            reply = None
            if isinstance(step, (Rate, Break)):
                self._orders.append(step)
                if isinstance(step, Rate):
                    self.talk.baud = step.baud
                self.reader.drop()
                continue
            self._step = step
            if isinstance(step, Ask):
                self._deadline = self.talk.now + step.timeout
                self.reader.drop()
                if step.command:
                    self._orders.append(framed(step.command))
            return

    def _begin_anew(self, trouble: str) -> None:
        self.tracking, self.quality = False, Quality.CONNECTING
        self.talk.trouble = trouble
        self._script.close()
        self._script = self._whole()
        self._step = Pause(self.talk.now + self.talk.settings.retry_wait)
        self._orders.clear()

    # -- the script -----------------------------------------------------------------------------

    def _whole(self) -> Script:
        """Find the unit, set it up, and ask for frames until something goes wrong."""
        yield from contact(self.talk)
        yield from identify(self.talk)
        while True:
            yield from prepare_tools(self.talk)
            yield from self._track()
            yield from self.talk.ask("TSTOP:", is_okay, self.talk.settings.reply_timeout)

    def _track(self) -> Script:
        """Ask for frames; returns when the tool has to be set up again."""
        settings = self.talk.settings
        reply = yield from self.talk.ask("TSTART:", is_okay, settings.tool_timeout)
        if error_code(str(reply)) == NOT_IN_THIS_MODE:  # it tracks already
            yield from self.talk.command("TSTOP:", settings.reply_timeout)
            yield from self.talk.command("TSTART:", settings.tool_timeout)
        elif (code := error_code(str(reply))) is not None:
            raise AuroraError(f"TSTART: {error_words(code)}")
        self._clock.restart()
        self._newest, self.talk.trouble, self.tracking = None, "", True
        self.counts.connects += 1
        self.last_arrival = self.talk.now
        misses = gone = 0
        due, period = self.talk.now, 1.0 / settings.frame_rate
        while True:
            before = self._newest
            timeout = settings.frame_timeout + 10.0 * 120 / self.talk.baud
            reply = yield Ask("TX:0801" if self.talk.tx else "BX:0801", None, timeout)
            if isinstance(reply, FrameReply):
                misses = 0
                self.talk.trouble = system_words(reply.system_status)
                tool = next((tool for tool in reply.tools if tool.handle == self.talk.handle), None)
                gone = gone + 1 if tool is None or tool.frame is None else 0
                if gone and (gone >= settings.misses or reply.system_status & PORT_OCCUPIED):
                    self.tracking, self.quality, self.talk.trouble = False, Quality.DISABLED, "the tool is unplugged"
                    return None
                if reply.system_status & PORT_OCCUPIED and settings.target_serial and self._unplugged_target(reply):
                    self.tracking, self.talk.trouble = False, "the target is plugged in and not set up yet"
                    return None
                # A little earlier each time, until a frame is asked for before it is there: so every
                # frame is fetched soon, with hardly more questions than frames.
                if self._newest != before or gone:
                    due = max(due + period - 5e-4, self.talk.now - period)
                    if due > self.talk.now:
                        yield Pause(due)
                        continue
                due = self.talk.now
                continue
            code = error_code(str(reply))
            if code in NO_SUCH_COMMAND and not self.talk.tx:
                self.talk.tx = True
            elif code is None or code in DISTURBED:
                misses += 1
                if misses >= settings.misses:
                    raise AuroraError(f"no frame in {misses} replies in a row")
            else:
                raise AuroraError(f"frames refused: {error_words(code)}")
            due = self.talk.now
