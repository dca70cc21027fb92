"""The station's own configuration: which robot, which lab, how it comes up."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, model_validator

from core.errors import CtrError
from core.robot.robot import Array
from station.config.controllers import BEST, ControllerFile
from station.config.robots import RobotFile, load_robot, named_pose
from station.config.strict import ConfigError, Format, Strict, check, on_line, read_toml, use_experiments
from station.control.clock import StationClock
from station.control.known_calibration import Calibration
from station.control.margins import Margins, check_design
from station.control.overruns import OverrunLimits
from station.devices.config import DevicesFile
from station.devices.open_devices import plan
from station.devices.registry import emergency_stop
from station.lab.config import load_lab
from station.service.bench import Bench

#: Said at the start, and on the page.
UNSTOPPABLE = (
    "stages of driver '{driver}' are stopped by nobody when the control process dies: the driver has no emergency_stop;"
    " keep a hand at the emergency stop (station/devices/README.md)"
)


class ExperimentsFile(Strict):
    """Experiments of one's own."""

    folder: str | None = None
    """where they are, beside this file; found by name like those that come with the station"""


class ClockFile(Strict):
    """The station's own time."""

    rate: Annotated[float, Field(ge=0.05, le=1.0)] = 1.0
    """seconds of the station in a second: below 1 loop, lab, watchdogs, deadlines, leases and recorder are slower
    together, on the virtual lab only; for tests, and for computers that are too slow for real time"""
    patience: Annotated[float, Field(ge=0.02, le=10.0)] = StationClock.patience
    """what a word of the virtual lab's stages and force sensors may take before they count as silent: they share this
    computer with other programs, which may keep them from it for a while [s]"""

    def bears(self, devices: DevicesFile) -> StationClock:
        """The clock of a station with these devices.

        Raises:
            ConfigError: real devices cannot be made slower.
        """
        if self.rate != 1.0 and devices != "virtual":
            raise ConfigError(
                f"clock.rate = {self.rate:g}: expected 1 with devices of one's own, which keep real time;"
                " leave it out, or take the virtual lab"
            )
        return StationClock(self.rate, self.patience)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a person should know."""
        slow = f"not in real time: this station's clock goes at {self.rate:g} of it (clock.rate)"
        return (slow,) if self.rate != 1.0 else ()


class StationFile(Strict):
    """What `ctr-station serve --config FILE` reads."""

    format: Format = 1
    """of this file"""
    robot: str = "paper"
    """preset, or a .toml file beside this one"""
    lab: str = "gentle"
    """virtual lab: preset, or a .toml file beside this one"""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """of everything random in the virtual lab"""
    park: Mapping[str, float] | None = None
    """joints at power-up [rad or m]; the robot's working pose when left out"""
    devices: DevicesFile = "virtual"
    """those of the virtual lab, or of a bench (station/devices/README.md)"""
    controller: ControllerFile = BEST
    """the loop's controller until a run brings its own"""
    fifo: bool = True
    """ask for real-time scheduling"""
    overruns: OverrunLimits = OverrunLimits()
    """how much lateness of the loop a motion may suffer"""
    margins: Margins = Margins()
    """how near to a snap a motion may come"""
    own_core: bool = True
    """the control process gets the last processor for itself, where there are two or more"""
    on_operator_loss: Literal["continue", "hold"] = "continue"
    """what a run does when its operator has gone: closed the page, or said nothing for 10 s"""
    calibration: str | None = None
    """folder with what `calibrate` found, beside this file"""
    experiments: ExperimentsFile = ExperimentsFile()
    """where those of one's own are"""
    clock: ClockFile = ClockFile()
    """how fast the station's time goes"""

    @model_validator(mode="before")
    @classmethod
    def _earlier_words(cls, table: Any) -> Any:
        """Files of earlier versions say `alone = "go_on"` or `"hold"`."""
        if not isinstance(table, Mapping) or "alone" not in table or "on_operator_loss" in table:
            return table
        said = table["alone"]
        return {key: value for key, value in table.items() if key != "alone"} | {
            "on_operator_loss": "continue" if said == "go_on" else said
        }

    _source: str = PrivateAttr("the default station")
    _folder: Path = PrivateAttr(default_factory=Path)
    _table: Mapping[str, Any] = PrivateAttr(default_factory=dict)

    def bench(self) -> Bench:
        """What the control process needs, all of it checked.

        Raises:
            ConfigError: with file, key, value and what was expected.
        """
        robot = load_robot(self.robot)
        lab = load_lab(self.lab, robot)
        try:
            park = self._park(robot)
            robot.limits().check(park)
            robot.robot().check_pose(park)
            folder = None if self.calibration is None else self._folder / self.calibration
            calibration = None if folder is None else Calibration.load(folder, robot)
            believed = robot if calibration is None else calibration.robot
            self.controller.controller(believed)
            devices = None if self.devices == "virtual" else self.devices
            unstoppable = ""
            if devices is not None:
                plan(devices, robot)
                if emergency_stop(devices.stages, robot) is None:
                    unstoppable = UNSTOPPABLE.format(driver=devices.stages["driver"])
            snaps = check_design(believed, self.margins)
            clock = self.clock.bears(self.devices)
        except CtrError as error:
            raise ConfigError(f"{self._source}: {error}{on_line(self._table, str(error))}") from None
        return Bench(
            robot=robot,
            lab=lab,
            seed=self.seed,
            park=tuple(park.tolist()),
            controller=self.controller,
            fifo=self.fifo,
            overruns=self.overruns,
            devices=devices,
            margins=self.margins,
            on_operator_loss=self.on_operator_loss,
            calibration=calibration,
            clock=clock,
            lab_name=self.lab if devices is None else "",
            robot_name=self.robot,
            warnings=tuple(text for text in (*self.clock.warnings, unstoppable, snaps) if text),
        )

    def _park(self, robot: RobotFile) -> Array:
        """Joints at power-up (n,) [rad or m]."""
        park = robot.working_pose if self.park is None else self.park
        if park is None:
            names = ", ".join(f"{joint.name} = ..." for joint in robot.joints)
            raise ConfigError(
                f"park is missing: robot '{robot.name}' has no working_pose to begin at; add park = {{ {names} }}"
            )
        return named_pose(park, robot, "park")


def load_station(path: Path | None, changes: Mapping[str, Any] = MappingProxyType({})) -> StationFile:
    """The station's configuration, or the defaults; `changes` are keys that are to be otherwise.

    Raises:
        ConfigError: with file, key, value and what was expected.
    """
    if path is None:
        return check(StationFile, dict(changes), "the command line")
    table = read_toml(path)
    file = check(StationFile, {**table, **_beside(path, table), **changes}, str(path), table)
    file._source, file._table, file._folder = str(path), table, path.parent
    if file.experiments.folder is not None:
        use_experiments(path.parent / file.experiments.folder)
    return file


def _beside(path: Path, table: Mapping[str, Any]) -> dict[str, str]:
    """The files that a station's file names, beside itself."""
    named = {key: table.get(key) for key in ("robot", "lab")}
    return {key: str(path.parent / to) for key, to in named.items() if isinstance(to, str) and to.endswith(".toml")}
