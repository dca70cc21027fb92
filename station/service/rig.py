"""The rig of a station: its robot, devices, virtual lab and settings after they were read and checked."""

from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Literal

from core.control.step import Controller
from station.config.controllers import ControllerFile
from station.config.robots import RobotFile
from station.control.bench_calibration import BenchCalibration
from station.control.clock import REAL_TIME_CLOCK, StationClock
from station.control.margins import Margins
from station.control.overruns import OverrunLimits
from station.control.process import ControlSetup
from station.devices.config import BenchFile
from station.lab.config import LabConfig
from station.lab.virtual_bench import warm_up_control


@dataclass(frozen=True)
class Rig:
    """Robot, devices and settings of a station."""

    robot: RobotFile
    lab: LabConfig  #: configuration of the virtual lab
    seed: int  #: seed of everything random in the virtual lab
    park: tuple[float, ...]  #: joints of the virtual lab at power-up [rad or m]
    controller: ControllerFile
    fifo: bool = True  #: whether to request real-time scheduling
    overruns: OverrunLimits = field(default_factory=OverrunLimits)
    devices: BenchFile | None = None  #: None: the devices of the virtual lab
    margins: Margins = field(default_factory=Margins)
    core: int | None = None  #: processor of the control process; None: any
    on_operator_loss: Literal["continue", "hold"] = "continue"  #: what a run does after the loss of its operator
    warnings: tuple[str, ...] = ()  #: warnings for the operator before anything moves
    calibration: BenchCalibration | None = None  #: calibration of the bench; None: nominal parameters
    terminals: Path | None = None  #: folder for the virtual lab's pseudo-terminals; None: TCP
    clock: StationClock = REAL_TIME_CLOCK  #: clock of every process of this station
    lab_name: str = "gentle"  #: preset or file of the lab; empty with real devices
    robot_name: str = "paper"  #: preset or file of the robot

    @cached_property
    def max_force(self) -> float:
        """Force on the tip at which a motion ends in HOLD, or at which the controller stops pushing [N]."""
        return self.robot.largest_force().newton

    @cached_property
    def model_note(self) -> str:
        """Text about the model's integrator if it was chosen because of the tubes' curvature; otherwise empty."""
        return self.controller.model_note(self.robot.robot())

    def controlled(self, file: ControllerFile) -> Controller:
        """Return the controller that `file` describes, with the calibrated parameters.

        Raises:
            DescriptionError: the strategy is unknown, or a gain or bandwidth is out of range.
        """
        if self.calibration is None:
            return file.controller(self.robot)
        return self.calibration.applied(file.controller(self.calibration.robot))

    def registered(self, devices: BenchFile) -> BenchFile:
        """Return the devices with the calibrated pose of the tracker."""
        mount = None if self.calibration is None else self.calibration.mount
        if mount is None:
            return devices
        return devices.model_copy(update={"tracker": {**devices.tracker, "mount": mount}})

    @property
    def control(self) -> ControlSetup:
        """Configuration of the control process."""
        return ControlSetup(
            robot=self.robot,
            controller=self.controlled(self.controller),
            rehearse=partial(warm_up_control, self.robot, self.lab, self.seed, self.park),
            margins=self.margins,
            overruns=self.overruns,
            fifo=self.fifo,
            core=self.core,
            clock=self.clock,
        )

    @property
    def can_track_target(self) -> bool:
        """Whether the tracker can measure the position of a target."""
        return self.lab.target is not None if self.devices is None else self.devices.can_measure_target

    @property
    def title(self) -> str:
        """Human-readable name of the lab or bench."""
        if self.devices is None:
            return self.lab.title
        own = self.devices
        return f"bench of '{self.robot.name}': {', '.join(d['driver'] for d in (own.stages, own.tracker, own.sensors))}"
