"""Scripts that identify, set up and home Zaber units; `kernel/stages.py` runs them.

The scripts read every setting back, because the units' automatic replies are switched off.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from station.devices.kernel.line import no_answer
from station.devices.kernel.setting import Setting
from station.devices.kernel.stages import AxisFault, Port
from station.devices.kernel.startup import Axes, Script, Value
from station.devices.zaber.chain import Axis, LineSettings, ZaberChain
from station.devices.zaber.protocol import (
    BAUD,
    FIRST_ALIAS,
    MAX_POSITION,
    MICROSTEP_RESOLUTION,
    Code,
    Mode,
    Reply,
    Request,
    ResetDone,
    UnsolicitedError,
    ZaberCommand,
    ZaberError,
    ZaberMessage,
    ZaberStatus,
    alias_number,
    encode,
    error_text,
)
from station.devices.zaber.setup import StageSetup


class Identity(NamedTuple):
    """Identity that a unit reports."""

    device_id: int
    firmware: int  #: firmware version with two implied decimals: 523 is 5.23
    serial: int | None  #: serial number; None for old units, which have none


#: Maximum position of a unit whose homing has not been completed [microsteps]. A unit sets its flag HOMED before it has
#: turned back, and the flags of the units that home later are still set.
UNFINISHED = MAX_POSITION - 1
#: Settings that a unit keeps without power. Each is read, set and read back.
SETTINGS = {
    ZaberCommand.SET_MODE: Setting(
        "mode", "bits of replies, knob and homing (0: no automatic reply, 3: no knob, 7: homed)", "set"
    ),
    ZaberCommand.SET_RESOLUTION: Setting("resolution", "microsteps per step; a change loses the position"),
    ZaberCommand.SET_HOME_OFFSET: Setting("home offset", "count at the home sensor"),
    ZaberCommand.SET_ALIAS: Setting("alias", "second device number, used while positions are polled"),
    ZaberCommand.SET_ACCELERATION: Setting("acceleration", "braking distances assume at least it"),
    ZaberCommand.SET_HOME_SPEED: Setting("home speed", "speed towards the home sensor"),
    ZaberCommand.SET_MAXIMUM: Setting("maximum position", "end of the travel, and mark of an unfinished homing"),
}
MAX_ATTEMPTS = 6  #: largest number of times that a query is sent until two replies agree
MAX_COMPLAINTS = 10  #: number of unsolicited errors of a unit that are kept


class ZaberProtocol:
    """Zaber T-series units on one chain or on several."""

    def __init__(self, setups: Sequence[StageSetup], settings: LineSettings | None = None) -> None:
        self.axes, self._settings = Axes(setups), settings or LineSettings()
        self._complaints: list[list[str]] = [[] for _ in setups]  # errors that units reported without a request
        self._homing_distance = [0.0 for _ in setups]  # distance moved since an unfinished homing began [rad or m]
        self._chains: list[ZaberChain] = []
        self._where: dict[int, tuple[ZaberChain, int]] = {}
        self._refusal: int | None = None  # error code of the last error reply

    def session(self, ports: Sequence[Port], *, again: bool) -> Sequence[ZaberChain]:
        """Start a new session; after an earlier one all axes stop, and no confirmation is awaited.

        Raises:
            ZaberError: two units of a chain have one number, or a unit has the number of an alias.
        """
        self._chains = []
        for link, stages in ports:
            setups = [self.axes.setups[i] for i in stages]
            axes = [Axis(s.device, s.top, s.acceleration, s.maximum, alias_number(k)) for k, s in enumerate(setups)]
            if len({axis.device for axis in axes}) < len(axes):
                raise ZaberError(f"two stages on {link.name} have the same device number; renumber the chain")
            if any(axis.device >= FIRST_ALIAS for axis in axes):
                raise ZaberError(
                    f"a stage on {link.name} has a device number beyond {FIRST_ALIAS - 1}; from {FIRST_ALIAS} on "
                    "numbers are used as aliases: renumber the chain"
                )
            chain = ZaberChain(axes, self._settings)
            self._chains.append(chain)
            self._where |= {i: (chain, k) for k, i in enumerate(stages)}
            if again:
                chain.send_stops()
        return self._chains

    def happened(self, i: int, event: Any, connected: bool) -> AxisFault | None:  # noqa: ARG002 - not needed
        """Process an event of a unit, and return the fault that it means."""
        match event:
            case UnsolicitedError(_, code):
                self._complaints[i] = [*self._complaints[i][1 - MAX_COMPLAINTS :], error_text(code)]
            case ResetDone():
                self.axes.must_home(i)
                self.axes.estimates[i].forget()
        return None

    def warning(self, i: int) -> str:  # noqa: ARG002 - units report no warnings
        """Return an empty text, because units report no warnings."""
        return ""

    def address(self, i: int) -> str:
        """Return the device number of a unit, for the details of messages."""
        return f"device {self.axes.setups[i].device}"

    def details(self, i: int) -> Mapping[str, Any]:
        """Return number and errors of a unit."""
        chain, _ = self._where[i]
        lost, complaints = chain.parser.dropped.count, list(self._complaints[i])
        return {"device": self.axes.setups[i].device, "lost_bytes": lost, "complaints": complaints}

    def connect(self) -> Script:
        """Identify and set up every unit, then wait for the positions of all homed stages."""
        for i, setup in enumerate(self.axes.setups):
            yield from self._identify(i)
            mode = yield from self._need(i, ZaberCommand.SET_MODE)
            resolution = yield from self._need(i, ZaberCommand.SET_RESOLUTION)
            if resolution != MICROSTEP_RESOLUTION:
                mode &= ~Mode.HOMED  # a position counted with another microstep size is invalid
            # Unrequested positions and a turned knob would invalidate the estimate, which uses the velocities sent.
            mode = (mode | Mode.NO_AUTO_REPLY | Mode.NO_KNOB) & ~(Mode.MOVE_TRACKING | Mode.MESSAGE_IDS)
            finished = (yield from self._need(i, ZaberCommand.SET_MAXIMUM)) != UNFINISHED
            chain, axis = self._where[i]
            for command, data in (
                (ZaberCommand.SET_MODE, mode),
                (ZaberCommand.SET_RESOLUTION, MICROSTEP_RESOLUTION),
                (ZaberCommand.SET_HOME_OFFSET, 0),
                (ZaberCommand.SET_ALIAS, chain.units[axis].alias or 0),
                (ZaberCommand.SET_ACCELERATION, setup.acceleration),
                (ZaberCommand.SET_HOME_SPEED, setup.home_units),
                (ZaberCommand.SET_MAXIMUM, setup.maximum if finished else UNFINISHED),
            ):
                found = yield from self._set(i, command, data)
                self.axes.record(i, SETTINGS[command], found, data)
            self.axes.homed[i] = bool(mode & Mode.HOMED) and finished and i not in self.axes.home_again
            self.axes.estimates[i].forget()
        for chain in self._chains:
            chain.polling = True
            # A unit that is not homed may still execute a velocity of an earlier session, because `settle` waits for
            # the rest of homed units only.
            if not all(homed for i, homed in enumerate(self.axes.homed) if self._where[i][0] is chain):
                chain.stop()
        yield from self.axes.stopped(self._stopping)
        yield from self.axes.settle()

    def home(self) -> Script:
        """Home every unit."""
        yield from self.axes.home_at_rest(self, self._stopping)

    def mark(self, i: int, *, finished: bool) -> Script:
        """Mark a unit as homed, or not, by its maximum position."""
        setup = self.axes.setups[i]
        if finished:
            self._homing_distance[i] = 0.0
            if setup.home_count:
                yield from self._set(i, ZaberCommand.SET_POSITION, setup.home_count)
        yield from self._set(i, ZaberCommand.SET_MAXIMUM, setup.maximum if finished else UNFINISHED)

    def seek(self, i: int, give_up: float) -> Value[float]:
        """Move a unit to its home sensor, and return how far it moved [rad or m], computed from the time."""
        mode = yield from self._need(i, ZaberCommand.SET_MODE)
        # The flag is cleared before the homing, so that a set flag proves a completed homing.
        yield from self._set(i, ZaberCommand.SET_MODE, mode & ~Mode.HOMED)
        for _ in range(3):
            started = self.axes.now
            try:
                yield Request(i, ZaberCommand.HOME)
                yield from self._rest(i, give_up, "homing")
            finally:
                self._homing_distance[i] += (self.axes.now - started) * self.axes.setups[i].home_speed
            if (yield from self._need(i, ZaberCommand.SET_MODE)) & Mode.HOMED:
                return self._homing_distance[i]
        raise ZaberError(f"{self.axes.name(i)} stopped without reaching its home sensor; is it free to move?")

    def turn_back(self, i: int, give_up: float) -> Script:
        """Turn a rotation up by one turn; the unit counts zero at its sensor, so its count is then one turn."""
        setup = self.axes.setups[i]
        turn = round(2.0 * math.pi / setup.joint.microstep)
        yield from self._set(i, ZaberCommand.SET_SPEED, setup.home_units)
        yield Request(i, ZaberCommand.MOVE_RELATIVE, turn)
        yield from self._rest(i, give_up, "turning back to its zero")
        position = yield from self._read_twice(i, ZaberCommand.POSITION)
        if position != turn:
            raise ZaberError(
                f"{self.axes.name(i)} is at {position} microsteps after turning back to its zero, not at {turn}"
            )

    def _identify(self, i: int) -> Script:
        setup, name = self.axes.setups[i], self.axes.name(i)
        self._where[i][0].parser.dropped.last = b""
        device_id = yield from self.axes.first_answer(name, lambda: self._read_twice(i, ZaberCommand.DEVICE_ID))
        if not device_id:  # the ID 0 is an echo of the query
            check = f"is it powered, plugged in, set to {BAUD} baud and binary, and numbered {setup.device}?"
            echo = encode(ZaberMessage(setup.device, ZaberCommand.DEVICE_ID, 0))
            unread = self._where[i][0].parser.unread if device_id is None else echo
            raise ZaberError(no_answer(name, unread, "messages of 6 bytes that begin with its number", check))
        firmware = yield from self._read_twice(i, ZaberCommand.FIRMWARE)
        if firmware is None or not 500 <= firmware < 600:
            found = "reports no firmware version" if firmware is None else f"has firmware {firmware / 100:.2f}"
            raise ZaberError(f"{name} {found}; 5.00 ... 5.99 is supported")
        serial = yield from self._read_twice(i, ZaberCommand.SERIAL_NUMBER)
        expected = {"device_id": setup.device_id, "serial": setup.serial}
        self.axes.identify(i, Identity(device_id, firmware, serial), expected)

    def _stopping(self) -> Sequence[int]:
        return [i for i, (chain, axis) in self._where.items() if axis in chain.axes.stopping]

    def _rest(self, i: int, give_up: float, what: str) -> Script:
        """Wait until a unit is idle; raise ZaberError at the time `give_up` [s]. `what` describes the motion."""
        started = self.axes.now
        yield 0.05
        while (yield from self._read_twice(i, ZaberCommand.STATUS)) not in (ZaberStatus.IDLE, None):
            if self.axes.now > give_up:
                raise ZaberError(f"{self.axes.name(i)} has been {what} for more than {give_up - started:.0f} s")
            yield 0.1

    def _read_twice(self, i: int, command: int, data: int = 0) -> Value[int | None]:
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

    def _need(self, i: int, setting: int) -> Value[int]:
        value = yield from self._read_twice(i, ZaberCommand.SETTING, setting)
        if value is None:
            raise ZaberError(f"{self.axes.name(i)} does not report its setting {setting}")
        return value

    def _set(self, i: int, command: int, data: int) -> Value[int]:
        """Write a setting and read it back, unless it has this value already; return the value before."""
        found = value = yield from self._need(i, command)
        for _ in range(3):
            if value == data:
                return found
            self._refusal = None
            yield Request(i, command, data)
            value = yield from self._need(i, command)
        why = f" ({error_text(self._refusal)})" if self._refusal else ""
        what = ZaberCommand(command).name.lower().replace("_", " ")
        raise ZaberError(f"{self.axes.name(i)}: {what} stays {value} and does not become {data}{why}")
