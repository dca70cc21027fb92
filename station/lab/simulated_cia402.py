"""Simulated CANopen drives with the profile CiA 402 on a bus at 1 Mbit/s, reached through a serial CAN adapter (slcan).

Each drive has an encoder, so it detects a stall. The bus carries one frame at a time, with its duration. Sources: CiA
301, CiA 402, and the Lawicel protocol of CAN232 adapters.
"""

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from station.devices.cia402.protocol import (
    BOOT_UP,
    EMERGENCY,
    HEARTBEAT,
    HOMING_ATTAINED,
    HOMING_MODE,
    MAX_LINE_BYTES,
    NMT,
    PRE_OPERATIONAL,
    PROFILE_POSITION,
    PROFILE_VELOCITY,
    SDO_REPLY,
    SDO_REQUEST,
    START_NODE,
    STOP_NODE,
    SYNC,
    TARGET_REACHED,
    Frame,
    decode,
    encode,
    signed,
)
from station.devices.zaber.setup import StageSetup
from station.lab.motor import Motor
from station.lab.simulated_line import SimulatedLine
from station.lab.wires import BUFFER_BYTES

FIRST_SERIAL_NUMBER = 3000  #: a simulated drive has this serial number plus its node number
VENDOR_ID = 0x0BAD_CAFE  #: number that no real vendor has
RESTART_TIME_S = 0.5  #: time after switching on until a drive sends its boot-up message [s]
PROCESSING_S = 0.0002  #: time from a frame to the start of the drive's answer; assumed [s]
#: Statuswords of the states of the state machine.
DISABLED, READY, ON, ENABLED, STOPPED, FAULT = 0x250, 0x231, 0x233, 0x237, 0x217, 0x218
SPEED_ZERO = 1 << 12  #: bit of the statusword in the mode "profile velocity"
#: Default value and size of each object that a host may write.
WRITABLE: dict[tuple[int, int], tuple[int, int]] = {
    (0x1016, 1): (0, 4), (0x1017, 0): (0, 2), (0x6007, 0): (1, 2), (0x6040, 0): (0, 2), (0x605A, 0): (2, 2),
    (0x6060, 0): (0, 1), (0x607A, 0): (0, 4), (0x607C, 0): (0, 4), (0x607D, 1): (-(2**31), 4),
    (0x607D, 2): (2**31 - 1, 4), (0x607F, 0): (2**31 - 1, 4), (0x6081, 0): (100_000, 4), (0x6083, 0): (1_000_000, 4),
    (0x6084, 0): (1_000_000, 4), (0x6085, 0): (1_000_000, 4), (0x6098, 0): (17, 1), (0x6099, 1): (50_000, 4),
    (0x6099, 2): (50_000, 4), (0x609A, 0): (1_000_000, 4), (0x60FF, 0): (0, 4),
    (0x607E, 0): (0, 1), (0x6086, 0): (0, 2),
    **{(index, 1): (0, 4) for index in (0x1400, 0x1800)},
    **{(index, 2): (255, 1) for index in (0x1400, 0x1800)},
    **{(index, number): (0, 4 if number else 1) for index in (0x1600, 0x1A00) for number in range(9)},
}  # fmt: skip
#: SDO abort codes.
NO_OBJECT, READ_ONLY, WRONG_SIZE, OUT_OF_RANGE = 0x06020000, 0x06010002, 0x06070010, 0x06090030


class DriveVariant(NamedTuple):
    """Differences of a drive from the usual one."""

    velocity_unit: float = 1.0  #: unit of velocities in the objects [counts/s]
    acceleration_unit: float = 1.0  #: unit of accelerations in the objects [counts/s^2]
    units: Mapping[tuple[int, int], int] = {}  #: constant values of the objects that define the units
    kept: Mapping[tuple[int, int], int] = {}  #: values of objects that accept any value but keep this one
    missing: frozenset[tuple[int, int]] = frozenset()  #: objects that the drive does not have
    methods: frozenset[int] = frozenset()  #: homing methods; empty: all


USUAL = DriveVariant()
DRIVE_VARIANTS = {"usual": USUAL, "no_home_offset": DriveVariant(missing=frozenset(((0x607C, 0),)))}


def epos4(counts_per_turn: float) -> DriveVariant:
    """Return the variant of an EPOS4: velocities in 0.001 rpm, no home offset (source: EDS of its compact types)."""
    return DriveVariant(
        counts_per_turn / 60_000.0, counts_per_turn / 60.0,
        {(0x60A8, 0): 0x00B50000, (0x60A9, 0): 0xFDB44700, (0x60AA, 0): 0x00C00300},
        missing=frozenset(((0x607C, 0),)), methods=frozenset((-4, -3, -2, -1, 1, 2, 7, 11, 17, 18, 23, 27, 33, 34, 37)),
    )  # fmt: skip


class SimulatedDrive:
    """One drive with its motor; the usual unit of velocities is counts per second."""

    def __init__(self, setup: StageSetup, true_position: float, homed: bool, variant: DriveVariant = USUAL) -> None:
        """Create the drive of a stage at `true_position` from the home sensor's zero [counts].

        Unless `homed`, the drive has just been switched on.
        """
        linear = setup.joint.motion == "translation"
        self.node, self.silent_until, self.variant = setup.device, -math.inf, variant
        self.serial = FIRST_SERIAL_NUMBER + setup.device
        travel, turn = setup.maximum if linear else None, round(2.0 * math.pi / setup.joint.microstep)
        self.motor = Motor(true_position, true_position if homed else 0.0, travel, turn)
        self.homed = homed
        self._reset()

    def _reset(self) -> None:
        self.values = {entry: value for entry, (value, _) in WRITABLE.items()}
        self.state, self.operational, self.error = DISABLED, False, 0
        self._homing = self._positioning = False
        self._heartbeat = math.inf  # time of the host's last heartbeat [s]

    @property
    def true_position(self) -> float:
        """True position of the stage from the home sensor's zero [counts]."""
        return self.motor.true_position

    def switch_off_and_on(self) -> None:
        """Simulate a power cycle: the axis is at rest without a reference position."""
        self.motor.switch_off_and_on()
        self.homed, self.silent_until = False, self.motor.time + RESTART_TIME_S
        self._reset()

    def advance(self, until: float) -> list[tuple[float, Frame]]:
        """Run the drive until the time `until` [s], and return the frames that it sends by itself, with their times."""
        return [(until, frame) for frame in self._advance(until)]

    def _advance(self, until: float) -> list[Frame]:
        moving = self.motor.moving
        self.motor.advance(until)
        if until < self.silent_until:
            return []
        if self.silent_until > 0.0:
            self.silent_until = -math.inf
            return [Frame(HEARTBEAT + self.node, bytes([BOOT_UP]))]
        if moving and self.motor.stalled:
            return self.fail(0x8611)
        if not self.motor.moving:
            self._positioning = False
            if self._homing:
                self._homing, self.homed = False, True
                self.motor.set_count(float(self.values[0x607C, 0]))
        watchdog = self.values[0x1016, 1]
        if watchdog and until - self._heartbeat > 1e-3 * (watchdog & 0xFFFF):
            self._heartbeat, self.operational = math.inf, False
            self._stop_quickly()
            return [self._emergency(0x8130)]
        return []

    @property
    def statusword(self) -> int:
        """Statusword of the present state and mode."""
        word, mode, moving = self.state, self.values[0x6060, 0], self.motor.moving
        if mode == HOMING_MODE:
            return word | (0 if self._homing else TARGET_REACHED) | (HOMING_ATTAINED if self.homed else 0)
        if mode == PROFILE_POSITION:
            return word | (0 if self._positioning else TARGET_REACHED)
        return word | (0 if moving else SPEED_ZERO)

    def receive(self, command: Frame, now: float, slot: int) -> list[Frame]:  # noqa: ARG002
        """Process a frame at `now` [s], and return the answers."""
        frame, data = command, command.data
        if now < self.silent_until:
            return []
        if frame.identifier == NMT and len(data) == 2 and data[1] in (0, self.node):
            if data[0] in (START_NODE, STOP_NODE, PRE_OPERATIONAL):
                self.operational = data[0] == START_NODE
        elif frame.identifier == SDO_REQUEST + self.node and len(data) == 8:
            return [Frame(SDO_REPLY + self.node, self._serve(data))]
        elif frame.identifier == HEARTBEAT + (self.values[0x1016, 1] >> 16 & 0x7F):
            self._heartbeat = now
        elif self.operational and frame.identifier == SYNC:
            return self._answer_sync()
        elif self.operational and frame.identifier == self.values[0x1400, 1]:
            self._take(data)
        return []

    # Object dictionary

    def _serve(self, data: bytes) -> bytes:
        """Return the answer to an expedited SDO."""
        command, entry = data[0], (int.from_bytes(data[1:3], "little"), data[3])
        value = size = 0
        if command == 0x40:
            found = self._read(entry)
            abort = NO_OBJECT if found is None else 0
            value, size = found or (0, 0)
            answer = 0x43 | (4 - size) << 2
        elif command & 0xF3 == 0x23:
            size, answer = 4 - (command >> 2 & 3), 0x60
            abort = self._write(entry, int.from_bytes(data[4 : 4 + size], "little"), size)
        else:
            return b"\x80" + data[1:4] + (0x05040001).to_bytes(4, "little")  # abort: no segmented transfer
        if abort:
            return b"\x80" + data[1:4] + abort.to_bytes(4, "little")
        return (
            bytes([answer]) + data[1:4] + (value & (1 << 8 * size) - 1 if answer != 0x60 else 0).to_bytes(4, "little")
        )

    def _read(self, entry: tuple[int, int]) -> tuple[int, int] | None:
        """Return value and size of an object; None if it does not exist."""
        fixed = {
            (0x1000, 0): (0x0002_0192, 4),  # servo drive with the profile 402
            (0x1001, 0): (1 if self.error else 0, 1),
            (0x1018, 0): (4, 1),
            (0x1018, 1): (VENDOR_ID, 4),
            (0x1018, 2): (402, 4),
            (0x1018, 3): (1, 4),
            (0x1018, 4): (self.serial, 4),
            (0x603F, 0): (self.error, 2),
            (0x6041, 0): (self.statusword, 2),
            (0x6061, 0): (self.values[0x6060, 0], 1),
            (0x6064, 0): (round(self.motor.position), 4),
            (0x606C, 0): (round(self.motor.velocity), 4),
        }
        if entry in self.variant.missing:
            return None
        if entry in self.variant.units:
            return self.variant.units[entry], 4
        if entry in fixed:
            return fixed[entry]
        return (self.values[entry], WRITABLE[entry][1]) if entry in WRITABLE else None

    def _write(self, entry: tuple[int, int], value: int, size: int) -> int:
        """Write an object, and return an abort code; 0 if it was written."""
        if entry in self.variant.units:
            return 0 if value == self.variant.units[entry] else READ_ONLY
        if entry == (0x6098, 0) and self.variant.methods and signed(value, size) not in self.variant.methods:
            return OUT_OF_RANGE
        if entry not in WRITABLE or entry in self.variant.missing:
            return NO_OBJECT if self._read(entry) is None else READ_ONLY
        if size != WRITABLE[entry][1]:
            return WRONG_SIZE
        if entry[0] in (0x6060, 0x6098, 0x607A, 0x607C, 0x607D, 0x60FF):
            value = signed(value, size)
        if entry == (0x6060, 0) and value not in (PROFILE_POSITION, PROFILE_VELOCITY, HOMING_MODE):
            return OUT_OF_RANGE
        before = self.values[entry]
        self.values[entry] = self.variant.kept.get(entry, value)
        if entry == (0x6040, 0):
            self._control(value, before)
        elif entry == (0x60FF, 0):
            self._run()
        elif entry == (0x6060, 0) and value != before:
            self._homing = self._positioning = False
            self.motor.stop()
        return 0

    def _take(self, data: bytes) -> None:
        """Write the objects of a received PDO."""
        for number in range(1, self.values[0x1600, 0] + 1):
            mapping = self.values[0x1600, number]
            size, entry = (mapping & 0xFF) // 8, (mapping >> 16, mapping >> 8 & 0xFF)
            if entry in WRITABLE and len(data) >= size:
                self._write(entry, int.from_bytes(data[:size], "little"), size)
            data = data[size:]

    def _answer_sync(self) -> list[Frame]:
        identifier = self.values[0x1800, 1]
        if identifier >> 31 or self.values[0x1800, 2] != 1:
            return []
        data = b""
        for number in range(1, self.values[0x1A00, 0] + 1):
            mapping = self.values[0x1A00, number]
            value, size = self._read((mapping >> 16, mapping >> 8 & 0xFF)) or (0, (mapping & 0xFF) // 8)
            data += (value & (1 << 8 * size) - 1).to_bytes(size, "little")
        return [Frame(identifier & 0x7FF, data)]

    # State machine

    def _control(self, word: int, before: int) -> None:
        """Change the state by a controlword, as CiA 402 defines the transitions."""
        if self.state == FAULT:
            if word & 0x80 and not before & 0x80:
                self.state, self.error = DISABLED, 0
        elif not word & 0x02:  # disable voltage
            self.state = DISABLED
            self.motor.stop()
        elif not word & 0x04:  # quick stop
            if self.state == ENABLED:
                self._stop_quickly()
            elif self.state != STOPPED:
                self.state = DISABLED
        elif word & 0x0F == 0x06:
            self.state = READY
            self.motor.stop()
        elif word & 0x0F == 0x07:
            if self.state == ENABLED:
                self.motor.stop()
            self.state = ON if self.state != DISABLED else DISABLED
        elif word & 0x0F == 0x0F and self.state != DISABLED:
            if self.state != ENABLED:
                self.state = ENABLED
                self._run()
            if word & 0x10 and not before & 0x10:
                self._start()

    def _run(self) -> None:
        """Run at the target velocity, if the mode is "profile velocity"."""
        if self.state != ENABLED or self.values[0x6060, 0] != PROFILE_VELOCITY:
            return
        top = self.values[0x607F, 0]
        velocity = min(max(self.values[0x60FF, 0], -top), top) * self.variant.velocity_unit
        self.motor.acceleration = self._acceleration(0x6083)
        lower, upper = (self.values[0x607D, 1], self.values[0x607D, 2]) if self.homed else (-math.inf, math.inf)
        if velocity or self.motor.moving:
            self.motor.run(velocity, lower, upper)

    def _start(self) -> None:
        """Start a homing or a motion to a position."""
        motor, mode = self.motor, self.values[0x6060, 0]
        if mode == HOMING_MODE:
            self._homing, self.homed = True, False
            motor.acceleration = self._acceleration(0x609A)
            if self.values[0x6098, 0] in (35, 37):
                motor.halt()
            else:
                motor.move(
                    motor.position - (motor.true_position - motor.zero_behind()),
                    self.values[0x6099, 1] * self.variant.velocity_unit,
                )
        elif mode == PROFILE_POSITION:
            self._positioning = True
            motor.acceleration = self._acceleration(0x6083)
            motor.move(float(self.values[0x607A, 0]), self.values[0x6081, 0] * self.variant.velocity_unit)

    def _acceleration(self, index: int) -> float:
        """Return the acceleration in an object of the object dictionary [counts/s^2]."""
        return max(1.0, self.values[index, 0] * self.variant.acceleration_unit)

    def _stop_quickly(self) -> None:
        self._homing = self._positioning = False
        self.motor.acceleration = self._acceleration(0x6085)
        self.motor.stop()
        if self.state == ENABLED:
            self.state = STOPPED

    def fail(self, code: int) -> list[Frame]:
        """Enter the state "fault" with an error, and return the frame that reports it."""
        self.motor.halt()
        self._homing = self._positioning = False
        self.state = FAULT
        return [self._emergency(code)]

    def _emergency(self, code: int) -> Frame:
        self.error = code
        return Frame(EMERGENCY + self.node, code.to_bytes(2, "little") + b"\x01" + bytes(5))


class CanQueue:
    """The line from the adapter to the host. It adds no delay, because the bus has delayed the frames."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[float, bytes]] = deque()  # lines with their times

    def put(self, data: bytes, now: float) -> None:
        """Send a line at `now` [s]; a line beyond the buffer's size is lost."""
        if sum(len(line) for _, line in self._waiting) < BUFFER_BYTES:
            self._waiting.append((now, data))

    def take(self, until: float) -> bytes:
        """Return the lines that have arrived until the time `until` [s]."""
        data = b""
        while self._waiting and self._waiting[0][0] <= until + 1e-9:
            data += self._waiting.popleft()[1]
        return data


class CanWire:
    """The bus, which carries one frame of the host or of a drive at a time, and the adapter of the host."""

    processing = PROCESSING_S

    def __init__(self) -> None:
        self.out = CanQueue()
        self._part, self._open, self._free = b"", False, -math.inf

    def read(self, data: bytes, now: float) -> Iterator[tuple[float, Frame | bytes]]:
        """Yield the frames that bytes of the host complete and the adapter's answers, each with its time [s]."""
        *lines, rest = (self._part + data[:BUFFER_BYTES]).split(b"\r")
        self._part = rest[-MAX_LINE_BYTES:]
        for line in lines:
            frame = decode(line)
            if frame is not None and self._open:
                self._free = max(self._free, now) + frame.duration
                yield self._free, b"z\r"
                yield self._free, frame
            else:
                yield now, self._configure(line)

    def encode(self, axis: SimulatedDrive, answer: Frame, at: float) -> tuple[float, bytes]:  # noqa: ARG002
        """Return the time at which a drive's frame ends on the bus, and the line that the adapter sends for it."""
        self._free = max(self._free, at) + answer.duration
        return self._free, encode(answer)

    def _configure(self, line: bytes) -> bytes:
        """Execute a command to the adapter, and return its answer."""
        match line[:1]:
            case b"O" | b"L":
                self._open = True
            case b"C":
                self._open = False
            case b"V":
                return b"V1013\r"
            case b"N":
                return b"N0001\r"
            case b"F":
                return b"F00\r"
            case b"S" | b"s" | b"Z" | b"M" | b"m" | b"":
                return b"\r"
            case _:
                return b"\a"
        return b"\r"


def simulated_can_bus(units: Sequence[SimulatedDrive], seed: int = 0) -> SimulatedLine[SimulatedDrive]:
    """Return drives on one bus, and the adapter that connects the host to the bus."""
    return SimulatedLine(CanWire(), units, seed)
