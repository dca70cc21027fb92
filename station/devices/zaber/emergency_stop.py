"""The last resort: stop the stages without the control process, straight through their ports.

A port may be a dying process's for some milliseconds more, and half a message may have been on its way: so
it is opened until it opens, and the units are told, and asked what they do, until each of them says that it stops.
A unit that homes obeys no stop: it is reset, as the driver does it, and has to be homed again.
"""

from collections import Counter
from collections.abc import Mapping, Set
from functools import partial
from typing import Any

from station.config.robots import RobotFile
from station.devices.interfaces import Clock, EmergencyStop, NotStopped
from station.devices.links.link import LinkError, SerialLink
from station.devices.links.port_lock import lock_file
from station.devices.zaber.chain import Line
from station.devices.zaber.protocol import BAUD, GAP, MESSAGE_TIME, Command, Message, Parser, Status, encode
from station.devices.zaber.shifts import IGNORED

#: Device number 0 addresses every unit of a chain; a status is told whatever the units' mode says.
STOP, ASK = encode(Message(0, Command.STOP, IGNORED)), encode(Message(0, Command.STATUS, IGNORED))
#: How long a port is tried, and how much longer once a unit of it had to be reset [s].
PATIENCE = 2.0
#: Stops that a homing unit may ignore, and how long it is deaf after a reset.
TRIES, RESTART = Line.stop_tries, Line.restart
#: Units that lost the frame find it in a pause; then they are told again, so often until they answer [s].
AGAIN = MESSAGE_TIME + 1.5 * GAP
ANSWER = 0.12
#: A port whose units say nothing for so long is opened anew: perhaps it was still somebody else's [s].
SILENT = 0.2
AT_REST = (Status.IDLE, Status.STOPPING)
STATUSES = frozenset(int(status) for status in Status)


#: Numbers of the units on each port.
Units = Mapping[str, Set[int]]


def zaber_emergency_stop(options: Mapping[str, Any], robot: RobotFile) -> EmergencyStop:
    """That of the chains in `[devices.stages]`."""
    units = stage_units(options, len(robot.joints))
    for port in units:
        lock_file(port)  # it finds the folder for temporary files now, by writing there
    return partial(stop_stages, units)


def stage_units(options: Mapping[str, Any], joints: int) -> Units:
    """The units that `[devices.stages]` names, for so many joints."""
    found: dict[str, set[int]] = {}
    stages: Any = options.get("joints") or {number: {"device": number} for number in range(1, joints + 1)}
    for stage in stages.values():
        found.setdefault(stage.get("port") or options["port"], set()).add(stage["device"])
    return found


def stop_stages(units: Units, clock: Clock, patience: float = PATIENCE) -> str:
    """Tell these units to stop: what came of it, in words, and how long it took.

    Every port is tried, whatever becomes of the others.

    Raises:
        NotStopped: a unit has not said that it stops.
    """
    begin = clock.now()
    stopping = [_Port(name, numbers, begin, begin + patience) for name, numbers in units.items()]
    while any(not port.done and clock.now() < port.give_up for port in stopping):
        for port in stopping:
            port.go_on(clock.now())
        clock.sleep(0.002)
    for port in stopping:
        port.close()
    said = "; ".join(port.said() for port in stopping)
    if not all(port.done for port in stopping):
        raise NotStopped(said)
    return said


class _Port:
    """One port on its way to a stop."""

    def __init__(self, name: str, units: Set[int], begin: float, give_up: float) -> None:
        self.done, self.give_up = False, give_up
        self._name, self._units, self._begin = name, units, begin
        self._link: SerialLink | None = None
        self._problem = ""
        self._told = 0.0  # how long it took until the units were told first [s]
        self._next = self._heard = begin
        self._statuses: dict[int, int] = {}
        self._ignored = Counter[int]()  # stops, by units that home
        self._reset: set[int] = set()

    def go_on(self, now: float) -> None:
        if self.done:
            return
        try:
            if self._link is None:
                self._link = SerialLink(self._name, BAUD)
                self._link.write(STOP)
                self._parser = Parser(_plausible, GAP)
                self._told = self._told or now - self._begin
                self._heard = now
                self._statuses.clear()
                self._next = now + AGAIN
                return
            for message in self._parser.feed(self._link.read(), now, now):
                self._heard = now
                if message.command == Command.STATUS:
                    self._statuses[message.device] = message.data
                    self._ignored[message.device] += message.data == Status.HOMING
            if self._stopping >= self._units:
                self.done = True
            elif now >= self._next:
                self._link.write(self._resets(now) or STOP + ASK)
                self._next = max(self._next, now) + ANSWER
            if not self._statuses and now - self._heard > SILENT:
                self.close()
        except (LinkError, OSError) as error:
            self._problem = str(error)
            self.close()

    def _resets(self, now: float) -> bytes:
        """For units that go on homing; they say nothing for a while then."""
        homing = [unit for unit, count in self._ignored.items() if count >= TRIES and unit in self._units]
        for unit in homing:
            del self._ignored[unit]
            self._statuses.pop(unit, None)
        if homing:
            self._reset |= set(homing)
            self._next = self._heard = now + RESTART
            self.give_up = max(self.give_up, now + RESTART + PATIENCE)
        return b"".join(encode(Message(unit, Command.RESET, IGNORED)) for unit in homing)

    @property
    def _stopping(self) -> set[int]:
        """Units that have said last that they do."""
        return {unit for unit, status in self._statuses.items() if status in AT_REST}

    def close(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None

    def said(self) -> str:
        stages = f"{len(self._units)} stages on {self._name}"
        if self.done:
            told = f"told {1e3 * self._told:.0f} ms after it was noticed"
            reset = f"; number {_listed(self._reset)} homed and was reset: home again" if self._reset else ""
            return f"{stages} stop, {told}{reset}"
        if self._told and self._statuses:
            silent = _listed(self._units - self._stopping)
            return f"of {stages} number {silent} was told to stop and does not say so: press the emergency stop"
        if self._told:
            return f"the stages on {self._name} were told to stop and do not answer: press the emergency stop"
        return f"the stages on {self._name} cannot be told to stop ({self._problem}): press the emergency stop"


def _listed(units: Set[int]) -> str:
    return ", ".join(str(unit) for unit in sorted(units))


def _plausible(message: Message) -> bool:
    """What a unit may say meanwhile."""
    if message.command == Command.STATUS:
        return message.data in STATUSES
    return message.command in (Command.STOP, Command.MOVE_SPEED, Command.LIMIT_ACTIVE, Command.POSITION, Command.ERROR)
