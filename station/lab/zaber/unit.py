"""One simulated Zaber unit: its motor, limits, homing, settings and errors; messages in, messages out.

Sources: the manufacturer's Binary Protocol Manual and his wiki's T-Series pages; times that he does not
give can be changed.
"""

import math
from collections import deque
from dataclasses import dataclass

from station.devices.zaber.protocol import (
    ACCELERATION_UNIT,
    MOST_POSITION,
    RESOLUTION,
    SPEED_UNIT,
    Code,
    Command,
    Message,
    Mode,
    Status,
    split_id,
    top_speed,
    with_id,
)
from station.lab.zaber.motion import Segment, way

RESTARTING = 0.5  #: a unit is deaf so long after Reset [s]
TRACKING = 0.25  #: between two replies of move tracking [s]
HOME_SENSOR = 200.0  #: so far behind zero the home sensor is [microsteps]
STOPS = 2000.0  #: so far beyond the travel the hard stops are [microsteps]
_MOVES = frozenset(
    {Command.MOVE_STORED, Command.MOVE_ABSOLUTE, Command.MOVE_RELATIVE, Command.MOVE_SPEED, Command.STOP}
)
_ANSWERED_ALWAYS = frozenset({Command.RENUMBER, *range(50, 64)})
_READINGS = frozenset(
    {Command.DEVICE_ID, Command.FIRMWARE, Command.VOLTAGE, Command.STATUS, Command.ECHO, Command.POSITION}
)
# Plain numbers: members of an enumeration are slow to look up, and these are at every message.
_SPEED, _LIMIT, _HOMING = int(Command.MOVE_SPEED), int(Command.LIMIT_ACTIVE), int(Status.HOMING)
_MODE, _MAXIMUM = int(Command.SET_MODE), int(Command.SET_MAXIMUM)
_ACCELERATION, _RESOLUTION = int(Command.SET_ACCELERATION), int(Command.SET_RESOLUTION)
_QUIET, _IDS, _TRACKED = int(Mode.NO_AUTO_REPLY), int(Mode.MESSAGE_IDS), int(Mode.MOVE_TRACKING)
#: Bits of the device mode that a unit takes: the documented ones and those that are only known by hearsay.
_MODE_BITS = sum(1 << bit for bit in (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 14, 15))


@dataclass(frozen=True)
class UnitKind:
    """What a unit is. The device IDs of the real ones are not known here."""

    device_id: int
    travel: int | None  #: [microsteps]; None: turns on and on
    turn: int = 0  #: one turn of a unit that turns on and on [microsteps]
    firmware: int = 523
    serial: int | None = None  #: an old unit has none


class Unit:
    """One stage with its controller. Positions are its own count [microsteps]."""

    def __init__(self, kind: UnitKind, number: int, place: float = 0.0, count: float | None = None) -> None:
        """`place` is where it really is, from the home sensor's zero; `count`, where it believes to be.

        Without a count it has just been switched on and is not homed.
        """
        self.kind, self.number = kind, number
        position = 0.0 if count is None else count
        self.settings: dict[int, int] = {
            Command.SET_RESOLUTION: RESOLUTION,
            Command.SET_RUN_CURRENT: 10,
            Command.SET_HOLD_CURRENT: 20,
            Command.SET_MODE: 1 << 11 | (0 if count is None else Mode.HOMED),
            Command.SET_HOME_SPEED: 2922,
            Command.SET_SPEED: 2922,
            Command.SET_ACCELERATION: 111,
            Command.SET_MAXIMUM: kind.travel or kind.turn,
            Command.SET_MOST_RELATIVE: MOST_POSITION,
            Command.SET_HOME_OFFSET: 0,
            Command.SET_ALIAS: 0,
            Command.SET_LOCK: 0,
        }
        self.status = int(Status.IDLE)
        self.deaf_until = -math.inf
        self.time = 0.0
        self._stored = [0] * 16
        self._shift = place - position  # place - count
        self._stuck: float | None = None
        self._least, self._most = (-math.inf, math.inf) if kind.travel is None else (-STOPS, kind.travel + STOPS)
        self._plan: deque[Segment] = deque()
        self._begun, self._start_at, self._start_velocity = 0.0, position, 0.0  # of the plan's first part
        self.due = math.inf  #: when it has something to do next [s]
        self._goal: float | None = None
        self._answer: int | None = None
        self._identity = self._move_identity = 0  # of the last command, of the one that moves
        self._track = math.inf

    @property
    def place(self) -> float:
        """Where the stage really is, from the home sensor's zero [microsteps]."""
        if self._stuck is not None:
            return self._stuck
        place = self.position + self._shift
        # Between two hard stops, where the motor may count on.
        return place if self._least <= place <= self._most else min(max(place, self._least), self._most)

    def stall(self, stalled: bool) -> None:
        """The motor counts steps that it does not make, or makes them again."""
        if stalled and self._stuck is None:
            self._stuck = self.place
        elif not stalled and self._stuck is not None:
            self._shift, self._stuck = self._stuck - self.position, None

    def turn_knob(self, microsteps: float) -> list[Message]:
        """Somebody turns the knob; what the unit says to it."""
        mode = self.settings[Command.SET_MODE]
        if mode & Mode.NO_KNOB or self._plan:
            return []
        self._start_at = min(max(self._start_at + microsteps, 0.0), float(self.settings[Command.SET_MAXIMUM]))
        return [] if mode & Mode.NO_MANUAL_TRACKING else [self._reply(Command.MANUAL_MOVE, round(self.position))]

    def advance(self, until: float) -> list[tuple[float, Message]]:
        """Run the motor until then; what the unit says meanwhile, and when."""
        said: list[tuple[float, Message]] = []
        while self.due <= until:
            self.time = self.due
            if self.time == self._track:
                said.append((self.time, self._reply(Command.MOVE_TRACKING, round(self.position))))
                self._track += TRACKING
                self.due = min(self._begun + self._plan[0].duration, self._track)
            else:
                velocity, position = self._velocity, self.position
                self._plan.popleft()
                self._begin(position, velocity)
                if not self._plan:
                    said += self._arrive()
        self.time = until
        return said

    def _begin(self, position: float, velocity: float) -> None:
        """Begin the plan's first part here and now."""
        place = position + self._shift
        if self._stuck is None and not self._least <= place <= self._most:
            self._shift += min(max(place, self._least), self._most) - place  # steps lost at a hard stop
        self._begun, self._start_at, self._start_velocity = self.time, position, velocity
        self.due = min(self.time + self._plan[0].duration, self._track) if self._plan else math.inf

    @property
    def position(self) -> float:
        """Where it believes to be [microsteps]."""
        if not self._plan:
            return self._start_at
        step = self.time - self._begun
        return self._start_at + (self._start_velocity + 0.5 * self._plan[0].acceleration * step) * step

    @property
    def _velocity(self) -> float:
        """How fast it goes [microsteps/s]."""
        if not self._plan:
            return 0.0
        return self._start_velocity + self._plan[0].acceleration * (self.time - self._begun)

    def take(self, message: Message) -> list[Message]:
        """Carry out a command that arrives now; what the unit says at once."""
        _, command, data = message
        mode = self.settings[_MODE]
        identified = mode & _IDS
        data, self._identity = split_id(data) if identified else (data, 0)
        if command == Command.RESET:
            self._reset()
            return []
        said = self._obey(command, data)
        # How a command is answered depends on the mode from before it; whether, on both.
        if not said or (mode & self.settings[_MODE] & _QUIET and command not in _ANSWERED_ALWAYS):
            return []
        return [
            Message(self.number, number, with_id(value, self._identity) if identified else value)
            for number, value in said
        ]

    def _obey(self, command: int, data: int) -> list[tuple[int, int]]:
        if self.status == _HOMING and (command in _MOVES or command in (Command.HOME, Command.SET_POSITION)):
            return [(Command.ERROR, Code.BUSY)]
        if command in _MOVES:
            return self._move(command, data)
        if command in _READINGS:
            return [(command, self._tell(command, data))]
        if command == Command.HOME:
            self._home()
            return []
        if Command.SET_RESOLUTION <= command <= Command.SET_LOCK:
            return [self._set(command, data)]
        if command in (Command.STORE_POSITION, Command.RETURN_STORED):
            return [self._store(command, data)]
        if command == Command.RESTORE:
            if data != 0:
                return [(Command.ERROR, command)]
            self.settings = {**Unit(self.kind, self.number).settings}
            return [(command, 0)]
        if command == Command.RENUMBER:
            if not 1 <= data <= 254:
                return [(Command.ERROR, command)]
            self.number = data
            return [(command, self.kind.device_id)]
        if command == Command.SETTING:
            if data == Command.SET_POSITION:
                return [(data, round(self.position))]
            return [(data, self.settings[data])] if data in self.settings else [(Command.ERROR, command)]
        if command == Command.SERIAL_NUMBER and self.kind.serial is not None:
            return [(command, self.kind.serial)]
        return [(Command.ERROR, Code.UNKNOWN_COMMAND)]

    def _tell(self, command: int, data: int) -> int:
        if command == Command.POSITION:
            return round(self.position)
        if command == Command.STATUS:
            return self.status
        if command == Command.DEVICE_ID:
            return self.kind.device_id
        if command == Command.FIRMWARE:
            return self.kind.firmware
        return 150 if command == Command.VOLTAGE else data  # or Echo Data

    def _move(self, command: int, data: int) -> list[tuple[int, int]]:
        velocity = self._velocity
        rest = self.position + velocity * abs(velocity) / (2.0 * self._acceleration)
        maximum = self.settings[_MAXIMUM]
        if command == _SPEED:
            if abs(data) > top_speed(self.settings[_RESOLUTION]):
                return [(Command.ERROR, command)]
            limit = float(maximum) if data > 0 else 0.0
            free = data != 0 and (limit - rest) * data > 0.0
            self._start(command, limit if free else rest, abs(data) * SPEED_UNIT, _LIMIT)
            return [(command, data)]
        if command == Command.STOP:
            self._start(command, rest, abs(velocity), command, Status.STOPPING)
            return []
        top = self.settings[Command.SET_SPEED] * SPEED_UNIT
        if command == Command.MOVE_STORED:
            if not 0 <= data < 16:
                return [(Command.ERROR, 1800)]
            if not self.settings[Command.SET_MODE] & Mode.HOMED:
                return [(Command.ERROR, 1801)]
            goal = self._stored[data]
        else:
            goal = data + (round(self.position) if command == Command.MOVE_RELATIVE else 0)
        if not 0 <= goal <= maximum or top == 0.0:
            return [(Command.ERROR, command)]
        self._start(command, float(goal), top, command)
        return []

    @property
    def _acceleration(self) -> float:
        """[microsteps/s^2]; 0 stands for no ramp at all."""
        units = self.settings[_ACCELERATION] or top_speed(self.settings[_RESOLUTION])
        return units * ACCELERATION_UNIT

    def _start(self, command: int, goal: float, top: float, answer: int, status: int | None = None) -> None:
        """Move, and answer at the end; a motion that was on is never answered."""
        position, velocity = self.position, self._velocity
        self._plan = deque(way(position, velocity, goal, top, self._acceleration))
        self._move_identity = self._identity
        self._goal, self._answer, self.status = goal, answer, command if status is None else status
        self._track = self.time + TRACKING if self.settings[_MODE] & _TRACKED else math.inf
        self._begin(position, velocity)

    def _home(self) -> None:
        speed = self.settings[Command.SET_HOME_SPEED] * SPEED_UNIT
        # A unit that turns on and on meets its sensor once a turn.
        zero = 0.0 if self.kind.travel is not None else self._zero_behind()
        sensor = self.position + zero - HOME_SENSOR - self.place
        self._start(Command.HOME, sensor, speed, Command.HOME, Status.HOMING)
        forward = HOME_SENSOR + self.settings[Command.SET_HOME_OFFSET]
        self._plan += way(sensor, 0.0, sensor + forward, speed, self._acceleration) if speed else ()
        self._goal = sensor + forward

    def _zero_behind(self) -> float:
        """The zero whose sensor is met first on the way back."""
        return math.floor((self.place + HOME_SENSOR) / self.kind.turn) * self.kind.turn

    def _arrive(self) -> list[tuple[float, Message]]:
        answer, self._track = self._answer, math.inf
        homing, self.status = self.status == Status.HOMING, int(Status.IDLE)
        if self._goal is not None:
            self._start_at = self._goal
        quiet = self.settings[Command.SET_MODE] & Mode.NO_AUTO_REPLY
        value = round(self.position)
        if homing and (self._stuck is not None or not self.settings[Command.SET_HOME_SPEED]):
            answer, value = Command.ERROR, int(Command.HOME)
        elif homing:
            self._shift += self.position
            self._start_at, value = 0.0, 0
            self.settings[Command.SET_MODE] |= Mode.HOMED
        return [] if quiet or answer is None else [(self.time, self._reply(answer, value))]

    def _set(self, command: int, data: int) -> tuple[int, int]:
        if self.settings[Command.SET_LOCK] and command not in (Command.SET_LOCK, Command.SET_POSITION):
            return Command.ERROR, 3600
        top = top_speed(self.settings[Command.SET_RESOLUTION])
        most = {
            Command.SET_RUN_CURRENT: 127,
            Command.SET_HOLD_CURRENT: 127,
            Command.SET_MODE: _MODE_BITS,
            Command.SET_HOME_SPEED: top,
            Command.SET_SPEED: top,
            Command.SET_ACCELERATION: top,
            Command.SET_ALIAS: 254,
            Command.SET_LOCK: 1,
            Command.SET_RESOLUTION: 128,
        }.get(Command(command), MOST_POSITION)
        if not 0 <= data <= most or (command == Command.SET_RESOLUTION and data not in (1, 2, 4, 8, 16, 32, 64, 128)):
            return Command.ERROR, command
        if command == Command.SET_MODE and data & ~_MODE_BITS:
            return Command.ERROR, 4000 + (data & ~_MODE_BITS).bit_length() - 1
        if command == Command.SET_POSITION:
            ahead = data - self.position
            self._shift -= ahead
            self._start_at += ahead
            self.settings[Command.SET_MODE] |= Mode.HOMED
        else:
            self.settings[command] = data
        return command, data

    def _store(self, command: int, address: int) -> tuple[int, int]:
        if not 0 <= address < 16:
            return Command.ERROR, 1600 if command == Command.STORE_POSITION else 1700
        if command == Command.STORE_POSITION:
            if not self.settings[Command.SET_MODE] & Mode.HOMED:
                return Command.ERROR, 1601
            self._stored[address] = round(self.position)
            return command, address
        return command, self._stored[address]

    def _reset(self) -> None:
        """Power-up: at rest at once, not homed, the count begins anew."""
        self._shift += self.position
        self._plan.clear()
        self._start_at = 0.0
        self.status, self._track, self.due = int(Status.IDLE), math.inf, math.inf
        self.settings[Command.SET_MODE] &= ~Mode.HOMED
        self.deaf_until = self.time + RESTARTING

    def _reply(self, command: int, data: int) -> Message:
        """What is said by itself or at the end of a motion."""
        identified = self.settings[Command.SET_MODE] & Mode.MESSAGE_IDS
        return Message(self.number, command, with_id(data, self._move_identity) if identified else data)
