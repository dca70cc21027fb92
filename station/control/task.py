"""Task of the control loop: a motion with its controller, and the progress of its execution."""

from dataclasses import dataclass
from enum import IntEnum

from core.control.step import Controller
from core.robot.robot import Array
from station.config.motions import FollowMotion, Orders
from station.control.approach import approach
from station.control.margins import Margins
from station.control.motion import TimedOrders
from station.control.settle_and_tare import AVERAGE_S, SETTLE_S
from station.control.streamed_motion import StreamLimits


class Phase(IntEnum):
    """Phase of a run; telemetry contains its number."""

    NONE = 0
    APPROACHING = 1  #: the joints move to the start pose
    SETTLING = 2  #: the robot rests: the sensors are tared and the start tip is measured
    MOVING = 3  #: the motion itself is executed
    JOGGING = 4  #: the operator jogs the robot


@dataclass(frozen=True)
class MotionTask:
    """Motion for the control loop to execute, with its controller and margins."""

    controller: Controller
    orders: TimedOrders | StreamLimits  #: orders that are known in advance, or limits of a motion that a client streams
    duration: float  #: duration of the motion after its preparation [s]
    start: Array | None = None  #: joints (n,) to start from; None: their present position
    margins: Margins | None = None  #: margins against a snap; None: those of the station
    rests: bool = True  #: rest for tare and start tip before the motion; False: end at the start pose

    @property
    def follow(self) -> FollowMotion | None:
        """Motion that follows a target; None if the orders define the motion."""
        return self.orders.follow if isinstance(self.orders, Orders) else None

    def approach(self, joints: Array) -> Array | None:
        """Return velocities (n,) from `joints` (n,) toward the start pose; None after arrival."""
        return None if self.start is None else approach(joints, self.start, self.controller.limits.speed)


@dataclass(frozen=True)
class Progress:
    """Progress of a task that the control loop executes."""

    task: MotionTask
    phase: Phase
    settle_start: float = 0.0  #: start of the phase SETTLING [s]

    @property
    def motion_start(self) -> float:
        """Time at which the motion itself starts [s]; known from SETTLING on."""
        return self.settle_start + SETTLE_S + AVERAGE_S
