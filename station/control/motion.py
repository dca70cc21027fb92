"""Motion of a run: the source that gives the control loop an order (setpoint or joint velocities) at each tick."""

from dataclasses import dataclass
from typing import Protocol

from core.control.trajectories import JointMotion, Setpoint
from station.control.streamed_motion import StreamRequest
from station.devices.interfaces import DeviceFault

#: Time without a tracker frame after which the outer loop's correction is frozen [s]: four periods of the tracker.
FREEZE_AFTER_S = 0.1


class RunMotion(Protocol):
    """Interface of the motions of a run: `TimedMotion`, `StreamedMotion` and `TargetTrack`."""

    def order(
        self, now: float, blind: float, request: StreamRequest | None
    ) -> Setpoint | JointMotion | DeviceFault | None:
        """Return the order of this tick: a setpoint of the tip, or joint velocities.

        Args:
            now: time [s].
            blind: time since the last tracker frame [s]; 0 if this time is at most `FREEZE_AFTER_S`, or if the
                controller has an observer.
            request: latest setpoint request for this run's streamed tip.

        Returns:
            The order; a fault that ends the run; None after the end of the motion.
        """
        ...


class TimedOrders(Protocol):
    """Interface of orders that are known in advance as a function of time."""

    def at(self, time: float) -> Setpoint | JointMotion:
        """Return the order at `time` [s] since the motion's start."""
        ...


@dataclass(frozen=True)
class TimedMotion:
    """Motion of a run whose orders are known in advance."""

    orders: TimedOrders
    start: float  #: time at which the motion starts [s]

    def order(
        self,
        now: float,
        blind: float,
        request: StreamRequest | None = None,  # noqa: ARG002
    ) -> Setpoint | JointMotion:
        """Return this tick's order; without frames the setpoint keeps the position at the last frame."""
        time = now - self.start
        order = self.orders.at(time)
        if blind == 0.0 or not isinstance(order, Setpoint):
            return order
        last = self.orders.at(max(0.0, time - blind))
        return last._replace(velocity=order.velocity) if isinstance(last, Setpoint) else order
