"""Simulated CANopen drives with the profile CiA 402 on a bus at 1 Mbit/s, reached through a serial CAN adapter (slcan).

Each drive has an encoder, so it detects a stall. The bus carries one frame at a time, with its duration. Sources: CiA
301, CiA 402, and the Lawicel protocol of CAN232 adapters.
"""

import math
from collections import deque
from collections.abc import Sequence

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
from station.lab.simulated_zaber import Faults, LineNoise
from station.lab.wires import BUFFER_BYTES

FIRST_SERIAL_NUMBER = 3000  #: a simulated drive has this serial number plus its node number
VENDOR_ID = 0x0BAD_CAFE  #: no vendor's number
RESTART_TIME_S = 0.5  #: time after switching on until a drive sends its boot-up message [s]
PROCESSING_S = 0.0002  #: time from a frame to the start of the drive's answer; assumed [s]
STOPS = 2000.0  #: distance of the hard stops from both ends of the travel [counts]
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
    **{(index, 1): (0, 4) for index in (0x1400, 0x1800)},
    **{(index, 2): (255, 1) for index in (0x1400, 0x1800)},
    **{(index, number): (0, 4 if number else 1) for index in (0x1600, 0x1A00) for number in range(9)},
}  # fmt: skip
#: SDO abort codes.
NO_OBJECT, READ_ONLY, WRONG_SIZE, OUT_OF_RANGE = 0x06020000, 0x06010002, 0x06070010, 0x06090030


class SimulatedDrive:
    """One drive with its motor; the unit of velocities is counts per second."""

    def __init__(self, setup: StageSetup, true_position: float, homed: bool) -> None:
        """Create the drive of a stage at `true_position` from the home sensor's zero [counts].

        Unless `homed`, the drive has just been switched on.
        """
        linear = setup.joint.motion == "translation"
        self.node, self.silent_until = setup.device, -math.inf
        self.serial = FIRST_SERIAL_NUMBER + setup.device
        self._turn = None if linear else round(2.0 * math.pi / setup.joint.microstep)
        lower, upper = (-STOPS, setup.maximum + STOPS) if linear else (-math.inf, math.inf)
        self.motor = Motor(true_position, true_position if homed else 0.0, lower, upper)
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
        self.motor.halt()
        self.motor.set_count(0.0)
        self.homed, self.silent_until = False, self.motor.time + RESTART_TIME_S
        self._reset()

    def advance(self, until: float) -> list[Frame]:
        """Run the drive until the time `until` [s], and return the frames that it sends by itself."""
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

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Process a frame at `now` [s], and return the answers."""
        data = frame.data
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
            return b"\x80" + data[1:4] + (0x05040001).to_bytes(4, "little")  # only expedited transfers
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
        if entry in fixed:
            return fixed[entry]
        return (self.values[entry], WRITABLE[entry][1]) if entry in WRITABLE else None

    def _write(self, entry: tuple[int, int], value: int, size: int) -> int:
        """Write an object, and return an abort code; 0 if it was written."""
        if entry not in WRITABLE:
            return NO_OBJECT if self._read(entry) is None else READ_ONLY
        if size != WRITABLE[entry][1]:
            return WRONG_SIZE
        if entry[0] in (0x6060, 0x6098, 0x607A, 0x607C, 0x607D, 0x60FF):
            value = signed(value, size)
        if entry == (0x6060, 0) and value not in (PROFILE_POSITION, PROFILE_VELOCITY, HOMING_MODE):
            return OUT_OF_RANGE
        before = self.values[entry]
        self.values[entry] = value
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
        velocity = min(max(self.values[0x60FF, 0], -top), top)
        self.motor.acceleration = max(1.0, float(self.values[0x6083, 0]))
        lower, upper = (self.values[0x607D, 1], self.values[0x607D, 2]) if self.homed else (-math.inf, math.inf)
        if velocity or self.motor.moving:
            self.motor.run(velocity, lower, upper)

    def _start(self) -> None:
        """Start a homing or a motion to a position."""
        motor, mode = self.motor, self.values[0x6060, 0]
        if mode == HOMING_MODE:
            self._homing, self.homed = True, False
            motor.acceleration = max(1.0, float(self.values[0x609A, 0]))
            if self.values[0x6098, 0] in (35, 37):
                motor.halt()
            else:
                motor.move(motor.position - (motor.true_position - self._zero), float(self.values[0x6099, 1]))
        elif mode == PROFILE_POSITION:
            self._positioning = True
            motor.acceleration = max(1.0, float(self.values[0x6083, 0]))
            motor.move(float(self.values[0x607A, 0]), float(self.values[0x6081, 0]))

    def _stop_quickly(self) -> None:
        self._homing = self._positioning = False
        self.motor.acceleration = max(1.0, float(self.values[0x6085, 0]))
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

    @property
    def _zero(self) -> float:
        """True position of the zero whose home sensor a backward motion reaches first [counts]."""
        return 0.0 if self._turn is None else math.floor(self.motor.true_position / self._turn) * self._turn


class SimulatedCanBus:
    """Drives on one bus, and the adapter by which the host reaches them."""

    def __init__(self, units: Sequence[SimulatedDrive], seed: int = 0) -> None:
        self.units = tuple(units)
        self._faults = Faults()
        self.noise = LineNoise(seed)
        self._part, self._open, self._free = b"", False, -math.inf
        self._incoming: deque[tuple[float, Frame]] = deque()  # frames of the host with their ends
        self._out: deque[tuple[float, bytes]] = deque()  # lines to the host with their times

    @property
    def faults(self) -> Faults:
        """Active faults of the bus."""
        return self._faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        self._faults = faults
        for slot, unit in enumerate(self.units, 1):
            unit.motor.stall(slot in faults.stalled)

    def power_cycle(self, slot: int) -> None:
        """Switch one drive off and on."""
        self.units[slot - 1].switch_off_and_on()

    def fail(self, slot: int, code: int) -> None:
        """Let a drive stop with an error, which it reports."""
        for frame in self.units[slot - 1].fail(code):
            self._put(slot, frame, self.units[slot - 1].motor.time)

    def receive(self, data: bytes, now: float) -> None:
        """Receive the bytes that the host has written until `now` [s]."""
        if self._faults.cut == 1:
            return
        *lines, rest = (self._part + self.noise.damage(data[:BUFFER_BYTES], self._faults)).split(b"\r")
        for line in lines:
            frame = decode(line)
            if frame is not None and self._open:
                self._free = max(self._free, now) + frame.duration
                self._incoming.append((self._free, frame))
                self._send(b"z\r", self._free)
            else:
                self._send(self._configure(line), now)
        self._part = rest[-MAX_LINE_BYTES:]

    def _configure(self, line: bytes) -> bytes:
        """Execute a command of the adapter, and return its answer."""
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

    def advance(self, now: float) -> bytes:
        """Advance the simulation, and return the bytes that reach the host until `now` [s]."""
        while self._incoming and self._incoming[0][0] <= now + 1e-9:
            time, frame = self._incoming.popleft()
            self._run(time)
            for slot, unit in enumerate(self.units, 1):
                if self._faults.cut is not None and slot >= self._faults.cut:
                    break
                for answer in unit.receive(frame, time):
                    self._put(slot, answer, time + PROCESSING_S)
        self._run(now)
        data = b""
        while self._out and self._out[0][0] <= now + 1e-9:
            data += self._out.popleft()[1]
        return data if self._faults.cut != 1 else b""

    def _run(self, until: float) -> None:
        for slot, unit in enumerate(self.units, 1):
            for frame in unit.advance(until):
                self._put(slot, frame, until)

    def _put(self, slot: int, frame: Frame, now: float) -> None:
        """Send a frame of a drive, as soon as the bus is free."""
        faults = self._faults
        self._free = max(self._free, now) + frame.duration
        if slot not in faults.mute and (faults.cut is None or slot < faults.cut):
            self._send(encode(frame), self._free)

    def _send(self, line: bytes, at: float) -> None:
        if sum(len(line) for _, line in self._out) < BUFFER_BYTES:
            self._out.append((at + self._faults.delay, self.noise.damage(line, self._faults)))
