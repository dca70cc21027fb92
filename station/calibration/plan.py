"""The robot that is to be calibrated, and the tours through informative poses that a procedure makes."""

from dataclasses import dataclass

from core.calibration.informative import candidates, choose, tour
from core.calibration.measurements import Noise
from core.calibration.quantities import Quantity
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array, Robot
from station.config.robots import RobotFile

#: Poses to choose from.
CANDIDATES = 300
#: Standard deviations of a measurement: 60 tracker frames and 750 samples of each force sensor.
NOISE = Noise(coil=0.016e-3, axes=2e-3, force=1.2e-3, moment=0.05e-3)


@dataclass(frozen=True)
class Subject:
    """What is calibrated, as it is believed to be."""

    file: RobotFile
    robot: Robot
    limits: Limits
    statics: Statics
    start: Array  #: (n,) where the robot rests before and after [rad or m]

    @classmethod
    def of(cls, file: RobotFile, start: Array) -> "Subject":
        """With the model that controls it."""
        robot = file.robot()
        return cls(file, robot, file.limits(), Statics(robot), start)

    def tour(
        self, what: tuple[Quantity, ...], force: Array, count: int, known: Array | None, start: Array
    ) -> tuple[Array, Array]:
        """The `count` most informative poses (m, n) under a tip force (3,), in an order of short ways.

        `known` is the information (p, p) of earlier tours; the answer's second part is that of all.

        Raises:
            Unreachable: no pose is inside all limits.
        """
        poses = candidates(self.statics, self.limits, force, CANDIDATES)
        chosen, information = choose(self.robot, what, poses, force, NOISE, count, known)
        return tour(self.statics, self.limits, start, poses[chosen], force), information

    def scattered(self, force: Array, count: int, start: Array) -> Array:
        """Poses (m, n) spread evenly, chosen for nothing: to check with. Others than `tour` chooses from."""
        poses = candidates(self.statics, self.limits, force, CANDIDATES + 4 * count)[-count:]
        return tour(self.statics, self.limits, start, poses, force)
