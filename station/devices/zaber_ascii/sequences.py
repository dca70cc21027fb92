"""Scripts that identify, set up and home Zaber ASCII stages; `kernel/stages.py` runs them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from station.devices.kernel.answered import AnsweringLine, FlagChanged, Rejected
from station.devices.kernel.conversation import Conversation
from station.devices.kernel.line import no_answer
from station.devices.kernel.setting import Setting
from station.devices.kernel.stages import AxisFault, Port
from station.devices.kernel.startup import Axes, Script, Value
from station.devices.zaber_ascii.chain import AsciiWire, ascii_chain
from station.devices.zaber_ascii.protocol import (
    BAUD,
    EXPECTED,
    FAULTS,
    MAX_POSITION,
    MICROSTEP_RESOLUTION,
    NOT_HOMED,
    ZaberAsciiError,
    fault_text,
    flag_text,
    reason_text,
)
from station.devices.zaber_ascii.setup import DEADLINE_S, AsciiSetup

#: Setting limit.max of an axis whose homing has not been completed [microsteps]. The flags of the axes do not show an
#: unfinished homing.
UNFINISHED = MAX_POSITION - 1
#: Settings that a device keeps without power.
SETTINGS = {
    each.name: each
    for each in (
        Setting(
            "resolution", "microsteps per step, for which the robot's file gives the size of a microstep",
            "set the resolution with Zaber's program",
        ),
        Setting("accel", "acceleration and deceleration; braking distances assume at least it"),
        Setting("motion.accelonly", "acceleration, if it was set to another value than `accel`"),
        Setting("motion.decelonly", "deceleration; braking distances assume at least it"),
        Setting("motion.accel.ramptime", "time in which the acceleration grows, so that braking takes longer [ms]"),
        Setting("maxspeed", "speed of motions to a position; velocity commands do not use it"),
        Setting("limit.approach.maxspeed", "speed towards the home sensor"),
        Setting("limit.min", "lower end of the travel"),
        Setting("limit.max", "upper end of the travel, and mark of an unfinished homing"),
    )
}  # fmt: skip
#: Settings that older firmware does not have.
OPTIONAL = frozenset({"motion.accelonly", "motion.decelonly", "motion.accel.ramptime"})
#: Flags of an axis whose motor gets current again by `driver enable`.
WITHOUT_CURRENT = frozenset({"FO", "FD", "FH", "FV"})


class Identity(NamedTuple):
    """Identity that a device reports."""

    device_id: str
    firmware: str
    serial: str


class AsciiProtocol:
    """Zaber ASCII stages on one chain."""

    line: AnsweringLine

    def __init__(self, setups: Sequence[AsciiSetup], deadline: float = DEADLINE_S) -> None:
        """`deadline` is the longest time from sending a command to its reply [s]."""
        self.axes, self._deadline = Axes(setups), deadline
        self._requests = Conversation(self.axes, ZaberAsciiError, reason_text, fault_text)
        self._homing_start: dict[int, int] = {}  # position at which an unfinished homing started [microsteps]

    def session(self, ports: Sequence[Port], *, again: bool) -> Sequence[AnsweringLine]:  # noqa: ARG002 - all axes stop
        """Start a new session: every axis stops."""
        self._wire = AsciiWire(self.axes.setups)
        self.line = ascii_chain(self._wire, self.axes.setups, self._deadline)
        self.line.stop()
        return (self.line,)

    def happened(self, i: int, event: Any, connected: bool) -> AxisFault | None:
        """Return the fault that an event of an axis means; `connected`: no script is running."""
        match event:
            case Rejected(_, reason):
                return AxisFault(f"rejects its velocity: {reason_text(reason)}")
            case FlagChanged(_, flag) if connected and flag in FAULTS:
                return AxisFault(f"reports: {flag_text(flag)}")
            case FlagChanged(_, flag) if connected and flag in NOT_HOMED and self.axes.homed[i]:
                return AxisFault("has lost its position; was it switched off and on? Home it again", True)
        return None

    def warning(self, i: int) -> str:
        """Return the meaning of an unexpected warning flag; empty without one."""
        flag = self.line.flags[i]
        return flag_text(flag) if flag and flag not in EXPECTED and flag not in NOT_HOMED else ""

    def address(self, i: int) -> str:
        """Return device and axis number of a stage, for the details of messages."""
        return f"device {self.axes.setups[i].device} axis {self.axes.setups[i].axis}"

    def details(self, i: int) -> Mapping[str, Any]:
        """Return numbers and flag of a stage."""
        setup = self.axes.setups[i]
        flag, lost = self.line.flags[i], self._wire.reader.dropped.count
        return {"device": setup.device, "axis": setup.axis, "flag": flag, "lost_bytes": lost}

    def connect(self) -> Script:
        """Identify and set up every stage, then wait for the positions of all homed stages."""
        self._wire.reader.checked = False
        with_checksum = True
        for i in range(len(self.axes.setups)):
            with_checksum &= yield from self._identify(i)
        self._wire.reader.checked = with_checksum
        for i, setup in enumerate(self.axes.setups):
            yield from self._requests.need(i, "warnings clear")
            if self.line.flags[i] in WITHOUT_CURRENT:
                yield from self._requests.request(i, "driver enable")
            resolution = yield from self._requests.need(i, "get resolution")
            self.axes.record(i, SETTINGS["resolution"], resolution)
            if resolution != str(MICROSTEP_RESOLUTION):
                raise ZaberAsciiError(
                    f"{self.axes.name(i)} has {resolution} microsteps per step; {MICROSTEP_RESOLUTION} is expected, "
                    f"for which the robot's file gives the size of a microstep: {SETTINGS['resolution'].refused}"
                )
            finished = (yield from self._requests.need(i, "get limit.max")) != str(UNFINISHED)
            for setting, value in (
                ("accel", setup.acceleration),
                ("motion.accelonly", setup.acceleration),
                ("motion.decelonly", setup.acceleration),
                ("motion.accel.ramptime", 0),
                ("maxspeed", setup.home_data),
                ("limit.approach.maxspeed", setup.home_data),
                ("limit.min", setup.minimum),
                ("limit.max", setup.maximum if finished else UNFINISHED),
            ):
                found = yield from self._set(i, setting, value)
                self.axes.record(i, SETTINGS[setting], found, value)
            flag = (yield from self._requests.checked(i, "get pos")).flag
            self.axes.homed[i] = flag not in NOT_HOMED and finished and i not in self.axes.home_again
            self.line.axes.estimates[i].forget()
        self.line.polling = True
        yield from self.axes.settle()

    def home(self) -> Script:
        """Home every axis."""
        yield from self.axes.home_at_rest(self, lambda: self.line.axes.stopping)

    def mark(self, i: int, *, finished: bool) -> Script:
        """Mark an axis as homed, or not, by its upper limit."""
        yield from self._set(i, "limit.max", self.axes.setups[i].maximum if finished else UNFINISHED)
        if finished:
            self._homing_start.pop(i, None)

    def seek(self, i: int, give_up: float) -> Value[float]:
        """Move an axis to its home sensor, and return how far it moved [rad or m]."""
        start = self._homing_start.setdefault(i, int((yield from self._requests.need(i, "get pos"))))
        last = yield from self._requests.motion(i, "home", "get pos", give_up)
        if (yield from self._requests.checked(i, "get pos")).flag in NOT_HOMED:
            raise ZaberAsciiError(f"{self.axes.name(i)} stopped without reaching its home sensor; is it free to move?")
        return (start - last) * self.axes.setups[i].joint.microstep

    def turn_back(self, i: int, give_up: float) -> Script:
        """Turn a rotation up by one turn, and count zero there."""
        turn = self.axes.setups[i].turn
        yield from self._requests.motion(i, f"move abs {turn}", "get pos", give_up)
        position = yield from self._requests.need(i, "get pos")
        if position != str(turn):
            raise ZaberAsciiError(f"{self.axes.name(i)} is at {position} microsteps after a turn of {turn}")
        yield from self._requests.need(i, "set pos 0")

    def _identify(self, i: int) -> Value[bool]:
        """Check the identity of a device, and return whether it sends checksums."""
        setup, name = self.axes.setups[i], self.axes.name(i)
        self._wire.reader.dropped.last = b""
        first = yield from self.axes.first_answer(name, lambda: self._requests.once(i, "get deviceid"))
        if first is None:
            check = f"is it powered, plugged in, set to {BAUD} baud and ASCII, and numbered {setup.device}?"
            raise ZaberAsciiError(no_answer(name, self._wire.reader.unread, "lines that start with '@'", check))
        firmware = yield from self._requests.need(i, "get version", whole_device=True)
        serial = yield from self._requests.need(i, self._wire.serial_number, whole_device=True)
        if firmware.split(".")[0] not in ("6", "7"):
            raise ZaberAsciiError(f"{name} has firmware {firmware}; 6 and 7 are supported")
        expected = None if setup.serial is None else str(setup.serial)
        self.axes.identify(i, Identity(first.data, firmware, serial), {"serial": expected})
        yield from self._requests.request(i, "set knob.enable 0", whole_device=True)  # devices without a knob reject it
        return (yield from self._requests.request(i, "set comm.checksum 1", whole_device=True)).accepted

    def _set(self, i: int, setting: str, value: int) -> Value[str]:
        """Write a setting only if its value is different, because its memory wears out; return the value before."""
        answer = yield from self._requests.request(i, f"get {setting}")
        if setting in OPTIONAL and answer.data == "BADCOMMAND":
            return "none"
        present = self._requests.accepted(i, f"get {setting}", answer)
        if present != str(value):
            yield from self._requests.need(i, f"set {setting} {value}")
        return present
