"""What the control loop asks of devices: polled at every tick, never waited for.

A device answers with what has arrived by `now`; a driver on a serial port, a socket or a simulated
bench fits behind the same few methods.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

from core.robot import Array


class JointReading(NamedTuple):
    """Positions of the stages."""

    positions: Array  #: (n,) [rad or m]
    sent: Array  #: (n,) velocities that really went out, after limits and quantisation [rad/s or m/s]


class TipReading(NamedTuple):
    """One tracker frame."""

    frame: int  #: the tracker's own count
    time: float  #: when it was measured, by the frame number, not by its arrival [s]
    position: Array  #: (3,) world frame [m]


class WrenchReading(NamedTuple):
    """One sample of every base sensor."""

    time: float  #: [s]
    wrenches: Array  #: (q, 6) force and moment in each sensor's own axes, untared [N, N m]


class Truth(NamedTuple):
    """What only a virtual lab knows: for the record, never for the controller."""

    tip: Array  #: (3,) [m]
    force: Array  #: (3,) at the tip [N]


class Stages(Protocol):
    """Motors that turn and slide the tubes."""

    def poll(self, now: float) -> JointReading:
        """Positions at `now` [s]."""
        ...

    def command(self, velocities: Array, now: float) -> None:
        """Ask for joint velocities (n,) [rad/s or m/s]; the latest wins."""
        ...

    def stop(self, now: float) -> None:
        """Stop every axis, ahead of whatever waits to be sent."""
        ...


class Tracker(Protocol):
    """Measures where the tip is."""

    def poll(self, now: float) -> TipReading | None:
        """The newest frame that arrived since the last poll, if any."""
        ...


class BaseSensors(Protocol):
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
