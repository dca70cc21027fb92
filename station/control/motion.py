"""The motion of a run, from its start on: whoever gives the orders, tick by tick."""

from dataclasses import dataclass
from typing import Protocol

from core.control.trajectories import JointMotion, Setpoint
from station.control.led import Asked
from station.devices.interfaces import Trouble

#: Without a frame for this long the outer correction stays as it was at the last one: four frames [s].
FREEZE = 0.1


class Motion(Protocol):
    """One of those below, `led.LedMotion`, or `follow.Target`."""

    def order(self, now: float, blind: float, asked: Asked | None) -> Setpoint | JointMotion | Trouble | None:
        """What this tick has to do.

        Args:
            now: time [s].
            blind: how long ago the last frame has come whose error may still be corrected; 0 while frames come [s].
            asked: what was asked of this run's tip last.

        Returns:
            The order; a trouble that ends the run; None once the motion is over.
        """
        ...


class TimedOrders(Protocol):
    """What a motion wants at each moment, known beforehand."""

    def at(self, time: float) -> Setpoint | JointMotion:
        """The order at `time` [s] since the motion's start."""
        ...


@dataclass(frozen=True)
class TimedMotion:
    """Orders that are known beforehand."""

    orders: TimedOrders
    start: float  #: of the motion [s]

    def order(self, now: float, blind: float, asked: Asked | None = None) -> Setpoint | JointMotion:  # noqa: ARG002
        """What is wanted now; without frames a setpoint stands, for a tip that is not measured would be chased."""
        time = now - self.start
        order = self.orders.at(time)
        if blind == 0.0 or not isinstance(order, Setpoint):
            return order
        last = self.orders.at(max(0.0, time - blind))
        return last._replace(velocity=order.velocity) if isinstance(last, Setpoint) else order
