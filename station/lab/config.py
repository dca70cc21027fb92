"""All parameters of the virtual lab. Their default values gave the results that the documents report."""

import math
from collections.abc import Iterable, Mapping
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from station.config.controllers import Present
from station.config.robots import WHOLE_LOAD, RobotFile
from station.config.strict import ConfigError, Format, Name, NotNegative, Row, Strict, Vector, check, preset, read_toml
from station.devices.cameras import ONE_CAMERA, CameraFile, check_cameras
from station.lab.gcode_variants import VARIANTS


class TubeError(Strict):
    """Relative differences between a true tube and the controller's model of it, as fractions."""

    stiffness: Annotated[float, Field(gt=-0.9, lt=10.0)] = 0.0
    """error of the bending stiffness EI"""
    curvature: Annotated[float, Field(gt=-0.9, lt=10.0)] = 0.0
    """error of the curvature of every curved section"""


class PlantConfig(Strict):
    """The plant: the simulated real robot, whose parameters the controller does not know."""

    tubes: Mapping[str, TubeError] = {
        "inner": TubeError(stiffness=-0.05, curvature=-0.03),
        "outer": TubeError(stiffness=0.04, curvature=0.02),
    }
    """errors by tube name; a tube without an entry has exactly the robot file's values"""
    poisson_ratio: Annotated[float, Field(gt=-1.0, le=0.5)] | Literal["described"] = 0.35
    """Poisson's ratio of all tubes that have one in the robot file; `described`: the robot file's value"""
    vary: Annotated[float, Field(ge=0.0, lt=0.5)] = 0.0
    """largest random error of each tube's EI and curvature, as a fraction, drawn from the seed; replaces `tubes`"""
    play: Mapping[str, NotNegative] = {"inner_rotation": math.radians(0.1)}
    """backlash of the drives by joint name [rad or m]"""
    rod: Literal["smooth", "rough"] = "smooth"
    """`smooth`: tubes without friction along the shaft; the bases share the load, with the two friction values below.
    `rough`: rod with friction, clearance and weight; each base carries its tube"""
    friction_force: NotNegative = 0.05
    """smooth: friction force between neighbouring bases, along z [N]"""
    friction_moment: NotNegative = 0.5e-3
    """smooth: friction moment between neighbouring bases, about z [N m]"""
    friction: Annotated[float, Field(ge=0.0, le=2.0)] = 0.0
    """rough: friction coefficient mu at the points where neighbouring tubes transfer their bending moment"""
    couple: Annotated[float, Field(ge=1e-3, le=0.1)] = 0.010
    """rough: distance between the two forces that transfer the bending moment of neighbouring tubes [m]"""
    stick: Annotated[float, Field(ge=1e-6, le=1e-3)] = 5e-6
    """rough: displacement over which friction reverses [m]"""
    clearance: Annotated[float, Field(ge=0.0, le=1e-3)] = 0.0
    """rough: difference of the inner and outer diameters of neighbouring tubes [m]"""
    density: Annotated[float, Field(ge=0.0, le=3e4)] = 0.0
    """rough: density of the tubes' material; the tubes' weight bends them along +x [kg/m^3]"""
    walk: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0
    """rough: standard deviation of the random walk of each tube's precurvature after an hour, as a fraction"""
    step: Annotated[float, Field(ge=1e-4, le=0.05)] = 0.020
    """integration step of the exact rod [m]"""

    @model_validator(mode="after")
    def _of_its_rod(self) -> Self:
        """Refuse parameters that the configured kind of rod does not use."""
        smooth, rough = ("friction_force", "friction_moment"), ("friction", "clearance", "density", "walk")
        for name in smooth if self.rod == "rough" else rough:
            if getattr(self, name) > 0.0:
                other = "smooth" if self.rod == "rough" else "rough"
                raise ValueError(f"{name}: only rod = '{other}' uses it; set it to 0 or change rod")
        return self

    def check_names(self, robot: RobotFile) -> None:
        """Check that the robot has the configured tubes and joints."""
        for key, given, has in (
            ("tubes", self.tubes, [tube.name for tube in robot.tubes]),
            ("play", self.play, [joint.name for joint in robot.joints]),
        ):
            unknown = [name for name in given if name not in has]
            if unknown and key in self.model_fields_set:
                raise ConfigError(
                    f"plant.{key}.{unknown[0]}: robot '{robot.name}' has no such part; it has {', '.join(has)}"
                )


class TrackerConfig(Strict):
    """Electromagnetic tracker."""

    rate: Annotated[float, Field(gt=0.0, le=1000.0)] = 40.0
    """number of frames per second [1/s]"""
    latency: NotNegative = 0.024
    """time from a measurement to the arrival of its frame [s]"""
    noise: NotNegative = 0.1e-3
    """standard deviation of the position noise on each axis [m]"""
    distortion: Annotated[float, Field(ge=0.0, le=0.02)] = 0.0
    """position error caused by metal in the field, RMS over the measured cube [m]; its shape is drawn from the seed"""
    direction_noise: Annotated[float, Field(ge=0.0, le=0.5)] | None = 0.005
    """standard deviation of the coil's axis about each of two lateral axes [rad]; None: the axis is not reported"""


class BaseSensorConfig(Strict):
    """Six-axis sensors at the tubes' bases."""

    at: str = "tubes"
    """`tubes`: a sensor on each tube; `robot`: one sensor under the whole robot; name of a tube: one sensor, on it"""
    force_noise: NotNegative = 0.02
    """standard deviation of the force noise of one sample [N]"""
    moment_noise: NotNegative = 0.2e-3
    """standard deviation of the moment noise of one sample [N m]"""
    force_count: NotNegative = 1.0 / 256.0
    """quantisation step of the force [N]"""
    moment_count: NotNegative = 0.05e-3
    """quantisation step of the moment [N m]"""
    drift: NotNegative = 5e-3 / 60.0
    """rate of the drift of each force axis, with a random sign [N/s]"""
    moment_drift: NotNegative = 0.1e-3 / 60.0
    """rate of the drift of each moment axis [N m/s]; assumed: 1.4 times the forces' drift, relative to the range"""
    force_offset: NotNegative = 1.0
    """largest force that a sensor reads without load before it is tared [N]"""
    moment_offset: NotNegative = 10e-3
    """largest moment that a sensor reads without load before it is tared [N m]"""
    gain: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    """largest error of each axis's gain, and largest cross-talk from each other axis, as fractions of the ranges; drawn
    from the seed"""


class HiddenConfig(Strict):
    """Errors of a new bench that the station does not know; directions and signs are drawn from the seed."""

    registration_translation: NotNegative = 0.0
    """position error of the tracker [m]"""
    registration_rotation: NotNegative = 0.0
    """orientation error of the tracker [rad]"""
    coil_offset: Vector = (0.0, 0.0, 0.0)
    """position of the coil relative to the tip, in the frame of the innermost tube's tip [m]"""
    coil_misalignment: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0
    """angle between the coil's axis and the tip's [rad]"""
    base_position: NotNegative = 0.0
    """position error of the front plate relative to the robot file [m]"""
    base_rotation: NotNegative = 0.0
    """orientation error of the front plate [rad]"""
    rotation_zero: NotNegative = 0.0
    """largest error of the zero of a rotation joint [rad]; the outermost tube has none by convention"""
    translation_zero: NotNegative = 0.0
    """largest error of the zero of a translation joint [m]"""
    mirrored: tuple[str, ...] = Field(default=(), strict=False)
    """joints whose stage is reversed about the middle of its travel"""
    tracker_latency: NotNegative = 0.0
    """latency of the tracker in addition to the configured latency [s]"""
    sensor_mounting: NotNegative = 0.0
    """misalignment of each base sensor [rad]"""
    sensor_weight: NotNegative = 0.0
    """weight that hangs on each base sensor in addition to the tube [N]"""

    def check_names(self, robot: RobotFile) -> None:
        """Check that the robot has the configured joints."""
        has = [joint.name for joint in robot.joints]
        if unknown := [name for name in self.mirrored if name not in has]:
            raise ConfigError(
                f"hidden.mirrored: '{unknown[0]}' is not a joint of robot '{robot.name}'; it has {', '.join(has)}"
            )


class TargetConfig(Strict):
    """Moving target with the tracker's second coil; lines and phases of its motion are drawn from the seed."""

    place: Vector = (0.0, 0.0, 0.015)
    """position of the middle of the target's motion relative to the tip at power-up [m]"""
    breathing: NotNegative = 5e-3
    """amplitude of breathing along a line [m]"""
    breathing_rate: Annotated[float, Field(gt=0.0, le=2.0)] = 0.25
    """frequency of breathing [Hz]"""
    breathing_second: Annotated[float, Field(ge=0.0, le=1.0)] = 0.15
    """amplitude of the breathing at twice its rate, as a fraction of `breathing`"""
    heartbeat: NotNegative = 0.5e-3
    """amplitude of the heartbeat along a second line [m]"""
    heartbeat_rate: Annotated[float, Field(gt=0.0, le=5.0)] = 1.2
    """frequency of the heartbeat [Hz]"""
    rate_drift: Annotated[float, Field(ge=0.0, le=0.5)] = 0.05
    """largest change of both rates, with a period of 60 s, as a fraction"""
    size_drift: Annotated[float, Field(ge=0.0, le=0.5)] = 0.1
    """largest change of both amplitudes, with a period of 45 s, as a fraction"""


#: Simulated stages, by the name of their driver, or of the dialect of the driver `gcode`.
StagesKind = Literal["zaber", "zaber_ascii", "cia402", "grbl", "marlin"]
#: Variants of each kind of stages that behave differently from the variant `usual`.
STAGES_VARIANTS: Mapping[StagesKind, tuple[str, ...]] = {
    "zaber": (),
    "zaber_ascii": (),
    "cia402": ("no_home_offset",),
    "grbl": tuple(name for name in VARIANTS if name != "usual"),
    "marlin": ("starts_slowly",),
}
#: Kinds of devices that a bench can lack.
Without = Annotated[tuple[Literal["tracker", "sensors"], ...], Row]


def check_variant(stages: StagesKind, variant: str) -> None:
    """Raise ValueError if stages of a kind have no such variant."""
    if variant not in (names := ("usual", *STAGES_VARIANTS[stages])):
        raise ValueError(f"variant = '{variant}': stages '{stages}' have the variants {', '.join(names)}")


class LabConfig(Strict):
    """The virtual lab."""

    format: Format = 1
    """number of the file format"""
    title: str = "virtual lab: simulated tubes and devices, parameters that differ from the controller's"
    """title of the lab in recordings and reports"""
    devices: Literal["wire", "ideal"] = "wire"
    """`wire`: the devices are simulated with their wires; `ideal`: the devices have no noise, delay and wires"""
    stages: StagesKind = "zaber"
    """simulated stages, by the name of their driver, or of the dialect of the driver `gcode`"""
    variant: str = "usual"
    """variant of the stages, as real ones differ: `starts_slowly`, `as_delivered`, `homes_down`, `work_positions`,
    `reports_inches`, `reads_inches`, `grblhal`, `fluidnc` (grbl), `starts_slowly` (marlin), `no_home_offset`
    (cia402)"""
    plant: PlantConfig = PlantConfig()
    """parameters of the plant: its true tubes and their friction"""
    tracker: TrackerConfig = TrackerConfig()
    """parameters of the simulated tracker"""
    sensors: BaseSensorConfig = BaseSensorConfig()
    """parameters of the simulated base sensors"""
    hidden: HiddenConfig = HiddenConfig()
    """errors of the bench that the station does not know"""
    target: TargetConfig | None = None
    """motion of the target; without a target the tracker has a single coil"""
    cameras: Mapping[Name, CameraFile] = Field(default={}, max_length=2)
    """two simulated cameras that measure the tip instead of the tracker; they need the extra `camera`"""
    without: Without = ()
    """devices that the bench does not have: tracker, sensors"""

    def leaving_out(self, kinds: Iterable[str]) -> "LabConfig":
        """Return the lab without the devices of these kinds: `tracker`, `sensors`."""
        return self.model_copy(update={"without": tuple(sorted({*self.without, *kinds}))})

    @property
    def present(self) -> Present:
        """The devices that the bench has in addition to its stages."""
        return Present("tracker" not in self.without, "sensors" not in self.without and self.sensors.at in WHOLE_LOAD)

    @model_validator(mode="after")
    def _known_variant(self) -> Self:
        """Refuse a variant that the stages do not have."""
        check_variant(self.stages, self.variant)
        return self

    @model_validator(mode="after")
    def _coil_on_a_wire(self) -> Self:
        """Refuse a target with ideal devices, whose tracker has no second coil."""
        if self.target is not None and self.devices == "ideal":
            raise ValueError("target: ideal devices have no second coil; use devices = 'wire'")
        return self

    @model_validator(mode="after")
    def _two_cameras(self) -> Self:
        """Refuse a single camera, cameras that are not simulated, and cameras that miss the tip or the target."""
        if not self.cameras:
            return self
        if len(self.cameras) < 2:
            raise ValueError(f"cameras: {ONE_CAMERA}")
        for name, camera in self.cameras.items():
            if not camera.simulated:
                raise ValueError(f"cameras.{name}.device: the virtual lab has only simulated cameras; remove the key")
        if self.devices == "ideal" or self.target is not None:
            raise ValueError("cameras: they need devices = 'wire' and measure no target; change devices, remove target")
        return self


#: Present names of renamed preset labs, by their former names, which old files still use.
FORMER_NAMES = {"default": "gentle"}


class LabChoice(Strict):
    """A virtual lab whose simulated stages are replaced by another kind."""

    base: str = "gentle"
    """preset, or path of a .toml file relative to this file"""
    stages: StagesKind
    """simulated stages, by the name of their driver, or of the dialect of the driver `gcode`"""
    variant: str = "usual"
    """variant of the stages, as in the file of a lab"""

    @model_validator(mode="after")
    def _known_variant(self) -> Self:
        """Refuse a variant that the stages do not have."""
        check_variant(self.stages, self.variant)
        return self

    def __str__(self) -> str:
        return f"{self.base} with stages '{self.stages}'" + (f" ({self.variant})" if self.variant != "usual" else "")


#: Value of `lab` in a station or experiment file.
LabName = str | LabChoice


def load_lab(name: LabName, robot: RobotFile) -> LabConfig:
    """Load a virtual lab for a robot, by preset name, from a file, or as a table `lab`.

    Raises:
        ConfigError: the file is invalid; the message names file, key, value and what was expected.
    """
    if isinstance(name, LabChoice):
        return load_lab(name.base, robot).model_copy(update={"stages": name.stages, "variant": name.variant})
    path = preset("labs", FORMER_NAMES.get(name, name))
    lab = check(LabConfig, read_toml(path), str(path))
    try:
        lab.plant.check_names(robot)
        lab.hidden.check_names(robot)
        check_cameras(lab.cameras, virtual=True)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    return lab
