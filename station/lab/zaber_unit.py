"""One simulated Zaber unit: its motor, limits, homing, settings and errors. It receives and sends messages.

Sources: the manufacturer's Binary Protocol Manual and the T-Series pages of its wiki. Times that these sources do not
specify are parameters.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from station.devices.zaber.protocol import (
    ACCELERATION_UNIT,
    MAX_POSITION,
    MICROSTEP_RESOLUTION,
    SPEED_UNIT,
    Code,
    Mode,
    ZaberCommand,
    ZaberMessage,
    ZaberStatus,
    split_id,
    top_speed,
    with_id,
)


class Segment(NamedTuple):
    """Segment of a motion with constant acceleration."""

    duration: float  #: [s]
    acceleration: float  #: [microsteps/s^2]


def quickest_motion(position: float, velocity: float, goal: float, top: float, acceleration: float) -> list[Segment]:
    """Return the fastest motion to rest at `goal` [microsteps] at no more than `top` [microsteps/s]."""
    rest = position + velocity * abs(velocity) / (2.0 * acceleration)
    side = 1.0 if goal >= rest else -1.0
    distance, speed = side * (goal - position), side * velocity
    peak = min(top, math.sqrt(max(0.0, acceleration * distance + 0.5 * speed * speed)))
    ramp = acceleration if peak >= speed else -acceleration
    cruise = distance - (peak * peak - speed * speed) / (2.0 * ramp) - peak * peak / (2.0 * acceleration)
    segments = [Segment(abs(peak - speed) / acceleration, side * ramp)]
    if peak > 0.0:
        segments += [Segment(max(0.0, cruise) / peak, 0.0), Segment(peak / acceleration, -side * acceleration)]
    return segments


RESTART_TIME_S = 0.5  #: time after Reset in which a unit ignores commands [s]
TRACKING_INTERVAL_S = 0.25  #: time between two replies of move tracking [s]
HOME_SENSOR = 200.0  #: distance of the home sensor below the unit's zero [microsteps]
STOPS = 2000.0  #: distance of the hard stops from both ends of the travel [microsteps]
_MOVES = frozenset(
    {
        ZaberCommand.MOVE_STORED,
        ZaberCommand.MOVE_ABSOLUTE,
        ZaberCommand.MOVE_RELATIVE,
        ZaberCommand.MOVE_SPEED,
        ZaberCommand.STOP,
    }
)
_ANSWERED_ALWAYS = frozenset({ZaberCommand.RENUMBER, *range(50, 64)})
_READINGS = frozenset(
    {
        ZaberCommand.DEVICE_ID,
        ZaberCommand.FIRMWARE,
        ZaberCommand.VOLTAGE,
        ZaberCommand.STATUS,
        ZaberCommand.ECHO,
        ZaberCommand.POSITION,
    }
)
# Command numbers as plain integers, because every message needs them and enumeration members are slow.
_SPEED, _LIMIT, _HOMING = int(ZaberCommand.MOVE_SPEED), int(ZaberCommand.LIMIT_ACTIVE), int(ZaberStatus.HOMING)
_MODE, _MAXIMUM = int(ZaberCommand.SET_MODE), int(ZaberCommand.SET_MAXIMUM)
_ACCELERATION, _RESOLUTION = int(ZaberCommand.SET_ACCELERATION), int(ZaberCommand.SET_RESOLUTION)
_QUIET, _IDS, _TRACKED = int(Mode.NO_AUTO_REPLY), int(Mode.MESSAGE_IDS), int(Mode.MOVE_TRACKING)
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
    """One simulated stage with its controller. Positions not called true are the controller's counts [microsteps]."""

    def __init__(self, kind: UnitKind, number: int, true_position: float = 0.0, count: float | None = None) -> None:
        """Create the unit with the stage at `true_position` from the home sensor's zero [microsteps].

        `count` is the position that the unit counts [microsteps]; None: the unit has just been switched on and is not
        homed.
        """
        self.kind, self.number = kind, number
        position = 0.0 if count is None else count
        self.settings: dict[int, int] = {
            ZaberCommand.SET_RESOLUTION: MICROSTEP_RESOLUTION,
            ZaberCommand.SET_RUN_CURRENT: 10,
            ZaberCommand.SET_HOLD_CURRENT: 20,
            ZaberCommand.SET_MODE: 1 << 11 | (0 if count is None else Mode.HOMED),
            ZaberCommand.SET_HOME_SPEED: 2922,
            ZaberCommand.SET_SPEED: 2922,
            ZaberCommand.SET_ACCELERATION: 111,
            ZaberCommand.SET_MAXIMUM: kind.travel or kind.turn,
            ZaberCommand.SET_MOST_RELATIVE: MAX_POSITION,
            ZaberCommand.SET_HOME_OFFSET: 0,
            ZaberCommand.SET_ALIAS: 0,
            ZaberCommand.SET_LOCK: 0,
        }
        self.status = int(ZaberStatus.IDLE)
        self.deaf_until = -math.inf
        self.time = 0.0
        self._stored = [0] * 16
        self._shift = true_position - position  # true position minus count
        self._stuck: float | None = None
        self._lower, self._upper = (-math.inf, math.inf) if kind.travel is None else (-STOPS, kind.travel + STOPS)
        self._plan: deque[Segment] = deque()
        self._start_time, self._start_position, self._start_velocity = 0.0, position, 0.0  # of the first segment
        self.due = math.inf  #: time of the next event [s]
        self._goal: float | None = None
        self._answer: int | None = None
        self._identity = self._move_identity = 0  # of the last command, of the motion command
        self._track = math.inf

    @property
    def true_position(self) -> float:
        """True position of the stage from the home sensor's zero [microsteps]."""
        if self._stuck is not None:
            return self._stuck
        position = (self.position if self._plan else self._start_position) + self._shift
        # The hard stops bound the stage, while the motor may continue to count.
        return position if self._lower <= position <= self._upper else min(max(position, self._lower), self._upper)

    def stall(self, stalled: bool) -> None:
        """Start or end a stall, in which the motor counts steps without moving."""
        if stalled and self._stuck is None:
            self._stuck = self.true_position
        elif not stalled and self._stuck is not None:
            self._shift, self._stuck = self._stuck - self.position, None

    def turn_knob(self, microsteps: float) -> list[ZaberMessage]:
        """Turn the knob, and return the unit's messages."""
        mode = self.settings[ZaberCommand.SET_MODE]
        if mode & Mode.NO_KNOB or self._plan:
            return []
        self._start_position = min(
            max(self._start_position + microsteps, 0.0), float(self.settings[ZaberCommand.SET_MAXIMUM])
        )
        return [] if mode & Mode.NO_MANUAL_TRACKING else [self._reply(ZaberCommand.MANUAL_MOVE, round(self.position))]

    def advance(self, until: float) -> list[tuple[float, ZaberMessage]]:
        """Run the motor until the time `until` [s], and return the unit's messages with their times."""
        messages: list[tuple[float, ZaberMessage]] = []
        while self.due <= until:
            self.time = self.due
            if self.time == self._track:
                messages.append((self.time, self._reply(ZaberCommand.MOVE_TRACKING, round(self.position))))
                self._track += TRACKING_INTERVAL_S
                self.due = min(self._start_time + self._plan[0].duration, self._track)
            else:
                velocity, position = self._velocity, self.position
                self._plan.popleft()
                self._start_segment(position, velocity)
                if not self._plan:
                    messages += self._arrive()
        self.time = until
        return messages

    def _start_segment(self, position: float, velocity: float) -> None:
        """Start the first segment of the plan from the present position."""
        true = position + self._shift
        if self._stuck is None and not self._lower <= true <= self._upper:
            self._shift += min(max(true, self._lower), self._upper) - true  # steps lost at a hard stop
        self._start_time, self._start_position, self._start_velocity = self.time, position, velocity
        self.due = min(self.time + self._plan[0].duration, self._track) if self._plan else math.inf

    @property
    def position(self) -> float:
        """Position that the unit counts [microsteps]."""
        if not self._plan:
            return self._start_position
        step = self.time - self._start_time
        return self._start_position + (self._start_velocity + 0.5 * self._plan[0].acceleration * step) * step

    @property
    def _velocity(self) -> float:
        """Present velocity [microsteps/s]."""
        if not self._plan:
            return 0.0
        return self._start_velocity + self._plan[0].acceleration * (self.time - self._start_time)

    def execute(self, message: ZaberMessage) -> list[ZaberMessage]:
        """Execute a command that arrives now, and return the immediate replies."""
        _, command, data = message
        mode = self.settings[_MODE]
        identified = mode & _IDS
        data, self._identity = split_id(data) if identified else (data, 0)
        if command == ZaberCommand.RESET:
            self._reset()
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
        if ZaberCommand.SET_RESOLUTION <= command <= ZaberCommand.SET_LOCK:
            return [self._set(command, data)]
        if command in (ZaberCommand.STORE_POSITION, ZaberCommand.RETURN_STORED):
            return [self._store(command, data)]
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
        return 150 if command == ZaberCommand.VOLTAGE else data  # the other command is Echo Data

    def _move(self, command: int, data: int) -> list[tuple[int, int]]:
        velocity = self._velocity
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
        if command == ZaberCommand.MOVE_STORED:
            if not 0 <= data < 16:
                return [(ZaberCommand.ERROR, 1800)]
            if not self.settings[ZaberCommand.SET_MODE] & Mode.HOMED:
                return [(ZaberCommand.ERROR, 1801)]
            goal = self._stored[data]
        else:
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
        position, velocity = self.position, self._velocity
        self._plan = deque(quickest_motion(position, velocity, goal, top, self._acceleration))
        self._move_identity = self._identity
        self._goal, self._answer, self.status = goal, answer, command if status is None else status
        self._track = self.time + TRACKING_INTERVAL_S if self.settings[_MODE] & _TRACKED else math.inf
        self._start_segment(position, velocity)

    def _home(self) -> None:
        speed = self.settings[ZaberCommand.SET_HOME_SPEED] * SPEED_UNIT
        # A unit with unlimited rotation passes its sensor once per turn.
        zero = 0.0 if self.kind.travel is not None else self._zero_behind()
        sensor = self.position + zero - HOME_SENSOR - self.true_position
        self._start(ZaberCommand.HOME, sensor, speed, ZaberCommand.HOME, ZaberStatus.HOMING)
        forward = HOME_SENSOR + self.settings[ZaberCommand.SET_HOME_OFFSET]
        self._plan += quickest_motion(sensor, 0.0, sensor + forward, speed, self._acceleration) if speed else ()
        self._goal = sensor + forward

    def _zero_behind(self) -> float:
        """Return the true position of the zero whose home sensor a backward motion reaches first [microsteps]."""
        return math.floor((self.true_position + HOME_SENSOR) / self.kind.turn) * self.kind.turn

    def _arrive(self) -> list[tuple[float, ZaberMessage]]:
        answer, self._track = self._answer, math.inf
        homing, self.status = self.status == ZaberStatus.HOMING, int(ZaberStatus.IDLE)
        if self._goal is not None:
            self._start_position = self._goal
        quiet = self.settings[ZaberCommand.SET_MODE] & Mode.NO_AUTO_REPLY
        value = round(self.position)
        if homing and (self._stuck is not None or not self.settings[ZaberCommand.SET_HOME_SPEED]):
            answer, value = ZaberCommand.ERROR, int(ZaberCommand.HOME)
        elif homing:
            self._shift += self.position
            self._start_position, value = 0.0, 0
            self.settings[ZaberCommand.SET_MODE] |= Mode.HOMED
        return [] if quiet or answer is None else [(self.time, self._reply(answer, value))]

    def _set(self, command: int, data: int) -> tuple[int, int]:
        if self.settings[ZaberCommand.SET_LOCK] and command not in (ZaberCommand.SET_LOCK, ZaberCommand.SET_POSITION):
            return ZaberCommand.ERROR, 3600
        top = top_speed(self.settings[ZaberCommand.SET_RESOLUTION])
        maximum = {
            ZaberCommand.SET_RUN_CURRENT: 127,
            ZaberCommand.SET_HOLD_CURRENT: 127,
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
            ahead = data - self.position
            self._shift -= ahead
            self._start_position += ahead
            self.settings[ZaberCommand.SET_MODE] |= Mode.HOMED
        else:
            self.settings[command] = data
        return command, data

    def _store(self, command: int, address: int) -> tuple[int, int]:
        if not 0 <= address < 16:
            return ZaberCommand.ERROR, 1600 if command == ZaberCommand.STORE_POSITION else 1700
        if command == ZaberCommand.STORE_POSITION:
            if not self.settings[ZaberCommand.SET_MODE] & Mode.HOMED:
                return ZaberCommand.ERROR, 1601
            self._stored[address] = round(self.position)
            return command, address
        return command, self._stored[address]

    def _reset(self) -> None:
        """Simulate a power-up: the unit is at rest and not homed, and its count restarts at 0."""
        self._shift += self.position
        self._plan.clear()
        self._start_position = 0.0
        self.status, self._track, self.due = int(ZaberStatus.IDLE), math.inf, math.inf
        self.settings[ZaberCommand.SET_MODE] &= ~Mode.HOMED
        self.deaf_until = self.time + RESTART_TIME_S

    def _reply(self, command: int, data: int) -> ZaberMessage:
        """Return a message that the unit sends at the end of a motion or without a command."""
        identified = self.settings[ZaberCommand.SET_MODE] & Mode.MESSAGE_IDS
        return ZaberMessage(self.number, command, with_id(data, self._move_identity) if identified else data)
