"""Connects and homes CANopen drives by requests, one at a time; the caller runs these sequences."""

import math
from collections.abc import Generator, Mapping, Sequence
from typing import Any, NamedTuple

from station.devices.cia402.bus import (
    DEADLINE_S,
    Answer,
    DriveBus,
    Emergency,
    InFault,
    Request,
    Restarted,
    UnexpectedMotion,
)
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
    POSITION,
    PRE_OPERATIONAL,
    PROFILE_POSITION,
    PROFILE_VELOCITY,
    QUICK_STOP,
    RESET_FAULT,
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
from station.devices.stages_on_line import AxisFault
from station.devices.zaber.sequences import Homing, HomingStep

MAX_ATTEMPTS = 4  #: largest number of times that a request without an answer is sent
STOP_TIMEOUT_S = 5.0  #: time in which every axis must confirm a stop [s]
WATCHDOG_MARGIN_S = 0.07  #: the drives tolerate a silence of the host that is longer than the deadline by this time [s]
SET_HOME_HERE = 37  #: homing method: the present position is the home position
NOT_VALID = 1 << 31  #: bit of a PDO's identifier by which the PDO is switched off
NO_REMOTE = 1 << 30  #: bit of a PDO's identifier by which nobody can request the PDO

Script = Generator[Request | float, Answer | None, None]
Value = Generator[Request | float, Answer | None, int]


class Identity(NamedTuple):
    """Identity that a drive reports in object 0x1018."""

    vendor: int
    product: int
    revision: int
    serial: int


class DrivesState:
    """State of all drives; identities and homing states persist when the port is opened again."""

    def __init__(self, setups: Sequence[DriveSetup], deadline: float = DEADLINE_S) -> None:
        """`deadline` is the longest silence of a drive [s]."""
        self.setups, self._deadline = tuple(setups), deadline
        self.reset()
        self.identities: list[Identity | None] = [None for _ in setups]
        self.homed = [False for _ in setups]
        self.home_again: set[int] = set()  #: axes that must be homed even if their drives report to be homed
        self.homing: Homing | None = None  #: progress of the latest homing
        self.now = -math.inf  #: time [s], set by the caller that runs a sequence
        self._homing_start: dict[int, int] = {}  # position at which an unfinished homing started [counts]

    def reset(self) -> None:
        """Start a new session on the bus."""
        self.line = DriveBus(self.setups, self._deadline)

    def fault(self, event: object, connected: bool) -> AxisFault | None:  # noqa: ARG002 - the same in every condition
        """Return the fault that an event of the bus means."""
        match event:
            case UnexpectedMotion(i):
                return AxisFault(i, "does not move as commanded; did another program move it?", True)
            case Restarted(i):
                return AxisFault(i, "has restarted and lost its position; was it switched off and on?", True)
            case Emergency(i, code):
                return AxisFault(i, f"reports: {emergency_text(code)}")
            case InFault(i):
                return AxisFault(i, "is in the state 'fault'")
        return None

    def warning(self, i: int) -> str:
        """Return a warning if the drive sets the warning bit of its statusword; empty without one."""
        return "the drive warns (bit 7 of its statusword)" if self.line.status[i] & 1 << 7 else ""

    def address(self, i: int) -> str:
        """Return the node number of a drive, for the details of messages."""
        return f"node {self.setups[i].node}"

    def details(self, i: int) -> Mapping[str, Any]:
        """Return identity, statusword and counters of a drive."""
        identity = self.identities[i]
        return {
            "node": self.setups[i].node,
            "identity": None if identity is None else identity._asdict(),
            "statusword": f"0x{self.line.status[i]:04X}",
            **vars(self.line.counts[i]),
            "lost_bytes": self.line.reader.dropped,
        }

    def connect(self) -> Script:
        """Identify, set up and enable every drive, then wait for the positions of all homed drives."""
        for i in range(len(self.setups)):
            yield from self._identify(i)
        for i in range(len(self.setups)):
            self.line.manage(i, PRE_OPERATIONAL)
            yield from self._stop_one(i)
            yield from self._set_up(i)
            yield from self._write(i, MODE, HOMING_MODE, 1)
            yield 0.01
            status = yield from self._read(i, STATUSWORD)
            self.homed[i] = bool(status & HOMING_ATTAINED) and i not in self.home_again
            yield from self._enable(i)
            self.line.estimates[i].forget()
            self.line.manage(i, START_NODE)
            self.line.start_cycle(i)
            self.line.driven.add(i)
        yield from self._settle()

    def home(self) -> Script:
        """Home the translations first, then one rotation after the other."""
        give_up = self.now + STOP_TIMEOUT_S
        while self.line.stopping:
            if self.now > give_up:
                raise CanError(f"{self._name(min(self.line.stopping))} has not confirmed its stop")
            yield 0.02
        order = sorted(range(len(self.setups)), key=lambda i: self.setups[i].joint.motion != "translation")
        self.homing = Homing([self._homing_step(i) for i in order])
        for number, i in enumerate(order):
            self.homing.start(number, self.now)
            yield from self._home_one(i)
        yield from self._settle()

    # Parts of connecting

    def _identify(self, i: int) -> Script:
        name, setup = self._name(i), self.setups[i]
        kind = yield from self._request(i, (0x1000, 0))
        if kind.missing:
            raise CanError(
                f"{name} does not answer; is it powered, plugged in, at 1 Mbit/s, and its node {setup.node}?"
            )
        if kind.value & 0xFFFF != 402:
            raise CanError(f"{name} is no drive with the profile CiA 402: its device type is 0x{kind.value:08X}")
        vendor = yield from self._read(i, (0x1018, 1))
        product = yield from self._read(i, (0x1018, 2))
        revision = yield from self._read(i, (0x1018, 3))
        serial = yield from self._read(i, (0x1018, 4))
        found, before = Identity(vendor, product, revision, serial), self.identities[i]
        expected = setup.serial if before is None else before.serial
        if expected is not None and found.serial != expected:
            raise CanError(f"{name} has serial number {found.serial}; {expected} is expected: is it another drive?")
        self.identities[i] = found

    def _stop_one(self, i: int) -> Script:
        """Stop a drive that an earlier session may have left in motion, and acknowledge its fault."""
        yield from self._write(i, CONTROLWORD, QUICK_STOP, 2)
        give_up, last = self.now + STOP_TIMEOUT_S, math.nan
        while last != (position := (yield from self._read(i, POSITION))):
            if self.now > give_up:
                raise CanError(f"{self._name(i)} does not stop")
            last = position
            yield 0.02
        if (yield from self._read(i, STATUSWORD)) & FAULT_BIT:
            yield from self._write(i, CONTROLWORD, 0, 2)
            yield from self._write(i, CONTROLWORD, RESET_FAULT, 2)
            yield 0.02
            if (yield from self._read(i, STATUSWORD)) & FAULT_BIT:
                code = yield from self._read(i, EMERGENCY_CODE)
                raise CanError(f"{self._name(i)} stays in the state 'fault': {emergency_text(code)}")

    def _set_up(self, i: int) -> Script:
        setup, node = self.setups[i], self.setups[i].node
        if setup.make == "epos4":
            yield from self._write(i, (0x60A9, 0), 0xFDB44700)  # velocities in thousandths of a turn per minute
        watchdog = HOST_NODE << 16 | round(1e3 * (self._deadline + WATCHDOG_MARGIN_S))
        for entry, value, size in (
            ((0x607D, 1), setup.minimum, 4),  # software position limits
            ((0x607D, 2), setup.maximum, 4),
            ((0x607F, 0), setup.top, 4),  # maximum profile velocity
            ((0x6083, 0), setup.acceleration, 4),
            ((0x6084, 0), setup.acceleration, 4),
            ((0x6085, 0), setup.acceleration, 4),  # deceleration of a quick stop
            ((0x605A, 0), 6, 2),  # quick stop with that deceleration; the motor keeps its current
            ((0x6007, 0), 3, 2),  # quick stop if the host's heartbeat is missing
            ((0x1016, 1), watchdog, 4),
            ((0x607C, 0), 0, 4),  # home offset
            (TARGET_VELOCITY, 0, 4),
        ):
            yield from self._write(i, entry, value, size)
        # Controlword and velocity arrive in one frame; statusword and position answer to each SYNC in another one.
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
        give_up = self.now + 1.0
        while (status := (yield from self._read(i, STATUSWORD))) & STATE_MASK != ENABLED:
            if self.now > give_up:
                raise CanError(f"{self._name(i)} cannot be enabled: its statusword is 0x{status:04X}")
            yield 0.02

    # Parts of homing

    def _home_one(self, i: int) -> Script:
        setup, name, estimate = self.setups[i], self._name(i), self.line.estimates[i]
        self.homed[i] = False
        self.line.driven.discard(i)
        estimate.forget(adrift=True)
        start = self._homing_start.setdefault(i, signed((yield from self._read(i, POSITION))))
        reach = max((setup.maximum - setup.minimum) * setup.joint.microstep, 2.0 * math.pi) / setup.home_speed
        last = yield from self._home_by(i, setup.homing_method, self.now + 2.0 * reach + 10.0)
        if setup.joint.motion == "rotation" and start - last > 0.5 * setup.turn:
            yield from self._turn_back(i)
        del self._homing_start[i]
        yield from self._enable(i)
        self.line.driven.add(i)
        estimate.forget()
        self.homed[i] = True
        self.home_again.discard(i)
        if (yield from self._read(i, STATUSWORD)) & FAULT_BIT:
            raise CanError(f"{name} is in the state 'fault'")

    def _home_by(self, i: int, method: int, give_up: float) -> Value:
        """Home by a method, and return the last position before the end of the motion [counts]."""
        speed, setup = self.setups[i].units(self.setups[i].home_speed), self.setups[i]
        yield from self._write(i, (0x6098, 0), method, 1)
        yield from self._write(i, (0x6099, 1), speed)  # while searching the switch
        yield from self._write(i, (0x6099, 2), speed)  # while searching the zero
        yield from self._write(i, (0x609A, 0), setup.acceleration)
        yield from self._write(i, MODE, HOMING_MODE, 1)
        return (yield from self._motion(i, HOMING_ATTAINED | TARGET_REACHED, give_up))

    def _turn_back(self, i: int) -> Script:
        """Turn a rotation that homed one turn too low up by one turn to its zero, at the homing speed.

        A rotation passes its home sensor once per turn while it moves down. If it started within half a turn of its
        zero and moved more than half a turn to the sensor, it started below zero.
        """
        setup = self.setups[i]
        yield from self._write(i, (0x607D, 2), max(setup.turn, setup.maximum))
        yield from self._write(i, MODE, PROFILE_POSITION, 1)
        yield from self._write(i, (0x6081, 0), setup.units(setup.home_speed))  # profile velocity
        yield from self._write(i, TARGET_POSITION, setup.turn)
        yield from self._motion(i, TARGET_REACHED, self.now + 4.0 * math.pi / setup.home_speed + 10.0)
        yield from self._home_by(i, SET_HOME_HERE, self.now + 10.0)
        yield from self._write(i, (0x607D, 2), setup.maximum)

    def _motion(self, i: int, ended: int, give_up: float) -> Value:
        """Start a motion, wait until all bits of `ended` are set, and return the last position before [counts]."""
        started, last = self.now, 0
        yield from self._write(i, CONTROLWORD, ENABLE, 2)
        yield from self._write(i, CONTROLWORD, START_MOTION, 2)
        while True:
            yield 0.05
            status = yield from self._read(i, STATUSWORD)
            if status & FAULT_BIT:
                code = yield from self._read(i, EMERGENCY_CODE)
                raise CanError(f"{self._name(i)}: {emergency_text(code)}")
            if ended & HOMING_ATTAINED and status & HOMING_ERROR:
                raise CanError(f"{self._name(i)} has not found its home sensor; is it free to move?")
            if status & ended == ended:
                return last
            last = signed((yield from self._read(i, POSITION)))
            if self.now > give_up:
                raise CanError(f"{self._name(i)} has been moving for more than {give_up - started:.0f} s")

    def _homing_step(self, i: int) -> HomingStep:
        setup, turn = self.setups[i], 2.0 * math.pi
        turns, step = setup.joint.motion == "rotation", setup.joint.microstep
        estimate = self.line.estimates[i]
        exact = self.homed[i] and estimate.known
        travel = turn if turns else (setup.maximum - setup.minimum) * step
        above = (estimate.position + setup.minimum) * step if exact else travel
        way = above if above >= 0.0 or not turns else 2.0 * turn + above
        return HomingStep(setup.joint.name, "rad" if turns else "m", abs(way), exact, setup.home_speed)

    def _settle(self) -> Script:
        """Wait for confirmed positions of all homed drives; a position out of range makes its drive not homed."""
        give_up, estimates = self.now + 2.0, self.line.estimates
        while moving := [i for i, homed in enumerate(self.homed) if homed and not estimates[i].known]:
            if self.now > give_up:
                raise CanError(f"{self._name(moving[0])} does not stop: its position changes")
            yield 0.02
        for i, setup in enumerate(self.setups):
            if self.homed[i] and not 0 <= estimates[i].position <= setup.maximum - setup.minimum:
                self.homed[i] = False  # another program has homed the drive and set another position

    # Requests

    def _name(self, i: int) -> str:
        return f"the stage {self.setups[i].joint.name}"

    def _read(self, i: int, entry: tuple[int, int]) -> Value:
        answer = yield from self._request(i, entry)
        self._check(i, entry, answer)
        return answer.value

    def _write(self, i: int, entry: tuple[int, int], value: int, size: int = 4) -> Script:
        self._check(i, entry, (yield from self._request(i, entry, value, size)))

    def _check(self, i: int, entry: tuple[int, int], answer: Answer) -> None:
        if answer.missing:
            raise CanError(f"{self._name(i)} does not answer to a request of {text(entry)}")
        if not answer.accepted:
            raise CanError(f"{self._name(i)} rejects {text(entry)}: {abort_text(answer.value)}")

    def _request(
        self, i: int, entry: tuple[int, int], value: int | None = None, size: int = 4
    ) -> Generator[Request | float, Answer | None, Answer]:
        """Return the answer to a request, which is sent again if its answer is lost."""
        for _ in range(MAX_ATTEMPTS):
            answer = yield Request(i, entry, value, size)
            if answer is not None and not answer.missing:
                return answer
        return Answer(missing=True)
