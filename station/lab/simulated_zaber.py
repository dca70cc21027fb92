"""Simulated Zaber T-series units at wire level: their line, addressing, motion, homing, settings and errors.

The line between the units and the host carries 9600 baud in both directions.
Sources: the manufacturer's Binary Protocol Manual and the T-Series pages of its wiki. Times that these sources do not
specify are parameters.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from station.devices.zaber.protocol import (
    ACCELERATION_UNIT,
    BYTE_TIME_S,
    MAX_POSITION,
    MESSAGE_BYTES,
    MICROSTEP_RESOLUTION,
    RESYNC_GAP_S,
    SPEED_UNIT,
    Code,
    Mode,
    ZaberCommand,
    ZaberMessage,
    ZaberStatus,
    decode,
    encode,
    split_id,
    top_speed,
    with_id,
)
from station.devices.zaber.setup import StageSetup
from station.lab.motor import Motor
from station.lab.simulated_line import PacedLine, SimulatedLine, free_buffer

#: Device IDs of the simulated rotation and translation stages; those of the real stages are unknown.
ROTARY_ID, LINEAR_ID = 4421, 4332
FIRST_SERIAL_NUMBER = 1000  #: a simulated stage has this serial number plus its device number
RENUMBER_TIME_S = 0.5  #: time after Renumber in which the units ignore commands [s]
RESTART_TIME_S = 0.5  #: time after Reset in which a unit ignores commands [s]
HOME_SENSOR = 200.0  #: distance of the home sensor below the unit's zero [microsteps]
_MOVES = frozenset({ZaberCommand.MOVE_ABSOLUTE, ZaberCommand.MOVE_RELATIVE, ZaberCommand.MOVE_SPEED, ZaberCommand.STOP})
_ANSWERED_ALWAYS = frozenset({ZaberCommand.RENUMBER, *range(50, 64)})
_READINGS = frozenset(
    {ZaberCommand.DEVICE_ID, ZaberCommand.FIRMWARE, ZaberCommand.STATUS, ZaberCommand.ECHO, ZaberCommand.POSITION}
)
# Command numbers as plain integers, because every message needs them and enumeration members are slow.
_SPEED, _LIMIT, _HOMING = int(ZaberCommand.MOVE_SPEED), int(ZaberCommand.LIMIT_ACTIVE), int(ZaberStatus.HOMING)
_MODE, _MAXIMUM = int(ZaberCommand.SET_MODE), int(ZaberCommand.SET_MAXIMUM)
_ACCELERATION, _RESOLUTION = int(ZaberCommand.SET_ACCELERATION), int(ZaberCommand.SET_RESOLUTION)
_ALIAS, _QUIET, _IDS = int(ZaberCommand.SET_ALIAS), int(Mode.NO_AUTO_REPLY), int(Mode.MESSAGE_IDS)
#: Bits of the device mode that a unit accepts: documented ones and undocumented ones known from other sources.
_MODE_BITS = sum(1 << bit for bit in (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 14, 15))


@dataclass(frozen=True)
class UnitKind:
    """Model of a unit. The device IDs of the real units are unknown."""

    device_id: int
    travel: int | None  #: length of the travel [microsteps]; None: unlimited rotation
    turn: int = 0  #: one turn of a unit with unlimited rotation [microsteps]
    firmware: int = 523
    serial: int | None = None  #: serial number; None for old units, which have none


class Unit:
    """One simulated stage with its controller. Every position but `true_position` is the controller's count."""

    def __init__(self, kind: UnitKind, number: int, true_position: float = 0.0, count: float | None = None) -> None:
        """Create the unit with the stage at `true_position` from the home sensor's zero [microsteps].

        `count` is the position that the unit counts [microsteps]; None: the unit has just been switched on and is not
        homed.
        """
        self.kind, self.number = kind, number
        self.settings: dict[int, int] = {
            ZaberCommand.SET_RESOLUTION: MICROSTEP_RESOLUTION,
            ZaberCommand.SET_MODE: 1 << 11 | (0 if count is None else Mode.HOMED),
            ZaberCommand.SET_HOME_SPEED: 2922,
            ZaberCommand.SET_SPEED: 2922,
            ZaberCommand.SET_ACCELERATION: 111,
            ZaberCommand.SET_MAXIMUM: kind.travel or kind.turn,
            ZaberCommand.SET_HOME_OFFSET: 0,
            ZaberCommand.SET_ALIAS: 0,
            ZaberCommand.SET_LOCK: 0,
        }
        self.status = int(ZaberStatus.IDLE)
        self.deaf_until = -math.inf
        self.motor = Motor(true_position, 0.0 if count is None else count, kind.travel, kind.turn)
        self._goal, self._answer = 0.0, 0  # end of the present motion, and the number of the reply at its end
        self._identity = self._move_identity = 0  # message IDs of the last command and of the last motion command

    @property
    def true_position(self) -> float:
        """True position of the stage from the home sensor's zero [microsteps]."""
        return self.motor.true_position

    @property
    def position(self) -> float:
        """Position that the unit counts [microsteps]."""
        return self.motor.position

    def switch_off_and_on(self) -> None:
        """Simulate a power cycle: the unit is at rest and not homed, and its count restarts at 0."""
        self.motor.switch_off_and_on()
        self.status = int(ZaberStatus.IDLE)
        self.settings[_MODE] &= ~Mode.HOMED
        self.deaf_until = self.motor.time + RESTART_TIME_S

    def advance(self, until: float) -> list[tuple[float, ZaberMessage]]:
        """Run the motor until the time `until` [s], and return the unit's messages with their times."""
        motor, messages = self.motor, list[tuple[float, ZaberMessage]]()
        while motor.due <= until:
            motor.advance(motor.due)
            if not motor.moving:
                messages += self._arrive()
        motor.advance(until)
        return messages

    def receive(self, command: ZaberMessage, now: float, slot: int) -> list[ZaberMessage]:
        """Execute a command to this unit that arrives at `now` [s], and return the immediate replies."""
        if command.device not in (0, self.number, self.settings[_ALIAS]) or now < self.deaf_until:
            return []
        if command.device == 0 and command.command == ZaberCommand.RENUMBER:
            command = command._replace(data=slot)
        return self.execute(command)

    def execute(self, message: ZaberMessage) -> list[ZaberMessage]:
        """Execute a command that arrives now, and return the immediate replies."""
        _, command, data = message
        mode = self.settings[_MODE]
        identified = mode & _IDS
        data, self._identity = split_id(data) if identified else (data, 0)
        if command == ZaberCommand.RESET:
            self.switch_off_and_on()
            return []
        replies = self._dispatch(command, data)
        # The device mode before the command determines the form of the reply. The unit is silent only if automatic
        # replies were off before the command and are still off after it.
        if not replies or (mode & self.settings[_MODE] & _QUIET and command not in _ANSWERED_ALWAYS):
            return []
        return [
            ZaberMessage(self.number, number, with_id(value, self._identity) if identified else value)
            for number, value in replies
        ]

    def _dispatch(self, command: int, data: int) -> list[tuple[int, int]]:
        if self.status == _HOMING and (command in _MOVES or command in (ZaberCommand.HOME, ZaberCommand.SET_POSITION)):
            return [(ZaberCommand.ERROR, Code.BUSY)]
        if command in _MOVES:
            return self._move(command, data)
        if command in _READINGS:
            return [(command, self._reading(command, data))]
        if command == ZaberCommand.HOME:
            self._home()
            return []
        if command in self.settings or command == ZaberCommand.SET_POSITION:
            return [self._set(command, data)]
        if command == ZaberCommand.RESTORE:
            if data != 0:
                return [(ZaberCommand.ERROR, command)]
            self.settings = {**Unit(self.kind, self.number).settings}
            return [(command, 0)]
        if command == ZaberCommand.RENUMBER:
            if not 1 <= data <= 254:
                return [(ZaberCommand.ERROR, command)]
            self.number = data
            return [(command, self.kind.device_id)]
        if command == ZaberCommand.SETTING:
            if data == ZaberCommand.SET_POSITION:
                return [(data, round(self.position))]
            return [(data, self.settings[data])] if data in self.settings else [(ZaberCommand.ERROR, command)]
        if command == ZaberCommand.SERIAL_NUMBER and self.kind.serial is not None:
            return [(command, self.kind.serial)]
        return [(ZaberCommand.ERROR, Code.UNKNOWN_COMMAND)]

    def _reading(self, command: int, data: int) -> int:
        if command == ZaberCommand.POSITION:
            return round(self.position)
        if command == ZaberCommand.STATUS:
            return self.status
        if command == ZaberCommand.DEVICE_ID:
            return self.kind.device_id
        if command == ZaberCommand.FIRMWARE:
            return self.kind.firmware
        return data  # Echo Data

    def _move(self, command: int, data: int) -> list[tuple[int, int]]:
        velocity = self.motor.velocity
        rest = self.position + velocity * abs(velocity) / (2.0 * self._acceleration)
        maximum = self.settings[_MAXIMUM]
        if command == _SPEED:
            if abs(data) > top_speed(self.settings[_RESOLUTION]):
                return [(ZaberCommand.ERROR, command)]
            limit = float(maximum) if data > 0 else 0.0
            free = data != 0 and (limit - rest) * data > 0.0
            self._start(command, limit if free else rest, abs(data) * SPEED_UNIT, _LIMIT)
            return [(command, data)]
        if command == ZaberCommand.STOP:
            self._start(command, rest, abs(velocity), command, ZaberStatus.STOPPING)
            return []
        top = self.settings[ZaberCommand.SET_SPEED] * SPEED_UNIT
        goal = data + (round(self.position) if command == ZaberCommand.MOVE_RELATIVE else 0)
        if not 0 <= goal <= maximum or top == 0.0:
            return [(ZaberCommand.ERROR, command)]
        self._start(command, float(goal), top, command)
        return []

    @property
    def _acceleration(self) -> float:
        """Acceleration of the motor [microsteps/s^2]; the setting 0 means no ramp."""
        units = self.settings[_ACCELERATION] or top_speed(self.settings[_RESOLUTION])
        return units * ACCELERATION_UNIT

    def _start(self, command: int, goal: float, top: float, answer: int, status: int | None = None) -> None:
        """Start a motion, with a reply at its end; an interrupted motion gets no reply."""
        self.motor.acceleration = self._acceleration
        self.motor.move(goal, top)
        self._move_identity = self._identity
        self._goal, self._answer, self.status = goal, answer, command if status is None else status

    def _home(self) -> None:
        speed = self.settings[ZaberCommand.SET_HOME_SPEED] * SPEED_UNIT
        sensor = self.position + self.motor.zero_behind(HOME_SENSOR) - HOME_SENSOR - self.true_position
        self._start(ZaberCommand.HOME, sensor, speed, ZaberCommand.HOME, ZaberStatus.HOMING)
        self._goal = sensor + (HOME_SENSOR + self.settings[ZaberCommand.SET_HOME_OFFSET])
        if speed:
            self.motor.append(sensor, self._goal, speed)

    def _arrive(self) -> list[tuple[float, ZaberMessage]]:
        answer, motor = self._answer, self.motor
        homing, self.status = self.status == ZaberStatus.HOMING, int(ZaberStatus.IDLE)
        motor.arrive(self._goal)
        value = round(self.position)
        if homing and (motor.stalled or not self.settings[ZaberCommand.SET_HOME_SPEED]):
            answer, value = ZaberCommand.ERROR, int(ZaberCommand.HOME)
        elif homing:
            motor.set_count(0.0)
            value = 0
            self.settings[_MODE] |= Mode.HOMED
        if self.settings[_MODE] & _QUIET:
            return []
        data = with_id(value, self._move_identity) if self.settings[_MODE] & _IDS else value
        return [(motor.time, ZaberMessage(self.number, answer, data))]

    def _set(self, command: int, data: int) -> tuple[int, int]:
        if self.settings[ZaberCommand.SET_LOCK] and command not in (ZaberCommand.SET_LOCK, ZaberCommand.SET_POSITION):
            return ZaberCommand.ERROR, 3600
        top = top_speed(self.settings[ZaberCommand.SET_RESOLUTION])
        maximum = {
            ZaberCommand.SET_MODE: _MODE_BITS,
            ZaberCommand.SET_HOME_SPEED: top,
            ZaberCommand.SET_SPEED: top,
            ZaberCommand.SET_ACCELERATION: top,
            ZaberCommand.SET_ALIAS: 254,
            ZaberCommand.SET_LOCK: 1,
            ZaberCommand.SET_RESOLUTION: 128,
        }.get(ZaberCommand(command), MAX_POSITION)
        if not 0 <= data <= maximum or (
            command == ZaberCommand.SET_RESOLUTION and data not in (1, 2, 4, 8, 16, 32, 64, 128)
        ):
            return ZaberCommand.ERROR, command
        if command == ZaberCommand.SET_MODE and data & ~_MODE_BITS:
            return ZaberCommand.ERROR, 4000 + (data & ~_MODE_BITS).bit_length() - 1
        if command == ZaberCommand.SET_POSITION:
            self.motor.set_count(float(data))
            self.status = int(ZaberStatus.IDLE)
            self.settings[_MODE] |= Mode.HOMED
        else:
            self.settings[command] = data
        return command, data


def unit_of(setup: StageSetup, true_position: float, homed: bool) -> Unit:
    """Return the unit of a stage at `true_position` from its home sensor's zero [microsteps]."""
    serial = FIRST_SERIAL_NUMBER + setup.device
    if setup.joint.motion == "rotation":
        kind = UnitKind(ROTARY_ID, None, round(2.0 * math.pi / setup.joint.microstep), serial=serial)
    else:
        kind = UnitKind(LINEAR_ID, setup.maximum, serial=serial)
    return Unit(kind, setup.device, true_position, true_position + setup.home_count if homed else None)


class ZaberWire:
    """The line of Zaber units: messages of six bytes without checksum."""

    def __init__(self, processing: float) -> None:
        self.processing, self.out = processing, PacedLine(BYTE_TIME_S)
        self._free = self._last = self._deaf_until = -math.inf
        self._part = b""

    def read(self, data: bytes, now: float) -> Iterator[tuple[float, ZaberMessage]]:
        """Return the messages that bytes of the host complete, with the arrival time of their last byte.

        A message that contains a pause of more than 10 ms is dropped, as by real units.
        """
        time = max(self._free, now)
        data = data[: free_buffer(time - now, BYTE_TIME_S)]
        self._free = time + len(data) * BYTE_TIME_S
        while data:
            if time + BYTE_TIME_S < self._deaf_until:
                time, data = time + BYTE_TIME_S, data[1:]
                continue
            if time + BYTE_TIME_S - self._last > RESYNC_GAP_S:
                self._part = b""
            taken = data[: MESSAGE_BYTES - len(self._part)]
            data = data[len(taken) :]
            self._part += taken
            self._last = time = time + len(taken) * BYTE_TIME_S
            if len(self._part) == MESSAGE_BYTES:
                message, self._part = decode(self._part), b""
                if message.device == 0 and message.command == ZaberCommand.RENUMBER:
                    self._deaf_until = time + RENUMBER_TIME_S
                yield time, message

    def encode(self, axis: Unit, answer: ZaberMessage, at: float) -> tuple[float, bytes]:  # noqa: ARG002
        """Return the time and the bytes of a message."""
        return at, encode(answer)


def simulated_chain(units: Sequence[Unit], seed: int = 0, processing: float = 0.0) -> SimulatedLine[Unit]:
    """Return units on one line; `processing` is the time from a command's last byte to its reply's first byte [s]."""
    return SimulatedLine(ZaberWire(processing), units, seed)
