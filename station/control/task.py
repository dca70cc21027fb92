"""A motion to carry out, and how far it has come."""

from dataclasses import dataclass
from enum import IntEnum

from core.control.step import Controller
from core.robot.robot import Array
from station.config.motions import FollowMotion, Orders
from station.control.approach import approach
from station.control.led import Lead
from station.control.margins import Margins
from station.control.motion import TimedOrders
from station.control.settle_and_tare import AVERAGE, SETTLE


class Phase(IntEnum):
    """What a run is doing; the number is what telemetry carries."""

    NONE = 0
    APPROACHING = 1  #: the joints go to the start pose
    SETTLING = 2  #: at rest: tare, start tip
    MOVING = 3
    JOGGING = 4  #: moved by hand


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
