"""Scripts that identify, set up and home CANopen drives; `kernel/stages.py` runs them."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from station.devices.cia402.bus import DEADLINE_S, Answer, DriveBus, Emergency, InFault, Request, Restarted, SwitchedOff
from station.devices.cia402.makes import ACCELERATION_UNIT, MAKES, POSITION_UNIT, VELOCITY_UNIT, Entry
from station.devices.cia402.protocol import (
    COMMAND,
    CONTROLWORD,
    EMERGENCY_CODE,
    ENABLE,
    ENABLED,
    FAULT_BIT,
    HOMING_ATTAINED,
    HOMING_ERROR,
    HOMING_MODE,
    HOST_NODE,
    MODE,
    NO_OBJECT,
    POSITION,
    PRE_OPERATIONAL,
    PROFILE_POSITION,
    PROFILE_VELOCITY,
    QUICK_STOP,
    RESET_FAULT,
    SERIAL_NUMBER,
    SHUTDOWN,
    START_MOTION,
    START_NODE,
    STATE_MASK,
    STATUS,
    STATUSWORD,
    SWITCH_ON,
    TARGET_POSITION,
    TARGET_REACHED,
    TARGET_VELOCITY,
    CanError,
    abort_text,
    emergency_text,
    signed,
    text,
)
from station.devices.cia402.setup import DriveSetup
from station.devices.kernel.line import no_answer
from station.devices.kernel.setting import Setting
from station.devices.kernel.stages import AxisFault, Port
from station.devices.kernel.startup import STOP_TIMEOUT_S, Axes, Script, Value

MAX_ATTEMPTS = 4  #: largest number of times that a request without an answer is sent
WATCHDOG_MARGIN_S = 0.07  #: the drives tolerate a silence of the host that is longer than the deadline by this time [s]
MAX_LIMIT = (0x607D, 2)  #: object with the upper software limit of the position
#: `MAX_LIMIT` of a drive whose homing has not been completed [counts]. A drive reports to be homed before it has turned
#: back, and the drives that home later still report their last homing.
UNFINISHED = (1 << 31) - 2
SET_HOME_HERE = 37  #: homing method: the present position is the home position
HOME_OFFSET, POLARITY, PROFILE_TYPE = (0x607C, 0), (0x607E, 0), (0x6086, 0)
#: Objects that a drive may lack; such a drive behaves as if the object's value were 0.
OPTIONAL = frozenset((HOME_OFFSET, POLARITY, PROFILE_TYPE))
MOTOR_SPEED, MAX_ACCELERATION, MAX_DECELERATION = (0x6080, 0), (0x60C5, 0), (0x60C6, 0)
#: Turns of the motor and of the shaft, by which a drive scales its positions.
GEAR_RATIO = ((0x6091, 1), (0x6091, 2))
GEAR = Setting("0x6091", "turns of the motor per turns of the shaft", "the driver uses encoder counts: set it to 1 / 1")
#: Objects that are checked (units) or written at each connection, with the size of those written [bytes].
UNIT = "set it, or write another `make`"
SLOWS = "raise it, or lower the joint's values in the robot's file"
BRAKES = "is its limit of the acceleration too low?"
OBJECTS: Mapping[Entry, tuple[Setting, int]] = {
    POSITION_UNIT: (Setting("0x60A8", "unit of positions", UNIT), 4),
    VELOCITY_UNIT: (Setting("0x60A9", "unit of velocities", UNIT), 4),
    ACCELERATION_UNIT: (Setting("0x60AA", "unit of accelerations", UNIT), 4),
    (0x607D, 1): (Setting("0x607D:1", "lower end of the travel"), 4),
    MAX_LIMIT: (Setting("0x607D:2", "upper end of the travel, and mark of an unfinished homing"), 4),
    (0x607F, 0): (Setting("0x607F", "largest speed"), 4),
    (0x6083, 0): (Setting("0x6083", "acceleration", BRAKES), 4),
    (0x6084, 0): (Setting("0x6084", "deceleration; braking distances assume at least it", BRAKES), 4),
    (0x6085, 0): (Setting("0x6085", "deceleration of a quick stop", BRAKES), 4),
    (0x605A, 0): (Setting("0x605A", "what a quick stop does (6: brakes, and the motor keeps its current)"), 2),
    (0x6007, 0): (Setting("0x6007", "what the drive does without the host's heartbeat (3: quick stop)"), 2),
    (0x1016, 1): (Setting("0x1016:1", "heartbeat of the host: 65536 x its node + time limit [ms]"), 4),
    HOME_OFFSET: (Setting("0x607C", "count at the home sensor"), 4),
    POLARITY: (Setting("0x607E", "directions of positions and velocities (0: not reversed)"), 1),
    PROFILE_TYPE: (Setting("0x6086", "form of ramps (0: constant acceleration)"), 2),
    MOTOR_SPEED: (Setting("0x6080", "limit of all velocities", SLOWS), 4),
    MAX_ACCELERATION: (Setting("0x60C5", "limit of all accelerations", SLOWS), 4),
    MAX_DECELERATION: (Setting("0x60C6", "limit of all decelerations", SLOWS), 4),
    TARGET_VELOCITY: (Setting("0x60FF", "velocity at the start"), 4),
}
NOT_VALID = 1 << 31  #: bit of a PDO's identifier that switches the PDO off
NO_REMOTE = 1 << 30  #: bit of a PDO's identifier that forbids remote requests of the PDO


class Identity(NamedTuple):
    """Identity that a drive reports in object 0x1018."""

    vendor: int
    product: int
    revision: int
    serial: int


class DriveProtocol:
    """CANopen drives on one bus."""

    line: DriveBus

    def __init__(self, setups: Sequence[DriveSetup], deadline: float = DEADLINE_S) -> None:
        """`deadline` is the longest silence of a drive [s]."""
        self.axes, self._deadline = Axes(setups), deadline
        self._homing_start: dict[int, int] = {}  # position at which an unfinished homing started [counts]

    def session(self, ports: Sequence[Port], *, again: bool) -> Sequence[DriveBus]:  # noqa: ARG002 - all axes stop
        """Start a new session: every axis stops."""
        self.line = DriveBus(self.axes.setups, self._deadline)
        self.line.stop()
        return (self.line,)

    def happened(self, i: int, event: Any, connected: bool) -> AxisFault | None:  # noqa: ARG002 - not needed
        """Return the fault that an event of a drive means."""
        match event:
            case Restarted():
                return AxisFault("has restarted and lost its position; was it switched off and on?", True)
            case Emergency(_, code):
                return AxisFault(f"reports: {emergency_text(code)}")
            case InFault():
                return AxisFault("is in the state 'fault'")
            case SwitchedOff(_, status):
                return AxisFault(
                    f"was switched off and receives no velocities (statusword 0x{status:04X}): check its enable input,"
                    " its supply and other programs on the bus, then connect again"
                )
        return None

    def warning(self, i: int) -> str:
        """Return a warning if the drive sets the warning bit of its statusword; empty without one."""
        return "the drive warns (bit 7 of its statusword)" if self.line.status[i] & 1 << 7 else ""

    def address(self, i: int) -> str:
        """Return the node number of a drive, for the details of messages."""
        return f"node {self.axes.setups[i].node}"

    def details(self, i: int) -> Mapping[str, Any]:
        """Return node and statusword of a drive."""
        status, lost = f"0x{self.line.status[i]:04X}", self.line.reader.dropped.count
        return {"node": self.axes.setups[i].node, "statusword": status, "lost_bytes": lost}

    def connect(self) -> Script:
        """Identify, set up and enable every drive, then wait for the positions of all homed drives."""
        for i in range(len(self.axes.setups)):
            yield from self._identify(i)
        for i in range(len(self.axes.setups)):
            self.line.manage(i, PRE_OPERATIONAL)
            yield from self._stop_one(i)
            finished = (yield from self._read(i, MAX_LIMIT)) != UNFINISHED
            yield from self._set_up(i, self.axes.setups[i].maximum if finished else UNFINISHED)
            yield from self._write(i, MODE, HOMING_MODE, 1)
            yield 0.01
            status = yield from self._read(i, STATUSWORD)
            self.axes.homed[i] = bool(status & HOMING_ATTAINED) and finished and i not in self.axes.home_again
            yield from self._enable(i)
            self.line.axes.estimates[i].forget()
            self.line.manage(i, START_NODE)
            self.line.start_cycle(i)
            self.line.driven.add(i)
        yield from self.axes.settle()

    def home(self) -> Script:
        """Home every drive."""
        yield from self.axes.home_at_rest(self, lambda: self.line.axes.stopping)

    # Parts of connecting

    def _identify(self, i: int) -> Script:
        name, setup = self.axes.name(i), self.axes.setups[i]
        self.line.reader.dropped.last = b""
        kind = yield from self.axes.first_answer(name, lambda: self._asked(i, (0x1000, 0)))
        if kind is None:
            check = f"is it powered, plugged in, set to node {setup.node} and 1 Mbit/s, and is the adapter for slcan?"
            raise CanError(no_answer(name, self.line.reader.unread, "lines of an slcan adapter", check))
        if kind.value & 0xFFFF != 402:
            raise CanError(f"{name} is no drive with the profile CiA 402: its device type is 0x{kind.value:08X}")
        vendor = yield from self._read(i, (0x1018, 1))
        product = yield from self._read(i, (0x1018, 2))
        revision = yield from self._read(i, (0x1018, 3))
        serial = yield from self._read(i, SERIAL_NUMBER)
        self.axes.identify(i, Identity(vendor, product, revision, serial), {"serial": setup.serial})

    def _stop_one(self, i: int) -> Script:
        """Stop a drive that an earlier session may have left in motion, and acknowledge its fault."""
        yield from self._write(i, CONTROLWORD, QUICK_STOP, 2)
        give_up, last = self.axes.now + STOP_TIMEOUT_S, math.nan
        while last != (position := (yield from self._read(i, POSITION))):
            if self.axes.now > give_up:
                raise CanError(f"{self.axes.name(i)} does not stop")
            last = position
            yield 0.02
        if (yield from self._read(i, STATUSWORD)) & FAULT_BIT:
            yield from self._write(i, CONTROLWORD, 0, 2)
            yield from self._write(i, CONTROLWORD, RESET_FAULT, 2)
            yield 0.02
            if (yield from self._read(i, STATUSWORD)) & FAULT_BIT:
                code = yield from self._read(i, EMERGENCY_CODE)
                raise CanError(f"{self.axes.name(i)} stays in the state 'fault': {emergency_text(code)}")

    def _set_up(self, i: int, maximum: int) -> Script:
        setup, node = self.axes.setups[i], self.axes.setups[i].node
        make, ramp = MAKES[setup.make], setup.acceleration
        for entry in make.settable:
            yield from self._write(i, entry, make.units[entry])
        for entry, wanted in make.units.items():
            found = yield from self._request(i, entry)  # older drives do not have these objects
            self.axes.record(i, OBJECTS[entry][0], f"0x{found.value:08X}" if found.accepted else "none")
            if found.accepted and found.value not in (0, wanted):
                raise CanError(
                    f"{self.axes.name(i)}: its unit {text(entry)} is 0x{found.value:08X}; for make '{setup.make}' it"
                    f" must be 0x{wanted:08X}: {OBJECTS[entry][0].refused}"
                )
        watchdog = HOST_NODE << 16 | round(1e3 * (self._deadline + WATCHDOG_MARGIN_S))
        for entry, value in (
            ((0x607D, 1), setup.minimum), (MAX_LIMIT, maximum), ((0x607F, 0), setup.top), ((0x6083, 0), ramp),
            ((0x6084, 0), ramp), ((0x6085, 0), ramp), ((0x605A, 0), 6), ((0x6007, 0), 3), ((0x1016, 1), watchdog),
            (HOME_OFFSET, 0), (POLARITY, 0), (PROFILE_TYPE, 0), (TARGET_VELOCITY, 0),
        ):  # fmt: skip
            setting, size = OBJECTS[entry]
            yield from self._write(i, entry, value, size)
            self.axes.record(i, setting, None, value)
        for entry in ((0x6083, 0), (0x6084, 0), (0x6085, 0)):  # the braking distance depends on them
            if (found := (yield from self._read(i, entry))) != ramp:
                raise CanError(
                    f"{self.axes.name(i)} keeps {found} in {text(entry)} instead of {ramp}:"
                    f" it would not brake as the robot's file says; {OBJECTS[entry][0].refused}"
                )
        motor = yield from self._request(i, GEAR_RATIO[0])
        shaft = yield from self._request(i, GEAR_RATIO[1])
        if motor.accepted and shaft.accepted:
            self.axes.record(i, GEAR, ratio := f"{motor.value} / {shaft.value}")
            if motor.value != shaft.value:
                raise CanError(f"{self.axes.name(i)} has a gear ratio of {ratio} (0x6091); {GEAR.refused}")
        limits = [(MAX_ACCELERATION, ramp), (MAX_DECELERATION, ramp)]
        for entry, needed in limits + ([(make.speed_limit, setup.top)] if make.speed_limit else []):
            found = yield from self._request(i, entry)
            self.axes.record(i, OBJECTS[entry][0], found.value if found.accepted else "none")
            if found.accepted and found.value < needed:  # the drive would move more slowly without an error
                raise CanError(
                    f"{self.axes.name(i)} limits itself: {text(entry)} is {found.value}, but the joint needs {needed};"
                    f" {OBJECTS[entry][0].refused}"
                )
        # The drive receives controlword and velocity in one frame, and sends statusword and position after each SYNC.
        yield from self._map(i, 0x1400, COMMAND + node, 255, (0x60400010, 0x60FF0020))
        yield from self._map(i, 0x1800, NO_REMOTE | STATUS + node, 1, (0x60410010, 0x60640020))

    def _map(self, i: int, index: int, identifier: int, kind: int, objects: Sequence[int]) -> Script:
        """Define the content of a PDO while it is switched off."""
        yield from self._write(i, (index, 1), NOT_VALID | identifier)
        yield from self._write(i, (index, 2), kind, 1)
        yield from self._write(i, (index + 0x200, 0), 0, 1)
        for number, each in enumerate(objects, 1):
            yield from self._write(i, (index + 0x200, number), each)
        yield from self._write(i, (index + 0x200, 0), len(objects), 1)
        yield from self._write(i, (index, 1), identifier)

    def _enable(self, i: int) -> Script:
        """Bring a drive to the state 'operation enabled' with velocity zero."""
        yield from self._write(i, MODE, PROFILE_VELOCITY, 1)
        yield from self._write(i, TARGET_VELOCITY, 0)
        for word in (SHUTDOWN, SWITCH_ON, ENABLE):
            yield from self._write(i, CONTROLWORD, word, 2)
            yield 0.004
        give_up = self.axes.now + 1.0
        while (status := (yield from self._read(i, STATUSWORD))) & STATE_MASK != ENABLED:
            if self.axes.now > give_up:
                raise CanError(f"{self.axes.name(i)} cannot be enabled: its statusword is 0x{status:04X}")
            yield 0.02

    # Parts of homing

    def mark(self, i: int, *, finished: bool) -> Script:
        """Mark a drive as homed, or not, by its upper limit; a homed drive receives velocities."""
        yield from self._write(i, MAX_LIMIT, self.axes.setups[i].maximum if finished else UNFINISHED)
        if finished:
            self._homing_start.pop(i, None)
            yield from self._enable(i)
            self.line.driven.add(i)

    def seek(self, i: int, give_up: float) -> Value[float]:
        """Move a drive to its home sensor, and return how far it moved [rad or m]."""
        self.line.release(i)
        start = self._homing_start.setdefault(i, signed((yield from self._read(i, POSITION))))
        last = yield from self._home_by(i, self.axes.setups[i].homing_method, give_up)
        return (start - last) * self.axes.setups[i].joint.microstep

    def turn_back(self, i: int, give_up: float) -> Script:
        """Turn a rotation up by one turn, and count zero there."""
        setup = self.axes.setups[i]
        yield from self._write(i, MODE, PROFILE_POSITION, 1)
        yield from self._write(i, (0x6081, 0), setup.units(setup.home_speed))  # profile velocity
        yield from self._write(i, TARGET_POSITION, setup.turn)
        yield from self._motion(i, TARGET_REACHED, give_up)
        yield from self._home_by(i, SET_HOME_HERE, self.axes.now + 10.0)

    def _home_by(self, i: int, method: int, give_up: float) -> Value[int]:
        """Home a drive by a method of CiA 402, and return the last position before the end of the motion [counts]."""
        speed, setup = self.axes.setups[i].units(self.axes.setups[i].home_speed), self.axes.setups[i]
        yield from self._write(i, (0x6098, 0), method, 1)
        yield from self._write(i, (0x6099, 1), speed)  # while searching the switch
        yield from self._write(i, (0x6099, 2), speed)  # while searching the zero
        yield from self._write(i, (0x609A, 0), setup.acceleration)
        yield from self._write(i, MODE, HOMING_MODE, 1)
        return (yield from self._motion(i, HOMING_ATTAINED | TARGET_REACHED, give_up))

    def _motion(self, i: int, ended: int, give_up: float) -> Value[int]:
        """Start a motion, wait until all bits of `ended` are set, and return the last position before [counts]."""
        started, last = self.axes.now, 0
        yield from self._write(i, CONTROLWORD, ENABLE, 2)
        yield from self._write(i, CONTROLWORD, START_MOTION, 2)
        while True:
            yield 0.05
            status = yield from self._read(i, STATUSWORD)
            if status & FAULT_BIT:
                code = yield from self._read(i, EMERGENCY_CODE)
                raise CanError(f"{self.axes.name(i)}: {emergency_text(code)}")
            if ended & HOMING_ATTAINED and status & HOMING_ERROR:
                raise CanError(f"{self.axes.name(i)} has not found its home sensor; is it free to move?")
            if status & ended == ended:
                return last
            last = signed((yield from self._read(i, POSITION)))
            if self.axes.now > give_up:
                raise CanError(f"{self.axes.name(i)} has been moving for more than {give_up - started:.0f} s")

    # Requests

    def _read(self, i: int, entry: tuple[int, int]) -> Value[int]:
        answer = yield from self._request(i, entry)
        self._check(i, entry, answer)
        return answer.value

    def _write(self, i: int, entry: tuple[int, int], value: int, size: int = 4) -> Script:
        answer = yield from self._request(i, entry, value, size)
        if entry in OPTIONAL and not value and answer.value == NO_OBJECT:
            return  # a drive without this object behaves as with the value 0
        self._check(i, entry, answer)

    def _check(self, i: int, entry: tuple[int, int], answer: Answer) -> None:
        if answer.missing:
            raise CanError(f"{self.axes.name(i)} does not answer a request for {text(entry)}")
        if not answer.accepted:
            raise CanError(f"{self.axes.name(i)} rejects {text(entry)}: {abort_text(answer.value)}")

    def _asked(self, i: int, entry: Entry) -> Value[Answer | None]:
        """Send a request once, and return its answer; if none comes, open the adapter again and return None."""
        answer = yield Request(i, entry)
        if answer.missing:
            self.line.open_adapter()
        return None if answer.missing else answer

    def _request(self, i: int, entry: tuple[int, int], value: int | None = None, size: int = 4) -> Value[Answer]:
        """Return the answer to a request, which is sent again if its answer is lost."""
        for _ in range(MAX_ATTEMPTS):
            answer = yield Request(i, entry, value, size)
            if answer is not None and not answer.missing:
                return answer
        return Answer(missing=True)
