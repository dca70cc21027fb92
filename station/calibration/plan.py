"""The robot to calibrate with its assumed parameters, and tours through poses that determine its parameters well."""

from dataclasses import dataclass

from core.calibration.measurements import Noise
from core.calibration.pose_selection import candidates, order_poses, select_poses
from core.calibration.quantities import Quantity
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array, Robot
from station.config.robots import RobotFile

#: Number of poses from which a tour selects.
CANDIDATE_POSES = 300
#: Standard deviations of a measurement, which averages 60 tracker frames and 750 samples of each force sensor.
MEASUREMENT_NOISE = Noise(coil=0.016e-3, axes=2e-3, force=1.2e-3, moment=0.05e-3)


@dataclass(frozen=True)
class PlanSubject:
    """The robot to calibrate, with its assumed parameters."""

    file: RobotFile
    robot: Robot
    limits: Limits
    statics: Statics
    start: Array  #: (n,) rest position before and after the procedure [rad or m]
    senses: bool = True  #: whether the bench has force sensors
    described: RobotFile | None = None  #: the robot's file, if `file` has the tubes of an earlier calibration

    @classmethod
    def of(
        cls, file: RobotFile, start: Array, *, senses: bool = True, described: RobotFile | None = None
    ) -> "PlanSubject":
        """Return the subject that a robot file describes, with the model that the controller uses."""
        robot = file.robot()
        return cls(file, robot, file.limits(), Statics(robot), start, senses, described)

    def tour(
        self, what: tuple[Quantity, ...], force: Array, count: int, known: Array | None, start: Array
    ) -> tuple[Array, Array]:
        """Return the `count` most informative poses (m, n) under a tip force (3,), in an order of short moves.

        `known` is the information (p, p) of earlier tours; the second result is the information of all tours.

        Raises:
            Unreachable: no pose is inside all limits.
        """
        poses = candidates(self.statics, self.limits, force, CANDIDATE_POSES)
        chosen, information = select_poses(self.robot, what, poses, force, MEASUREMENT_NOISE, count, known)
        return order_poses(self.statics, self.limits, start, poses[chosen], force), information

    def scattered(self, force: Array, count: int, start: Array) -> Array:
        """Return evenly spread poses (m, n) that check a calibration; none is among the candidates of `tour`."""
        poses = candidates(self.statics, self.limits, force, CANDIDATE_POSES + 4 * count)[-count:]
        return order_poses(self.statics, self.limits, start, poses, force)
