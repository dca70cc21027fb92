"""Interfaces of the device drivers: the control loop polls the drivers at every tick and never waits for them.

A driver returns the data that have arrived by `now`. Drivers for serial ports, sockets and simulated benches implement
the same few methods. Only the opening of a device may raise. Afterwards a driver reports a fault by `trouble`, and the
loop reacts according to the severity of the fault.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from functools import cached_property
from typing import Any, Literal, NamedTuple, Protocol

from core.errors import CtrError
from core.robot.robot import Array


class Condition(StrEnum):
    """Connection state of a device."""

    CLOSED = "closed"
    CONNECTING = "connecting"
    HOMING = "homing"  #: stages only
    CONNECTED = "connected"
    FAULT = "fault"  #: the device has failed; this state ends when `connect` is called again


#: Kinds of devices. A bench may lack the tracker and the force sensors.
DeviceKind = Literal["stages", "tracker", "sensors"]
#: Value that telemetry reports in place of a fault's severity for a device that the bench does not have.
ABSENT = -1


class Severity(IntEnum):
    """Reaction of the station to a device fault; with several faults the strongest reaction applies."""

    WARN = 1  #: the station only reports the fault
    HOLD = 2  #: a running motion ends at the present position of the robot
    STOP = 3  #: every axis stops
    FAULT = 4  #: every axis that can be reached stops; the state stays until the operator resets it


class DeviceFault(NamedTuple):
    """A fault of a device."""

    severity: Severity
    text: str  #: what has happened and what to do, for the operator, without addresses
    details: str = ""  #: device, address and raw values, for the person who repairs it

    def __str__(self) -> str:
        return with_details(self.text, self.details)


def with_details(text: str, details: str) -> str:
    """Return a text and its details in one line, for logs and recordings."""
    return f"{text} ({details})" if details else text


class JointReading(NamedTuple):
    """Positions of the stages."""

    positions: Array  #: (n,) positions of the joints [rad or m]; NaN for a stage that has never answered
    sent: Array  #: (n,) velocities that were sent to the stages, limited and quantised [rad/s or m/s]


class TipReading(NamedTuple):
    """One tracker frame with a valid position."""

    frame: int  #: number of the frame, counted by the tracker
    time: float  #: time of the measurement, computed from the frame number instead of the arrival [s]
    position: Array  #: (3,) position of the tip, world frame [m]
    target: Array | None = None  #: (3,) position of the target's coil, world frame [m]; None: not visible
    direction: Array | None = None  #: (3,) unit vector along the tip; None: not measured by this tracker


class WrenchReading(NamedTuple):
    """One sample of every base sensor."""

    time: float  #: time of the measurement [s]
    wrenches: Array  #: (q, 6) force and moment in the axes of each sensor, untared [N, N m]
    usable: bool = True  #: False: a sensor has no valid sample, and the reading repeats its last valid wrench


class GroundTruth(NamedTuple):
    """True values of the virtual lab, which are recorded but never used by the controller."""

    tip: Array  #: (3,) position of the tip [m]
    force: Array  #: (3,) force at the tip [N]
    target: Array | None = None  #: (3,) position of the moving target [m]; None: no target
    direction: Array | None = None  #: (3,) unit vector along the tip; None: not computed


class Device(Protocol):
    """Methods that all kinds of devices have in common."""

    @property
    def condition(self) -> Condition:
        """Connection state of the device."""
        ...

    def connect(self, now: float) -> None:
        """Start to connect, also after a FAULT; `poll` continues to connect until the state is CONNECTED or FAULT."""
        ...

    def trouble(self, now: float) -> DeviceFault | None:
        """Return the most severe fault at `now` [s], or None. Must be fast, because every tick calls this method."""
        ...

    def details(self) -> Mapping[str, Any]:
        """Return identity and counters of the device as numbers and texts, for the web page and the report."""
        ...

    def close(self) -> None:
        """Close the device's ports."""
        ...


class Stages(Device, Protocol):
    """Motors that turn and slide the tubes."""

    @property
    def ready(self) -> bool:
        """Whether the stages are connected and homed, and every position is known."""
        ...

    def home(self, now: float) -> None:
        """Start to home every stage; `poll` continues the homing while `condition` is HOMING.

        Raises:
            CtrError: the stages are not connected, or busy.
        """
        ...

    def poll(self, now: float) -> JointReading:
        """Return the positions at `now` [s], and the velocities sent."""
        ...

    def command(self, velocities: Array, now: float) -> None:
        """Set joint velocities (n,) [rad/s or m/s]; the latest replaces earlier ones. Ignored unless `ready`."""
        ...

    def stop(self, now: float) -> None:
        """Stop every axis that can be reached; the stop is sent before all queued messages."""
        ...


class Clock(Protocol):
    """Clock of the station."""

    def now(self) -> float:
        """Return the time [s]."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait for `seconds` of this clock's time."""
        ...


class NotStopped(CtrError):
    """Stages have not confirmed their stop; the text names the stages, the reason and what the operator must do."""


#: Function that stops every stage after the control process has died; another process calls it. The dying process may
#: keep the ports open for some milliseconds. The function returns a human-readable text, which confirms that every axis
#: stops, and raises NotStopped unless every axis has confirmed its stop. It should end within 2 s: if it takes longer,
#: returns no text or raises anything else, the station treats the stages as not stopped.
EmergencyStop = Callable[[Clock], str]


class Tracker(Device, Protocol):
    """A device that measures the position of the tip."""

    def poll(self, now: float) -> TipReading | None:
        """Return the newest valid frame that arrived since the last poll, or None."""
        ...


class BaseSensors(Device, Protocol):
    """Six-axis sensors at the tubes' proximal ends."""

    def poll(self, now: float) -> WrenchReading:
        """Return the newest sample."""
        ...


def is_simulated(details: Any) -> bool:
    """Return whether a device's details, or any part of them, state that it is simulated."""
    match details:
        case str():
            return "simulated" in details.lower()
        case Mapping():
            return any(map(is_simulated, details.values()))
        case list() | tuple():
            return any(map(is_simulated, details))
        case _:
            return False


@dataclass(frozen=True)
class Devices:
    """The devices of a bench, as used by the control loop."""

    stages: Stages
    tracker: Tracker | None  #: None: the bench has no tracker
    sensors: BaseSensors | None  #: None: the bench has no force sensors

    @cached_property
    def by_kind(self) -> Mapping[DeviceKind, Device]:
        """The devices of the bench by kind; a kind that the bench does not have is missing."""
        all_kinds: dict[DeviceKind, Device | None] = {
            "stages": self.stages, "tracker": self.tracker, "sensors": self.sensors,
        }  # fmt: skip
        return {kind: device for kind, device in all_kinds.items() if device is not None}

    @cached_property
    def no_fault(self) -> tuple[int, int, int]:
        """Severities of stages, tracker and force sensors if none has a fault: 0, or `ABSENT` for a missing device."""
        return 0, ABSENT if self.tracker is None else 0, ABSENT if self.sensors is None else 0
