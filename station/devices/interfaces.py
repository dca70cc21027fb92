"""What the control loop asks of devices: polled at every tick, never waited for.

A device answers with what has arrived by `now`; a driver on a serial port, a socket or a simulated
bench fits behind the same few methods. Only opening a device may raise; from then on a
device says what is wrong through `trouble`, and the loop acts on its severity.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any, NamedTuple, Protocol

from core.errors import CtrError
from core.robot.robot import Array


class Condition(StrEnum):
    """How far a device has come."""

    CLOSED = "closed"
    CONNECTING = "connecting"
    HOMING = "homing"  #: stages only
    CONNECTED = "connected"
    FAULT = "fault"  #: until somebody connects it again


class Severity(IntEnum):
    """What a trouble asks of the station; the worst wins."""

    WARN = 1  #: said, nothing else
    HOLD = 2  #: a motion ends where it is
    STOP = 3
    FAULT = 4  #: every axis that can be reached is stopped; latched until a person resets it


class Trouble(NamedTuple):
    """What is wrong with a device."""

    severity: Severity
    text: str  #: what, where, and what to do about it


class JointReading(NamedTuple):
    """Positions of the stages."""

    positions: Array  #: (n,) [rad or m]; NaN for a stage that has never answered
    sent: Array  #: (n,) velocities that really went out, after limits and quantisation [rad/s or m/s]


class TipReading(NamedTuple):
    """One tracker frame, fit for control."""

    frame: int  #: the tracker's own count
    time: float  #: when it was measured, by the frame number, not by its arrival [s]
    position: Array  #: (3,) world frame [m]
    target: Array | None = None  #: (3,) of a target with a coil of its own, in the same frame [m]; None: not seen
    direction: Array | None = None  #: (3,) in which the tip points, unit vector; None: the tracker does not tell


class WrenchReading(NamedTuple):
    """One sample of every base sensor."""

    time: float  #: [s]
    wrenches: Array  #: (q, 6) force and moment in each sensor's own axes, untared [N, N m]
    usable: bool = True  #: False: some sensor has nothing fit for control; its last good wrench stands


class Truth(NamedTuple):
    """What only a virtual lab knows: for the record, never for the controller."""

    tip: Array  #: (3,) [m]
    force: Array  #: (3,) at the tip [N]
    target: Array | None = None  #: (3,) what moves and may be followed [m]; None: there is nothing
    direction: Array | None = None  #: (3,) in which the tip points, unit vector; None: nobody looks


class Device(Protocol):
    """What all kinds have in common."""

    @property
    def condition(self) -> Condition:
        """How far it has come."""
        ...

    def connect(self, now: float) -> None:
        """Begin to connect; `poll` carries it on until `condition` is CONNECTED or FAULT. Also after a FAULT."""
        ...

    def trouble(self, now: float) -> Trouble | None:
        """What is wrong at `now` [s], the worst of it; None if nothing is. Cheap: asked at every tick."""
        ...

    def details(self) -> Mapping[str, Any]:
        """Who it is and what it has counted, as plain numbers and texts for a person and for the report."""
        ...

    def close(self) -> None:
        """Let go of its ports."""
        ...


class Stages(Device, Protocol):
    """Motors that turn and slide the tubes."""

    @property
    def ready(self) -> bool:
        """Connected, homed, and every position is known."""
        ...

    def home(self, now: float) -> None:
        """Begin to home every stage; `poll` carries it on while `condition` is HOMING.

        Raises:
            CtrError: not connected, or busy.
        """
        ...

    def poll(self, now: float) -> JointReading:
        """Positions at `now` [s]."""
        ...

    def command(self, velocities: Array, now: float) -> None:
        """Ask for joint velocities (n,) [rad/s or m/s]; the latest wins. Not heeded unless `ready`."""
        ...

    def stop(self, now: float) -> None:
        """Stop every axis that can be reached, ahead of whatever waits to be sent."""
        ...


class Clock(Protocol):
    """The station's time."""

    def now(self) -> float:
        """[s]."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let so much of it pass."""
        ...


class NotStopped(CtrError):
    """Stages that have not said that they stop: which of them, why, and what a person has to do."""


#: Stops every stage from another process than the one that drives them, whose ports may still be held for some
#: milliseconds by what is left of it. Says in words what came of it; raises NotStopped unless every axis has said
#: that it stops.
EmergencyStop = Callable[[Clock], str]


class Tracker(Device, Protocol):
    """Measures where the tip is."""

    def poll(self, now: float) -> TipReading | None:
        """The newest good frame that arrived since the last poll, if any."""
        ...


class BaseSensors(Device, Protocol):
    """Six-axis sensors at the tubes' proximal ends."""

    def poll(self, now: float) -> WrenchReading:
        """The newest sample."""
        ...


@dataclass(frozen=True)
class Devices:
    """The bench as the control loop sees it."""

    stages: Stages
    tracker: Tracker
    sensors: BaseSensors
