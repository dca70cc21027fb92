"""Connects and homes Zaber units by sequences of queries and settings, one at a time.

The caller runs the sequences: a sequence yields a request or a waiting time, and receives the reply to the request.
The sequences read every setting back, because the units' automatic replies are switched off.
"""

import math
from collections.abc import Generator, Mapping, Sequence
from typing import Any, NamedTuple

from station.devices.reach import reach
from station.devices.zaber.chain import ZaberChain
from station.devices.zaber.estimate import AxisEstimate
from station.devices.zaber.protocol import (
    MICROSTEP_RESOLUTION,
    Code,
    Mode,
    Reply,
    Request,
    ZaberCommand,
    ZaberError,
    ZaberStatus,
    error_text,
)
from station.devices.zaber.setup import PortSetup, StageSetup


class Identity(NamedTuple):
    """Identity that a unit reports."""

    device_id: int
    firmware: int  #: firmware version with two implied decimals: 523 is 5.23
    serial: int | None  #: serial number; None for old units, which have none


class Units:
    """State of all stages' units; identities and homing states persist when the ports change."""

    def __init__(self, setups: Sequence[StageSetup]) -> None:
        self.setups = tuple(setups)
        self.identities: list[Identity | None] = [None for _ in setups]
        self.homed = [False for _ in setups]
        self.home_again: set[int] = set()  #: stages that must be homed even if their units report to be homed
        self.homing_distance = [0.0 for _ in setups]  #: distance moved since an unfinished homing began [rad or m]
        self.ports: tuple[PortSetup, ...] = ()
        self.chains: list[ZaberChain] = []  #: one for each port
        self.where: list[tuple[ZaberChain, int]] = []  #: chain and axis of each stage

    def estimate(self, i: int) -> AxisEstimate:
        """Return the position estimate of a stage's axis [microsteps]."""
        chain, axis = self.where[i]
        return chain.estimates[axis]

    def alias(self, i: int) -> int:
        """Return the alias of a stage's unit."""
        chain, axis = self.where[i]
        return chain.axes[axis].alias or 0

    def name(self, i: int) -> str:
        """Return the name of a stage, for messages."""
        return f"the stage {self.setups[i].joint.name}"

    def address(self, i: int) -> str:
        """Return the name of a stage's joint with its device number and its port, for the details of messages."""
        link = next(port.link for port in self.ports if i in port.stages)
        return f"{self.setups[i].joint.name}: device {self.setups[i].device} on {link.name}"

    def reach(self, i: int) -> str:
        """Return how far a stage that no longer receives commands can still move, as text."""
        chain, axis = self.where[i]
        setup, count, speed = self.setups[i], chain.estimates[axis].position, chain.sent[axis]
        end = setup.position(setup.maximum if speed > 0 else 0)
        return reach(setup.joint, setup.position(count), end, speed != 0)


class HomingStep(NamedTuple):
    """Motion of one axis to its home sensor."""

    joint: str
    unit: str
    way: float  #: distance of the motion [unit]
    exact: bool  #: whether the start position is known; if not, `way` is the longest possible distance
    speed: float  #: speed of the motion [unit/s]


def homing_step(setup: StageSetup, count: float | None) -> HomingStep:
    """Return the homing motion of a stage from `count` [microsteps]; None: the position is unknown.

    Units home towards lower counts. A rotation stage passes its sensor once per turn; a rotation stage that starts
    below its zero turns back up by one turn after it has found the sensor.
    """
    turns, step, joint = setup.joint.motion == "rotation", setup.joint.microstep, setup.joint
    turn = 2.0 * math.pi
    if count is None:
        way = turn if turns else setup.maximum * step
    else:
        above = (count - setup.home_count) * step
        way = above if above >= 0.0 or not turns else 2.0 * turn + above
    return HomingStep(joint.name, "rad" if turns else "m", abs(way), count is not None, setup.home_speed)


class Homing:
    """Progress of the homing motions of all axes, which home one after the other."""

    def __init__(self, steps: Sequence[HomingStep]) -> None:
        self._steps = tuple(steps)
        self._at, self._since = 0, 0.0

    def start(self, number: int, now: float) -> None:
        """Record that the homing motion with the index `number` starts at `now` [s]."""
        self._at, self._since = number, now

    def progress(self, now: float) -> Mapping[str, Any]:
        """Return the moving axis, its number `of` all, distance `gone` of `way` [unit], and remaining time [s]."""
        step = self._steps[self._at]
        gone = min(step.way, (now - self._since) * step.speed)
        left = (step.way - gone) / step.speed + sum(each.way / each.speed for each in self._steps[self._at + 1 :])
        return {
            "joint": step.joint, "number": self._at + 1, "of": len(self._steps), "gone": gone, "way": step.way,
            "exact": step.exact, "unit": step.unit, "left_s": left,
        }  # fmt: skip


MAX_ATTEMPTS = 6  #: largest number of times that a query is sent until two replies agree
STOP_TIMEOUT_S = 5.0  #: time in which a unit must confirm a stop; a reset of the unit takes 1 s of this time [s]

Script = Generator[Request | float, Any, None]  #: yields requests, or waiting times [s]; receives replies


class Sequences:
    """The sequences that connect and home units; these generators raise `ZaberError` if they cannot continue."""

    def __init__(self, units: Units) -> None:
        self.now = -math.inf  #: time [s], set by the caller that runs a sequence
        self._units = units
        self.homing: Homing | None = None  #: progress of the latest homing
        self._refusal: int | None = None  # error code of the last error reply

    def connect(self) -> Script:
        """Identify and set up every unit, then wait for the positions of all homed stages."""
        units = self._units
        for i, setup in enumerate(units.setups):
            name = units.name(i)
            device_id = yield from self._read_twice(i, ZaberCommand.DEVICE_ID)
            if device_id is None:
                raise ZaberError(f"{name} does not answer; is it powered, plugged in and numbered {setup.device}?")
            firmware = yield from self._read_twice(i, ZaberCommand.FIRMWARE)
            if firmware is None or not 500 <= firmware < 600:
                raise ZaberError(f"{name} has firmware {(firmware or 0) / 100:.2f}; 5.00 ... 5.99 is supported")
            serial = yield from self._read_twice(i, ZaberCommand.SERIAL_NUMBER)
            found, before = Identity(device_id, firmware, serial), units.identities[i]
            for what, value, expected in (
                ("device ID", device_id, setup.device_id if before is None else before.device_id),
                ("serial number", serial, setup.serial if before is None else before.serial),
            ):
                if expected is not None and value != expected:
                    raise ZaberError(f"{name} has {what} {value}; {expected} is expected: is it another unit?")
            mode = yield from self._need(i, ZaberCommand.SET_MODE)
            resolution = yield from self._need(i, ZaberCommand.SET_RESOLUTION)
            if resolution != MICROSTEP_RESOLUTION:
                mode &= ~Mode.HOMED  # a position counted with another microstep size is invalid
            # Unrequested positions and a turned knob would invalidate the estimate, which uses the velocities sent.
            mode = (mode | Mode.NO_AUTO_REPLY | Mode.NO_KNOB) & ~(Mode.MOVE_TRACKING | Mode.MESSAGE_IDS)
            for command, data in (
                (ZaberCommand.SET_MODE, mode),
                (ZaberCommand.SET_RESOLUTION, MICROSTEP_RESOLUTION),
                (ZaberCommand.SET_HOME_OFFSET, 0),
                (ZaberCommand.SET_ALIAS, units.alias(i)),
                (ZaberCommand.SET_ACCELERATION, setup.acceleration),
                (ZaberCommand.SET_HOME_SPEED, setup.home_units),
                (ZaberCommand.SET_MAXIMUM, setup.maximum),
            ):
                yield from self._set(i, command, data)
            units.identities[i] = found
            units.homed[i] = bool(mode & Mode.HOMED) and i not in units.home_again
            units.estimate(i).forget()
        for chain in units.chains:
            chain.polling = True
        yield from self._settle()

    def home(self) -> Script:
        """Home the translations first, then one rotation after the other."""
        units = self._units
        yield from self._confirm_stops()
        order = sorted(range(len(units.setups)), key=lambda i: units.setups[i].joint.motion != "translation")
        self.homing = Homing([homing_step(units.setups[i], self._count(i)) for i in order])
        for number, i in enumerate(order):
            setup, name = units.setups[i], units.name(i)
            self.homing.start(number, self.now)
            units.homed[i] = False
            units.estimate(i).forget(adrift=True)
            mode = yield from self._need(i, ZaberCommand.SET_MODE)
            # The flag is cleared before the homing, so that a set flag proves a completed homing.
            yield from self._set(i, ZaberCommand.SET_MODE, mode & ~Mode.HOMED)
            reach = max(setup.maximum * setup.joint.microstep, 2.0 * math.pi) / setup.home_speed
            give_up = self.now + 2.0 * reach + 10.0
            for _ in range(3):
                started = self.now
                try:
                    yield Request(i, ZaberCommand.HOME)
                    yield from self._rest(i, give_up, "homing")
                finally:
                    units.homing_distance[i] += (self.now - started) * setup.home_speed
                mode = yield from self._need(i, ZaberCommand.SET_MODE)
                if mode & Mode.HOMED:
                    break
            else:
                raise ZaberError(f"{name} stopped without reaching its home sensor; is it free to move?")
            if setup.joint.motion == "rotation" and units.homing_distance[i] > math.pi:
                yield from self._turn_back(i)
            units.homing_distance[i] = 0.0
            if setup.home_count:
                yield from self._set(i, ZaberCommand.SET_POSITION, setup.home_count)
            units.estimate(i).forget()
            units.homed[i] = True
            units.home_again.discard(i)
        yield from self._settle()

    def _count(self, i: int) -> float | None:
        """Return the position of a stage [microsteps]; None if the position is unknown."""
        estimate = self._units.estimate(i)
        return estimate.position if self._units.homed[i] and estimate.known else None

    def _turn_back(self, i: int) -> Script:
        """Turn a rotation stage that homed one turn too low up by one turn to its zero, at the homing speed.

        A rotation stage passes its home sensor once per turn while it moves down. If the stage started within half a
        turn of its zero and moved more than half a turn to the sensor, it started below zero.
        """
        setup, name = self._units.setups[i], self._units.name(i)
        turn = round(2.0 * math.pi / setup.joint.microstep)
        yield from self._set(i, ZaberCommand.SET_SPEED, setup.home_units)
        yield from self._set(i, ZaberCommand.SET_MAXIMUM, max(turn, setup.maximum))
        yield Request(i, ZaberCommand.MOVE_RELATIVE, turn)
        seconds = 2.0 * math.pi / setup.home_speed
        yield from self._rest(i, self.now + 2.0 * seconds + 10.0, "turning back to its zero")
        position = yield from self._read_twice(i, ZaberCommand.POSITION)
        yield from self._set(i, ZaberCommand.SET_MAXIMUM, setup.maximum)
        if position != turn:
            raise ZaberError(f"{name} is at {position} microsteps after turning back to its zero, not at {turn}")

    def _confirm_stops(self) -> Script:
        """Wait until every unit has confirmed its last stop: until then a repeated stop could end a new motion."""
        units = self._units
        give_up = self.now + STOP_TIMEOUT_S
        while moving := [i for i, (chain, axis) in enumerate(units.where) if axis in chain.stopping]:
            if self.now > give_up:
                raise ZaberError(f"{units.name(moving[0])} has not confirmed a stop for {STOP_TIMEOUT_S:.0f} s")
            yield 0.02

    def _rest(self, i: int, give_up: float, what: str) -> Script:
        """Wait until a unit is idle; `give_up` is the time of the ZaberError [s], `what` describes the motion."""
        started = self.now
        yield 0.05
        while (yield from self._read_twice(i, ZaberCommand.STATUS)) not in (ZaberStatus.IDLE, None):
            if self.now > give_up:
                raise ZaberError(f"{self._units.name(i)} has been {what} for more than {give_up - started:.0f} s")
            yield 0.1

    def _settle(self) -> Script:
        """Wait for confirmed positions of all homed stages; a position out of range makes its stage not homed."""
        units = self._units
        give_up = self.now + 2.0
        while not all(units.estimate(i).known for i in range(len(units.setups)) if units.homed[i]):
            if self.now > give_up:
                moving = next(i for i in range(len(units.setups)) if units.homed[i] and not units.estimate(i).known)
                raise ZaberError(f"{units.name(moving)} does not stop: its position changes")
            yield 0.02
        for i, setup in enumerate(units.setups):
            count = units.estimate(i).position
            if units.homed[i] and not 0 <= count <= setup.maximum:
                units.homed[i] = False  # another program has homed the unit and set another count

    def _read_twice(self, i: int, command: int, data: int = 0) -> Generator[Request | float, Any, int | None]:
        """Return a value that the unit has sent twice; None if the unit does not answer or does not have the value."""
        reply = data if command == ZaberCommand.SETTING else command
        received: set[Reply] = set()
        for _ in range(MAX_ATTEMPTS):
            answer: Reply = yield Request(i, command, data, reply)
            if answer.error is not None:
                self._refusal = answer.error  # the error may belong to the previous setting
            if answer in received and (answer.data is not None or answer.error == Code.UNKNOWN_COMMAND):
                return answer.data
            received.add(answer)
        return None

    def _need(self, i: int, setting: int) -> Generator[Request | float, Any, int]:
        value = yield from self._read_twice(i, ZaberCommand.SETTING, setting)
        if value is None:
            raise ZaberError(f"{self._units.name(i)} does not report its setting {setting}")
        return value

    def _set(self, i: int, command: int, data: int) -> Script:
        """Write a setting, unless it has this value already, and read it back."""
        value = yield from self._need(i, command)
        for _ in range(3):
            if value == data:
                return
            self._refusal = None
            yield Request(i, command, data)
            value = yield from self._need(i, command)
        why = f" ({error_text(self._refusal)})" if self._refusal else ""
        what = ZaberCommand(command).name.lower().replace("_", " ")
        raise ZaberError(f"{self._units.name(i)}: {what} stays {value} and does not become {data}{why}")
