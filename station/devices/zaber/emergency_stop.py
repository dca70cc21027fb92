"""Emergency stop of Zaber stages without the control process, directly through their ports.

A dying control process may keep a port open for some milliseconds, and may have sent half a message. So this module
retries to open the port. Then it sends stop commands and status queries until each unit reports that it stops.
A homing unit ignores a stop: this module resets such a unit, as the driver does, and the unit has to be homed again.
"""

from collections import Counter
from collections.abc import Mapping, Set

from station.devices.interfaces import Clock, NotStopped
from station.devices.links.link import LinkError, SerialLink
from station.devices.zaber.chain import RESTART_S, STATUSES, STOP_ATTEMPTS
from station.devices.zaber.protocol import (
    BAUD,
    MESSAGE_TIME_S,
    NO_DATA,
    RESYNC_GAP_S,
    ZaberCommand,
    ZaberMessage,
    ZaberParser,
    ZaberStatus,
    encode,
)

#: Messages with device number 0, which addresses every unit of a chain. Units report their status in every device mode.
STOP_BYTES, STATUS_REQUEST_BYTES = (
    encode(ZaberMessage(0, ZaberCommand.STOP, NO_DATA)),
    encode(ZaberMessage(0, ZaberCommand.STATUS, NO_DATA)),
)
#: Time limit for the stop of one port; the same time is available again after the reset of a unit [s].
PORT_TIMEOUT_S = 2.0
#: Time from the first stop to the second [s]; its pause resynchronises units that have lost the message boundaries.
REPEAT_INTERVAL_S = MESSAGE_TIME_S + 1.5 * RESYNC_GAP_S
REPLY_TIMEOUT_S = 0.12  #: interval at which stop and status query are repeated after the second stop [s]
#: A port is opened again after this silence of its units, because another process may still have used the port [s].
SILENCE_TIMEOUT_S = 0.2
REST_STATUSES = (ZaberStatus.IDLE, ZaberStatus.STOPPING)


#: Device numbers of the units on each port, by port name.
Units = Mapping[str, Set[int]]


def stop_stages(units: Units, clock: Clock, patience: float = PORT_TIMEOUT_S) -> str:
    """Stop all `units`, and return a human-readable result with the time until the first stop command.

    The stop is attempted on every port, even if it fails on others. `patience` is the time limit of each port [s].

    Raises:
        NotStopped: a unit has not confirmed its stop.
    """
    start = clock.now()
    stopping = [_Port(name, numbers, start, start + patience) for name, numbers in units.items()]
    while any(not port.done and clock.now() < port.give_up for port in stopping):
        for port in stopping:
            port.advance(clock.now())
        clock.sleep(0.002)
    for port in stopping:
        port.close()
    result = "; ".join(port.result() for port in stopping)
    if not all(port.done for port in stopping):
        raise NotStopped(result)
    return result


class _Port:
    """Stop sequence of one port."""

    def __init__(self, name: str, units: Set[int], start: float, give_up: float) -> None:
        self.done, self.give_up = False, give_up
        self._name, self._units, self._start = name, units, start
        self._link: SerialLink | None = None
        self._problem = ""
        self._sent_after = 0.0  # time until the first stop command [s]
        self._next = self._received = start
        self._statuses: dict[int, int] = {}
        self._ignored = Counter[int]()  # number of stops that each unit has ignored while it homes
        self._reset: set[int] = set()

    def advance(self, now: float) -> None:
        if self.done:
            return
        try:
            if self._link is None:
                self._link = SerialLink(self._name, BAUD)
                self._link.write(STOP_BYTES)
                self._parser = ZaberParser(_plausible, RESYNC_GAP_S)
                self._sent_after = self._sent_after or now - self._start
                self._received = now
                self._statuses.clear()
                self._next = now + REPEAT_INTERVAL_S
                return
            for message in self._parser.feed(self._link.read(), now, now):
                self._received = now
                if message.command == ZaberCommand.STATUS:
                    self._statuses[message.device] = message.data
                    self._ignored[message.device] += message.data == ZaberStatus.HOMING
            if self._stopping >= self._units:
                self.done = True
            elif now >= self._next:
                self._link.write(self._resets(now) or STOP_BYTES + STATUS_REQUEST_BYTES)
                self._next = max(self._next, now) + REPLY_TIMEOUT_S
            if not self._statuses and now - self._received > SILENCE_TIMEOUT_S:
                self.close()
        except (LinkError, OSError) as error:
            self._problem = str(error)
            self.close()

    def _resets(self, now: float) -> bytes:
        """Return reset messages for units that continue to home, and wait for these units to restart."""
        homing = [unit for unit, count in self._ignored.items() if count >= STOP_ATTEMPTS and unit in self._units]
        for unit in homing:
            del self._ignored[unit]
            self._statuses.pop(unit, None)
        if homing:
            self._reset |= set(homing)
            self._next = self._received = now + RESTART_S
            self.give_up = max(self.give_up, now + RESTART_S + PORT_TIMEOUT_S)
        return b"".join(encode(ZaberMessage(unit, ZaberCommand.RESET, NO_DATA)) for unit in homing)

    @property
    def _stopping(self) -> set[int]:
        """Units whose last status is stopping or idle."""
        return {unit for unit, status in self._statuses.items() if status in REST_STATUSES}

    def close(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None

    def result(self) -> str:
        stages = f"{len(self._units)} stages on {self._name}"
        if self.done:
            sent = f"commanded {1e3 * self._sent_after:.0f} ms after the emergency stop started"
            reset = f"; number {_list_units(self._reset)} homed and was reset: home again" if self._reset else ""
            return f"{stages} stop, {sent}{reset}"
        if self._sent_after and self._statuses:
            silent = _list_units(self._units - self._stopping)
            return f"{stages}: number {silent} was commanded to stop and has not confirmed: press the emergency stop"
        if self._sent_after:
            return f"the stages on {self._name} were commanded to stop and do not answer: press the emergency stop"
        return f"the stages on {self._name} cannot be commanded to stop ({self._problem}): press the emergency stop"


def _list_units(units: Set[int]) -> str:
    return ", ".join(str(unit) for unit in sorted(units))


def _plausible(message: ZaberMessage) -> bool:
    """Return whether a unit can send this message while it is being stopped."""
    if message.command == ZaberCommand.STATUS:
        return message.data in STATUSES
    return message.command in (
        ZaberCommand.STOP,
        ZaberCommand.MOVE_SPEED,
        ZaberCommand.LIMIT_ACTIVE,
        ZaberCommand.POSITION,
        ZaberCommand.ERROR,
    )
