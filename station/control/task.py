"""A motion to carry out, and how far it has come."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from core.control.step import Controller
from core.control.trajectories import JointMotion, Setpoint
from core.robot.robot import Array
from station.config.motions import FollowMotion, Orders
from station.control.approach import approach
from station.control.led import Lead
from station.control.margins import Margins
from station.control.settle_and_tare import AVERAGE, SETTLE

#: Without a frame for this long the outer correction stays as it was at the last one: four frames [s].
FREEZE = 0.1


class Phase(IntEnum):
    """What a run is doing; the number is what telemetry carries."""

    NONE = 0
    APPROACHING = 1  #: the joints go to the start pose
    SETTLING = 2  #: at rest: tare, start tip
    MOVING = 3
    JOGGING = 4  #: moved by hand


class TimedOrders(Protocol):
    """What a motion wants at each moment."""

    def at(self, time: float) -> Setpoint | JointMotion:
        """The order at `time` [s] since the motion's start."""
        ...


@dataclass(frozen=True)
class Task:
    """A motion to carry out and how."""

    controller: Controller
    orders: TimedOrders | Lead  #: known beforehand, or led from outside
    duration: float  #: of the motion, after the preparation [s]
    start: Array | None = None  #: joints (n,) to begin from; None: from where they are
    margins: Margins | None = None  #: what is left before the tubes snap; None: the station's
    rests: bool = True  #: for tare and start tip, before its motion; False: it has ended once it is at its start pose

    @property
    def follow(self) -> FollowMotion | None:
        """A target that decides where the tip should be; None: the orders do."""
        return self.orders.follow if isinstance(self.orders, Orders) else None

    def approach(self, joints: Array) -> Array | None:
        """Velocities (n,) from `joints` (n,) toward the start pose; None when there."""
        return None if self.start is None else approach(joints, self.start, self.controller.limits.speed)

    def order(self, time: float, blind: float) -> Setpoint | JointMotion:
        """What the motion wants `time` [s] after its start, when the last frame came `blind` [s] ago.

        While no frame comes the error of the last one stands: a setpoint that went on would be chased
        with a tip that is not measured. An observer sees to that itself: its correction of the model stands.
        """
        assert not isinstance(self.orders, Lead), "whoever leads gives the orders"  # noqa: S101
        order = self.orders.at(time)
        if blind <= FREEZE or self.controller.observes or not isinstance(order, Setpoint):
            return order
        last = self.orders.at(max(0.0, time - blind))
        return Setpoint(last.position, order.velocity) if isinstance(last, Setpoint) else order


@dataclass(frozen=True)
class Progress:
    """How far a task has come."""

    task: Task
    phase: Phase
    settle_start: float = 0.0  #: [s]

    @property
    def motion_start(self) -> float:
        """When the motion itself begins [s]; known from SETTLING on."""
        return self.settle_start + SETTLE + AVERAGE
