"""What a station is in charge of, read and checked: one value for every part of it."""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

from core.control.step import Controller
from station.config.controllers import ControllerFile
from station.config.robots import RobotFile
from station.control.clock import REAL_TIME, StationClock
from station.control.known_calibration import Calibration
from station.control.margins import Margins
from station.control.overruns import OverrunLimits
from station.control.process import ControlSetup
from station.devices.config import BenchFile
from station.lab.config import LabConfig
from station.lab.rehearsal import rehearse


@dataclass(frozen=True)
class Bench:
    """What the station is in charge of."""

    robot: RobotFile
    lab: LabConfig
    seed: int
    park: tuple[float, ...]  #: joints of the virtual lab at power-up [rad or m]
    controller: ControllerFile
    fifo: bool = True  #: ask for real-time scheduling
    overruns: OverrunLimits = field(default_factory=OverrunLimits)
    devices: BenchFile | None = None  #: None: those of the virtual lab
    margins: Margins = field(default_factory=Margins)
    core: int | None = None  #: processor of the control process; None: any
    on_operator_loss: Literal["continue", "hold"] = "continue"  #: what a run does when its operator has gone
    warnings: tuple[str, ...] = ()  #: what a person should know before anything moves
    calibration: Calibration | None = None  #: None: everything is taken to be as described
    terminals: Path | None = None  #: folder for the virtual lab's pseudo-terminals; None: TCP
    clock: StationClock = REAL_TIME  #: of every process of this station
    lab_name: str = "gentle"  #: preset or file of the lab; devices of one's own have none
    robot_name: str = "paper"  #: preset or file of the robot

    def controlled(self, file: ControllerFile) -> Controller:
        """A controller that knows what a calibration has found.

        Raises:
            DescriptionError: unknown strategy, gain or bandwidth out of range.
        """
        if self.calibration is None:
            return file.controller(self.robot)
        return self.calibration.applied(file.controller(self.calibration.robot))

    def registered(self, devices: BenchFile) -> BenchFile:
        """The devices with the tracker where a calibration has found it."""
        mount = None if self.calibration is None else self.calibration.mount
        if mount is None:
            return devices
        return devices.model_copy(update={"tracker": {**devices.tracker, "mount": mount}})

    @property
    def control(self) -> ControlSetup:
        """What its control process is told."""
        return ControlSetup(
            robot=self.robot,
            controller=self.controlled(self.controller),
            rehearse=partial(rehearse, self.robot, self.lab, self.seed, self.park),
            margins=self.margins,
            overruns=self.overruns,
            fifo=self.fifo,
            core=self.core,
            clock=self.clock,
        )

    @property
    def may_see_target(self) -> bool:
        """Whether the tracker may tell where a target is."""
        return self.lab.target is not None if self.devices is None else self.devices.may_tell_target

    @property
    def title(self) -> str:
        """What this is, for a person."""
        if self.devices is None:
            return self.lab.title
        own = self.devices
        return f"bench of '{self.robot.name}': {', '.join(d['driver'] for d in (own.stages, own.tracker, own.sensors))}"
