"""Configuration file of a station, and the rig that it describes: robot, lab, devices and settings."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, PrivateAttr

from core.control.controller_settings import Controller
from core.control.force_control import OVERSHOOT
from core.control.reachability import check_pose
from core.errors import CtrError
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array
from station.config.controllers import ControllerFile, Present, StagesLatency, default_controller
from station.config.regions import RegionFile, Regions, mesh_warnings, read_regions, resolved
from station.config.robots import WHOLE_LOAD, RobotFile, load_robot, named_pose
from station.config.strict import (
    MAX_SILENCE_S,
    PRESETS,
    ConfigError,
    Format,
    Row,
    Strict,
    check,
    line_reference,
    preset,
    read_toml,
    use_experiments,
)
from station.control.bench_calibration import BenchCalibration
from station.control.clock import REAL_TIME_CLOCK, StationClock
from station.control.monitors import Margins, OverrunLimits, check_design
from station.control.process import ControlSetup
from station.devices.cameras import CameraFile, CamerasFile, check_cameras, measuring
from station.devices.config import BenchFile, DevicesFile
from station.devices.registry import default_latency, emergency_stop, plan, stages_latency
from station.devices.stereo.tracker import with_views
from station.lab.config import LabConfig, LabName, Without, load_lab
from station.lab.simulated_stages import lab_latency
from station.lab.virtual_bench import warm_up_control

_ORIGIN = re.compile(r"(https?)://(\[[0-9a-f:]+\]|[a-z0-9-]+(?:\.[a-z0-9-]+)*)(?::([1-9][0-9]{0,4}))?")


def _origin(text: str) -> str:
    """Return `text` if it is the origin of a web page in the form that a browser sends.

    Raises:
        ValueError: it has a wildcard, a path, capitals or the default port, for example.
    """
    match = _ORIGIN.fullmatch(text)
    if match is None or int(match[3] or 1) > 65535 or (match[1], match[3]) in (("http", "80"), ("https", "443")):
        raise ValueError(
            "expected http or https, host and optional port, such as 'http://localhost:8080', in lower case"
        )
    return text


Origin = Annotated[str, AfterValidator(_origin)]


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
    cameras: Mapping[str, CameraFile] = field(default_factory=dict[str, CameraFile])  #: cameras by name
    keep_out: tuple[RegionFile, ...] = ()  #: regions that the tubes must not enter or not leave

    @property
    def video_bytes_per_s(self) -> float:
        """Largest growth of the cameras' videos [bytes/s]."""
        return sum(camera.video_bit_rate for camera in self.cameras.values()) / 8.0

    @cached_property
    def max_force(self) -> float:
        """Force on the tip at which a motion ends in HOLD, or at which the controller stops pushing [N]."""
        return self.best_known_robot.largest_force().newton

    @property
    def max_desired_force(self) -> float:
        """Largest desired force of a motion `force` [N], below `max_force` because the force overshoots at contact."""
        return self.max_force / (1.0 + OVERSHOOT)

    @cached_property
    def limits(self) -> Limits:
        """Limits of the station's controller: joints, tubes, tip, force and regions."""
        return self.controlled(self.controller).limits

    @cached_property
    def model_note(self) -> str:
        """Human-readable description of the model: its integrator and the length of its sub-links."""
        return f"model: {self.controller.model(self.robot.robot()).discretisation}"

    def controlled(self, file: ControllerFile) -> Controller:
        """Return the controller that `file` describes, with the calibrated parameters.

        Raises:
            DescriptionError: the strategy is unknown, needs a device that the station does not have, or a gain or
                bandwidth is out of range.
        """
        controller = file.controller(self.best_known_robot, self.present, self.keep_out, self.latency)
        return controller if self.calibration is None else self.calibration.applied(controller)

    @cached_property
    def latency(self) -> StagesLatency:
        """Latency of the stages according to their driver; the controller's keys may override it."""
        if self.devices is None:
            return lab_latency(self.lab.stages, self.robot)
        return stages_latency(self.devices.stages, self.robot)

    @property
    def best_known_robot(self) -> RobotFile:
        """The robot with calibrated tubes; without a calibration the described robot."""
        return self.robot if self.calibration is None else self.calibration.robot

    @property
    def present(self) -> Present:
        """Devices that the station has in addition to its stages."""
        return self.lab.present if self.devices is None else self.devices.present

    def registered(self, devices: BenchFile) -> BenchFile:
        """Return the devices with the calibrated pose and latency of the tracker, and its calibrated views."""
        calibration = self.calibration
        if calibration is None or devices.tracker is None:
            return devices
        tracker = dict(devices.tracker)
        if calibration.mount is not None:
            tracker["mount"] = calibration.mount
        if calibration.latency:
            tracker["latency"] = tracker.get("latency", default_latency(tracker["driver"])) + calibration.latency
        if tracker["driver"] == "stereo":
            tracker["views"] = measuring(self.cameras, calibration.views)
        return devices.model_copy(update={"tracker": tracker})

    @property
    def known_cameras(self) -> dict[str, CameraFile]:
        """The cameras in the robot's frame, with calibrated lenses and poses, and without simulated errors."""
        calibration = self.calibration
        if calibration is None:
            return measuring(self.cameras)
        known, mounting = measuring(self.cameras, calibration.views), calibration.registration
        if mounting is None:
            return known
        for name in self.tracking_cameras:
            pose = known[name].view
            if pose is not None:
                known[name] = known[name].model_copy(update={"pose": pose[1].moved(mounting)})
        return known

    @property
    def tracking_cameras(self) -> tuple[str, ...]:
        """Names of the cameras that measure the tip."""
        if self.devices is None:
            return tuple(self.lab.cameras)
        tracker = self.devices.tracker
        return tuple(tracker["cameras"]) if tracker is not None and tracker["driver"] == "stereo" else ()

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
        if self.devices is not None:
            return self.devices.can_measure_target
        return self.lab.target is not None and self.present.tracker

    @property
    def title(self) -> str:
        """Human-readable name of the lab or bench."""
        if self.devices is None:
            return self.lab.title
        tables = (self.devices.stages, self.devices.tracker, self.devices.sensors)
        return f"bench of '{self.robot.name}': {', '.join(table['driver'] for table in tables if table)}"


#: Warning about stages without an emergency stop, shown at the start and on the page.
UNSTOPPABLE = (
    "nothing stops the stages of driver '{driver}' when the control process dies: the driver has no emergency_stop;"
    " keep a hand at the emergency stop (station/devices/README.md)"
)


#: Warning about a force sensor that does not measure the whole load.
NOT_THE_LOAD = (
    "the force sensor on tube '{tube}' alone measures its share of the load and the forces between the tubes, which are"
    " larger: its readings are recorded, and the force is estimated from the deflection of the tip"
)


class ExperimentsFile(Strict):
    """Table `[experiments]` of a station file."""

    folder: str | None = None
    """folder of custom experiments, relative to this file; each is started by its name, like a preset"""


class ClockFile(Strict):
    """Table `[clock]` of a station file."""

    rate: Annotated[float, Field(ge=0.05, le=1.0)] = 1.0
    """seconds of the station's clock per real second: a rate below 1 slows loop, lab, watchdogs, deadlines, leases and
    recorder together. Only the virtual lab can be slowed, for tests or on computers that are too slow for real time"""
    patience: Annotated[float, Field(ge=0.02, le=MAX_SILENCE_S)] | None = None
    """longest silence of the stages and force sensors before they count as lost [s]. The default is 0.15 for the
    virtual lab, because other programs on this computer may delay simulated devices; the tracker may then be silent as
    long, and at least for its default. With other devices this key sets a missing `deadline` of stages of a built-in
    driver and a missing `stale_after` of `netft` sensors; without this key the drivers' defaults apply. Use this key
    for a bench that `ctr-station lab` simulates"""

    def for_devices(self, devices: DevicesFile) -> StationClock:
        """Return the clock of a station that has these devices.

        Raises:
            ConfigError: the devices are real and the rate is not 1.
        """
        if self.rate != 1.0 and devices != "virtual":
            raise ConfigError(
                f"clock.rate = {self.rate:g}: expected 1 with real devices, which run in real time;"
                " remove it, or use the virtual lab"
            )
        return StationClock(self.rate, StationClock.patience if self.patience is None else self.patience)

    def with_patience(self, bench: BenchFile) -> BenchFile:
        """Return the bench with `patience` as the timeout of built-in drivers whose table has no timeout."""
        if self.patience is None:
            return bench
        tables = {
            kind: {key: self.patience, **table}
            for kind, drivers, key in (
                ("stages", ("zaber", "zaber_ascii", "cia402", "gcode"), "deadline"),
                ("sensors", ("netft",), "stale_after"),
            )
            if (table := getattr(bench, kind)) and table["driver"] in drivers
        }
        return bench.model_copy(update=tables)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the operator about a slow clock."""
        slow = f"not in real time: this station's clock runs at {self.rate:g} times real time (clock.rate)"
        return (slow,) if self.rate != 1.0 else ()


class StationFile(Strict):
    """Station file of `ctr-station serve --config FILE`."""

    format: Format = 1
    """format of this file"""
    robot: str = "paper"
    """preset, or path of a .toml file relative to this file"""
    lab: LabName = "gentle"
    """virtual lab: preset, path of a .toml file relative to this file, or a table with its `base` and other `stages`"""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """seed of everything random in the virtual lab"""
    park: Mapping[str, float] | None = None
    """joint positions of the virtual lab at power-up [rad or m]; by default the robot's working pose"""
    devices: DevicesFile = "virtual"
    """devices of the virtual lab, or of a bench (station/devices/README.md)"""
    without: Without = ()
    """devices that the virtual lab does not have, in addition to the key `without` of the lab's file"""
    controller: ControllerFile | None = None
    """controller of the loop until a run sets another one; by default the best one for the station's devices"""
    fifo: bool = True
    """request real-time scheduling"""
    overruns: OverrunLimits = OverrunLimits()
    """limits of the loop's lateness during a motion"""
    margins: Margins = Margins()
    """limits of the distance to a snap during a motion"""
    own_core: bool = True
    """reserve the last processor for the control process, if there are two or more"""
    on_operator_loss: Literal["continue", "hold"] = "continue"
    """what a run does after the loss of its operator: page closed, or no message for 10 s"""
    calibration: str | None = None
    """folder with the results of `calibrate`, relative to this file"""
    experiments: ExperimentsFile = ExperimentsFile()
    """custom experiments"""
    clock: ClockFile = ClockFile()
    """rate of the station's clock"""
    cameras: CamerasFile = Field(default_factory=dict)
    """cameras that look at the robot; they need the extra `camera`"""
    keep_out: Regions = ()
    """regions that the tubes must not enter, or must not leave, in every motion"""
    gateway_origins: Annotated[tuple[Origin, ...], Row] = ()
    """web pages that may connect to the gateway's Foxglove server, such as `"http://localhost:8080"` for a local
    Lichtblick: scheme (http or https), host and optional port, as a browser sends them. Pages of the station and of
    https://app.foxglove.dev, and desktop programs, may always connect"""

    _source: str = PrivateAttr("the default station")
    _folder: Path = PrivateAttr(default_factory=Path)
    _table: Mapping[str, Any] = PrivateAttr(default_factory=dict)

    def bench(self) -> Rig:
        """Check this file and return the rig that it describes.

        Raises:
            ConfigError: the text names file, key, value and the expected value.
        """
        robot = load_robot(self.robot)
        lab = load_lab(self.lab, robot).leaving_out(self.without)
        try:
            if self.without and self.devices != "virtual":
                raise ConfigError(f"without = {list(self.without)}: leave out the tables of real devices instead")
            at, key, present = (
                (lab.sensors.at, "sensors.at of the lab", lab.present)
                if self.devices == "virtual"
                else (self.devices.sensors_at, "devices.sensors.at", self.devices.present)
            )
            robot = robot.sensed_at(at, key)
            controller = self.controller or default_controller(present)
            park = self._park(robot)
            regions = read_regions([resolved(one, self._folder) for one in self.keep_out])
            folder = None if self.calibration is None else self._folder / self.calibration
            cameras = {**self.cameras, **(lab.cameras if self.devices == "virtual" else {})}
            calibration = None if folder is None else BenchCalibration.load(folder, robot, cameras)
            assumed = robot if calibration is None else calibration.robot
            limits = controller.controller(assumed, present, regions).limits
            check_pose(Statics(robot.robot()), limits, park)
            devices = None if self.devices == "virtual" else self.clock.with_patience(self.devices)
            unstoppable = ""
            if devices is not None:
                if devices.tracker is not None:
                    tracker = with_views(devices.tracker, self.cameras)
                    devices = devices.model_copy(update={"tracker": tracker})
                plan(devices, robot)
                stages_latency(devices.stages, robot)
                if emergency_stop(devices.stages, robot) is None:
                    unstoppable = UNSTOPPABLE.format(driver=devices.stages["driver"])
            snaps = check_design(assumed, self.margins)
            if preset("robots", self.robot).is_relative_to(PRESETS):
                snaps = ""  # the tubes of a preset cannot be changed; the control loop watches for a snap anyway
            partial = NOT_THE_LOAD.format(tube=at) if at not in WHOLE_LOAD and "sensors" not in lab.without else ""
            notices = (*(() if calibration is None else calibration.warnings), *mesh_warnings(regions))
            clock = self.clock.for_devices(self.devices)
            check_cameras(self.cameras, virtual=devices is None)
            if devices is None and (both := self.cameras.keys() & lab.cameras.keys()):
                raise ConfigError(f"cameras.{min(both)}: the lab has a camera of this name; use another name")
        except CtrError as error:
            raise ConfigError(f"{self._source}: {error}{line_reference(self._table, str(error))}") from None
        return Rig(
            robot=robot,
            lab=lab,
            seed=self.seed,
            park=tuple(park.tolist()),
            controller=controller,
            fifo=self.fifo,
            overruns=self.overruns,
            devices=devices,
            margins=self.margins,
            on_operator_loss=self.on_operator_loss,
            calibration=calibration,
            clock=clock,
            lab_name=str(self.lab) if devices is None else "",
            robot_name=self.robot,
            cameras=cameras,
            keep_out=regions,
            warnings=tuple(text for text in (*self.clock.warnings, unstoppable, partial, snaps, *notices) if text),
        )

    def _park(self, robot: RobotFile) -> Array:
        """Return the joint positions of the virtual lab at power-up (n,) [rad or m]."""
        park = robot.working_pose if self.park is None else self.park
        if park is None:
            names = ", ".join(f"{joint.name} = ..." for joint in robot.joints)
            raise ConfigError(
                f"park is missing: robot '{robot.name}' has no working_pose to start from; add park = {{ {names} }}"
            )
        return named_pose(park, robot, "park")


def load_station(path: Path | None, changes: Mapping[str, Any] = MappingProxyType({})) -> StationFile:
    """Return the station's configuration, or the defaults; `changes` overrides keys of the file.

    Raises:
        ConfigError: the text names file, key, value and the expected value.
    """
    if path is None:
        return check(StationFile, dict(changes), "the command line")
    table = read_toml(path)
    file = check(StationFile, {**table, **_resolve_paths(path, table), **changes}, str(path), table)
    file._source, file._table, file._folder = str(path), table, path.parent
    if file.experiments.folder is not None:
        use_experiments(path.parent / file.experiments.folder)
    return file


def _resolve_paths(path: Path, table: Mapping[str, Any]) -> dict[str, Any]:
    """Return robot and lab of a station file, with their paths resolved relative to the folder of that file."""

    def resolved(to: Any) -> Any:
        if isinstance(to, Mapping):
            return {**to, "base": resolved(to["base"])} if "base" in to else to
        return str(path.parent / to) if isinstance(to, str) and to.endswith(".toml") else to

    return {key: resolved(table[key]) for key in ("robot", "lab") if key in table}
