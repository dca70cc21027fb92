"""Connecting and homing Zaber units: sequences of questions and settings, one at a time.

Somebody else carries them on: a sequence yields what it asks or how long it waits, and is sent the answer.
They rely on readings only, since the units' automatic replies are switched off: every setting is read back.
"""

import math
from collections.abc import Generator

from station.devices.zaber.dialogue import Answer, Ask
from station.devices.zaber.homing import Homing, leg
from station.devices.zaber.protocol import RESOLUTION, Code, Command, Mode, Status, ZaberError, error_text
from station.devices.zaber.units import Identity, Units

TRIES = 6  #: of a question until two answers agree

Script = Generator[Ask | float, Answer, None]  #: asks, or waits so many seconds


class Sequences:
    """The sequences of these units; each raises `ZaberError` out of its generator where it cannot go on."""

    def __init__(self, units: Units) -> None:
        self.now = -math.inf  #: time [s], kept up by who carries a sequence on
        self._units = units
        self.homing: Homing | None = None  #: how far it has come; of use while it is on
        self._refusal: int | None = None  # the last error reply of a sequence

    def connect(self) -> Script:
        """Identify and set up every unit, then wait for its position."""
        units = self._units
        for i, setup in enumerate(units.setups):
            name = units.name(i)
            device_id = yield from self._read_twice(i, Command.DEVICE_ID)
            if device_id is None:
                raise ZaberError(f"{name} does not answer; is it powered, plugged in and numbered {setup.device}?")
            firmware = yield from self._read_twice(i, Command.FIRMWARE)
            if firmware is None or not 500 <= firmware < 600:
                raise ZaberError(
                    f"{name} has firmware {(firmware or 0) / 100:.2f}; 5.00 ... 5.99 is what is understood"
                )
            serial = yield from self._read_twice(i, Command.SERIAL_NUMBER)
            found, before = Identity(device_id, firmware, serial), units.identities[i]
            for what, value, expected in (
                ("device ID", device_id, setup.device_id if before is None else before.device_id),
                ("serial number", serial, setup.serial if before is None else before.serial),
            ):
                if expected is not None and value != expected:
                    raise ZaberError(f"{name} has {what} {value}; {expected} is expected there: another unit?")
            mode = yield from self._need(i, Command.SET_MODE)
            resolution = yield from self._need(i, Command.SET_RESOLUTION)
            if resolution != RESOLUTION:
                mode &= ~Mode.HOMED  # what was counted in other steps means nothing
            # Positions that nobody asked for and a turned knob would upset the count of what was sent.
            mode = (mode | Mode.NO_AUTO_REPLY | Mode.NO_KNOB) & ~(Mode.MOVE_TRACKING | Mode.MESSAGE_IDS)
            for command, data in (
                (Command.SET_MODE, mode),
                (Command.SET_RESOLUTION, RESOLUTION),
                (Command.SET_HOME_OFFSET, 0),
                (Command.SET_ALIAS, units.alias(i)),
                (Command.SET_ACCELERATION, setup.acceleration),
                (Command.SET_HOME_SPEED, setup.home_units),
                (Command.SET_MAXIMUM, setup.maximum),
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
        order = sorted(range(len(units.setups)), key=lambda i: units.setups[i].joint.motion != "translation")
        self.homing = Homing([leg(units.setups[i], self._count(i)) for i in order])
        for number, i in enumerate(order):
            setup, name = units.setups[i], units.name(i)
            self.homing.begin(number, self.now)
            units.homed[i] = False
            units.estimate(i).forget(adrift=True)
            mode = yield from self._need(i, Command.SET_MODE)
            # The flag is taken away first, so that it is evidence afterwards.
            yield from self._set(i, Command.SET_MODE, mode & ~Mode.HOMED)
            reach = max(setup.maximum * setup.joint.microstep, 2.0 * math.pi) / setup.home_speed
            give_up = self.now + 2.0 * reach + 10.0
            for _ in range(3):
                begun = self.now
                try:
                    yield Ask(i, Command.HOME)
                    yield from self._rest(i, give_up, "homing")
                finally:
                    units.way_home[i] += (self.now - begun) * setup.home_speed
                mode = yield from self._need(i, Command.SET_MODE)
                if mode & Mode.HOMED:
                    break
            else:
                raise ZaberError(f"{name} came to rest without having found its home sensor; is it free to move?")
            if setup.joint.motion == "rotation" and units.way_home[i] > math.pi:
                yield from self._turn_back(i)
            units.way_home[i] = 0.0
            if setup.home_count:
                yield from self._set(i, Command.SET_POSITION, setup.home_count)
            units.estimate(i).forget()
            units.homed[i] = True
            units.home_again.discard(i)
        yield from self._settle()

    def _count(self, i: int) -> float | None:
        """Where a stage is [microsteps]; None where nobody knows."""
        estimate = self._units.estimate(i)
        return estimate.position if self._units.homed[i] and estimate.known else None

    def _turn_back(self, i: int) -> Script:
        """Turn a stage that homed a turn too low up to its zero, at the speed of homing.

        It meets its sensor once a turn on the way down. One that began within half a turn of its zero and went more
        than half a turn to a sensor began below zero.
        """
        setup, name = self._units.setups[i], self._units.name(i)
        turn = round(2.0 * math.pi / setup.joint.microstep)
        yield from self._set(i, Command.SET_SPEED, setup.home_units)
        yield from self._set(i, Command.SET_MAXIMUM, max(turn, setup.maximum))
        yield Ask(i, Command.MOVE_RELATIVE, turn)
        seconds = 2.0 * math.pi / setup.home_speed
        yield from self._rest(i, self.now + 2.0 * seconds + 10.0, "turning back to its zero")
        place = yield from self._read_twice(i, Command.POSITION)
        yield from self._set(i, Command.SET_MAXIMUM, setup.maximum)
        if place != turn:
            raise ZaberError(f"{name} stands at {place} microsteps after turning back to its zero, not at {turn}")

    def _rest(self, i: int, give_up: float, what: str) -> Script:
        """Wait until a unit is idle."""
        begun = self.now
        yield 0.05
        while (yield from self._read_twice(i, Command.STATUS)) not in (Status.IDLE, None):
            if self.now > give_up:
                raise ZaberError(f"{self._units.name(i)} has been {what} for more than {give_up - begun:.0f} s")
            yield 0.1

    def _settle(self) -> Script:
        """Wait for positions that are sure, where they mean something."""
        units = self._units
        give_up = self.now + 2.0
        while not all(units.estimate(i).known for i in range(len(units.setups)) if units.homed[i]):
            if self.now > give_up:
                moving = next(i for i in range(len(units.setups)) if units.homed[i] and not units.estimate(i).known)
                raise ZaberError(f"{units.name(moving)} does not come to rest: its position changes")
            yield 0.02
        for i, setup in enumerate(units.setups):
            count = units.estimate(i).position
            if units.homed[i] and not 0 <= count <= setup.maximum:
                units.homed[i] = False  # homed by another program, with another count

    def _read_twice(self, i: int, command: int, data: int = 0) -> Generator[Ask | float, Answer, int | None]:
        """A reading that came twice; None where the unit does not answer, or has no such thing."""
        reply = data if command == Command.SETTING else command
        seen: set[Answer] = set()
        for _ in range(TRIES):
            answer = yield Ask(i, command, data, reply)
            if answer.error is not None:
                self._refusal = answer.error  # perhaps of the setting before
            if answer in seen and (answer.data is not None or answer.error == Code.UNKNOWN_COMMAND):
                return answer.data
            seen.add(answer)
        return None

    def _need(self, i: int, setting: int) -> Generator[Ask | float, Answer, int]:
        value = yield from self._read_twice(i, Command.SETTING, setting)
        if value is None:
            raise ZaberError(f"{self._units.name(i)} does not tell its setting {setting}")
        return value

    def _set(self, i: int, command: int, data: int) -> Script:
        """Set what differs, and read it back."""
        value = yield from self._need(i, command)
        for _ in range(3):
            if value == data:
                return
            self._refusal = None
            yield Ask(i, command, data)
            value = yield from self._need(i, command)
        why = f" ({error_text(self._refusal)})" if self._refusal else ""
        what = Command(command).name.lower().replace("_", " ")
        raise ZaberError(f"{self._units.name(i)}: {what} stays {value} and does not become {data}{why}")
