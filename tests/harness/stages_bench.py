"""Three simulated stages of any kind with their driver, in virtual time."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from station.config.robots import RobotFile
from station.devices.interfaces import Condition, JointReading, Stages
from station.lab.simulated_line import pump
from station.lab.simulated_stages import STAGES, StagesInLab, simulated_stages
from station.lab.wires import HostPort
from tests.harness.imaginary_stages import IMAGINARY

#: Simulated stages by their names, with those of a protocol that only the tests have.
KINDS: Mapping[str, StagesInLab] = {**STAGES, "imaginary": IMAGINARY}
TICK = 0.002
START = (0.0, math.pi / 2, -0.100)


class StagesBench:
    """The stages of a robot on one line."""

    def __init__(
        self, robot: RobotFile, kind: str, at: Sequence[float] = START, homed: bool = True, seed: int = 0,
        variant: str = "usual",
    ) -> None:  # fmt: skip
        self.robot = robot
        self.setups, self.simulated = simulated_stages(robot, KINDS[kind], at, homed, seed, variant)
        self.host = HostPort(kind)
        self.stages: Stages = KINDS[kind].on(self.host, robot)
        self.now = 0.0
        self.reading: JointReading = self.stages.poll(self.now)
        self.truth = self.positions

    def run(
        self,
        seconds: float,
        velocities: Callable[[float], Sequence[float]] | None = None,
        until: Callable[[], bool] = lambda: False,
    ) -> "StagesBench":
        """Poll and command the stages for `seconds` of virtual time, as the control loop does."""
        end = self.now + seconds
        while self.now < end and not until():
            self.truth = self.positions
            self.reading = self.stages.poll(self.now)
            if velocities is not None:
                self.stages.command(np.array(velocities(self.now)), self.now)
            self.let_pass()
        return self

    def worst_errors(self, seconds: float, velocities: Callable[[float], Sequence[float]]) -> np.ndarray:
        """Run as `run` does, and return the largest errors of the driver's positions (n,) [rad or m]."""
        worst = np.zeros(len(self.setups))

        def track(now: float) -> Sequence[float]:
            nonlocal worst
            worst = np.maximum(worst, np.abs(self.reading.positions - self.truth))
            return velocities(now)

        self.run(seconds, track)
        return worst

    def let_pass(self, seconds: float = TICK) -> None:
        """Let the simulated stages run while the driver does nothing."""
        pump(self.host.device, self.simulated, self.now + seconds, written=self.now)
        self.now += seconds

    def connect(self) -> "StagesBench":
        """Connect the stages and wait for the end of their setup."""
        self.stages.connect(self.now)
        return self.run(20.0, until=lambda: self.stages.condition is not Condition.CONNECTING)

    def home(self, seconds: float = 600.0) -> "StagesBench":
        """Home the stages and wait for the end of the homing."""
        self.stages.home(self.now)
        return self.run(seconds, until=lambda: self.stages.condition is not Condition.HOMING)

    @property
    def positions(self) -> np.ndarray:
        """True joint positions (n,) [rad or m]."""
        pairs = zip(self.setups, self.simulated.units, strict=True)
        return np.array([setup.home_at + setup.joint.microstep * unit.true_position for setup, unit in pairs])

    @property
    def cause(self) -> str:
        """Text of the driver's fault; "" without one."""
        return str(self.stages.trouble(self.now) or "")

    def speeds(self, seconds: float = 0.02) -> np.ndarray:
        """Return the mean true speeds (n,) over the next `seconds`, in which the loop continues to poll."""
        before = self.positions
        self.run(seconds)
        return np.abs(self.positions - before) / seconds


def swing(now: float) -> list[float]:
    """Return swinging velocities of the three joints, up to 15 deg/s and 12 mm/s."""
    return [0.25 * math.sin(1.3 * now), 0.26 * math.cos(0.9 * now), 0.012 * math.sin(2.0 * now)]
