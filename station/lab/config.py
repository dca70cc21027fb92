"""Every number of the virtual lab. The defaults are those that results are quoted with."""

import math
from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from station.config.robots import RobotFile
from station.config.strict import ConfigError, Format, NotNegative, Strict, Vector, check, preset, read_toml


class TubeError(Strict):
    """How a true tube differs from the one the controller believes in, as fractions."""

    stiffness: Annotated[float, Field(gt=-0.9, lt=10.0)] = 0.0
    """of EI"""
    curvature: Annotated[float, Field(gt=-0.9, lt=10.0)] = 0.0
    """likewise, of every curved section"""


class PlantConfig(Strict):
    """The true robot."""

    tubes: Mapping[str, TubeError] = {
        "inner": TubeError(stiffness=-0.05, curvature=-0.03),
        "outer": TubeError(stiffness=0.04, curvature=0.02),
    }
    """by tube name; a tube that is not named is as described"""
    poisson_ratio: Annotated[float, Field(gt=-1.0, le=0.5)] | None = 0.35
    """of all tubes that are described by one"""
    vary: Annotated[float, Field(ge=0.0, lt=0.5)] = 0.0
    """draw EI and curvature of each tube within +- this fraction instead, from the seed"""
    play: Mapping[str, NotNegative] = {"inner_rotation": math.radians(0.1)}
    """backlash by joint [rad or m]"""
    rod: Literal["smooth", "rough"] = "smooth"
    """`smooth`: tubes that only share their shape; the bases share the load and rub with the two numbers that follow.
    `rough`: friction, clearance and weight are in the rod, and each base carries its own tube"""
    friction_force: NotNegative = 0.05
    """smooth: between neighbouring bases, along z [N]"""
    friction_moment: NotNegative = 0.5e-3
    """smooth: between neighbouring bases, about z [N m]"""
    friction: Annotated[float, Field(ge=0.0, le=2.0)] = 0.0
    """rough: coefficient mu where neighbouring tubes hand over their moment"""
    couple: Annotated[float, Field(ge=1e-3, le=0.1)] = 0.010
    """rough: distance of the two forces that hand it over [m]"""
    stick: Annotated[float, Field(ge=1e-6, le=1e-3)] = 5e-6
    """rough: path on which friction turns round [m]"""
    clearance: Annotated[float, Field(ge=0.0, le=1e-3)] = 0.0
    """rough: difference of the diameters that face each other [m]"""
    density: Annotated[float, Field(ge=0.0, le=3e4)] = 0.0
    """rough: of the tubes' material; their weight bends them along +x [kg/m^3]"""
    walk: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0
    """rough: random walk of each tube's precurvature, standard deviation after an hour, as a fraction"""
    step: Annotated[float, Field(ge=1e-4, le=0.05)] = 0.020
    """of the exact rod's integration [m]"""

    @model_validator(mode="after")
    def _of_its_rod(self) -> Self:
        """Refuse numbers that this rod would not look at."""
        smooth, rough = ("friction_force", "friction_moment"), ("friction", "clearance", "density", "walk")
        for name in smooth if self.rod == "rough" else rough:
            if getattr(self, name) > 0.0:
                other = "smooth" if self.rod == "rough" else "rough"
                raise ValueError(f"{name} belongs to rod = '{other}'; here it must be 0")
        return self

    def check_names(self, robot: RobotFile) -> None:
        """Refuse tubes and joints that were given by name and that the robot does not have."""
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
    """of its frames [1/s]"""
    latency: NotNegative = 0.024
    """from the measurement to its arrival [s]"""
    noise: NotNegative = 0.1e-3
    """standard deviation an axis [m]"""
    distortion: Annotated[float, Field(ge=0.0, le=0.02)] = 0.0
    """of the field by metal nearby, RMS over the measured cube [m]; its form is drawn from the seed"""
    direction_noise: Annotated[float, Field(ge=0.0, le=0.5)] | None = 0.005
    """standard deviation of the coil's axis about each of two others [rad]; None: the axis is not told"""


class BaseSensorConfig(Strict):
    """Six-axis sensors at the tubes' bases."""

    force_noise: NotNegative = 0.02
    """standard deviation of one sample [N]"""
    moment_noise: NotNegative = 0.2e-3
    """the same of a moment [N m]"""
    force_count: NotNegative = 1.0 / 256.0
    """one count of quantisation [N]"""
    moment_count: NotNegative = 0.05e-3
    """the same of a moment [N m]"""
    drift: NotNegative = 5e-3 / 60.0
    """slope of the slow drift of each force axis, either way [N/s]"""
    force_offset: NotNegative = 1.0
    """largest reading without load before the tare [N]"""
    moment_offset: NotNegative = 10e-3
    """the same of a moment [N m]"""
    gain: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    """largest error of each axis's gain, either way, and of the cross-talk from each other axis, as fractions of the
    ranges; drawn from the seed"""


class HiddenConfig(Strict):
    """What a new bench does not know about itself; directions and signs are drawn from the seed."""

    registration_translation: NotNegative = 0.0
    """by how much the tracker stands elsewhere than it is said to [m]"""
    registration_rotation: NotNegative = 0.0
    """by how much it is turned against that [rad]"""
    coil_offset: Vector = (0.0, 0.0, 0.0)
    """of the coil from the tip, in the frame of the innermost tube's tip [m]"""
    coil_askew: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0
    """by which angle the coil's axis is turned against the tip's [rad]"""
    base_position: NotNegative = 0.0
    """by how much the plate stands elsewhere than the robot's file says [m]"""
    base_rotation: NotNegative = 0.0
    """by how much it is turned against that [rad]"""
    rotation_zero: NotNegative = 0.0
    """largest error of a rotation's zero, but the outermost tube's: that is zero by convention [rad]"""
    translation_zero: NotNegative = 0.0
    """largest error of a translation's zero [m]"""
    mirrored: tuple[str, ...] = Field(default=(), strict=False)
    """joints whose stage runs the other way, about the middle of its travel"""
    tracker_latency: NotNegative = 0.0
    """on top of the one that is known [s]"""
    sensor_mounting: NotNegative = 0.0
    """by which angle each base sensor is mounted askew [rad]"""
    sensor_weight: NotNegative = 0.0
    """of what hangs on each base sensor beside the tube [N]"""

    def check_names(self, robot: RobotFile) -> None:
        """Refuse joints that the robot does not have."""
        has = [joint.name for joint in robot.joints]
        if unknown := [name for name in self.mirrored if name not in has]:
            raise ConfigError(
                f"hidden.mirrored: '{unknown[0]}' is no joint of robot '{robot.name}'; it has {', '.join(has)}"
            )


class TargetConfig(Strict):
    """What moves beside the robot and carries the tracker's second coil; lines and phases are drawn from the seed."""

    place: Vector = (0.0, 0.0, 0.015)
    """of its middle, from the tip at power-up [m]"""
    breathing: NotNegative = 5e-3
    """from the middle to either end of a line [m]"""
    breathing_rate: Annotated[float, Field(gt=0.0, le=2.0)] = 0.25
    """how often it goes there and back [Hz]"""
    breathing_second: Annotated[float, Field(ge=0.0, le=1.0)] = 0.15
    """part of the size that a wave of twice the rate has"""
    heartbeat: NotNegative = 0.5e-3
    """the same along a line of its own [m]"""
    heartbeat_rate: Annotated[float, Field(gt=0.0, le=5.0)] = 1.2
    """how often that goes there and back [Hz]"""
    rate_drift: Annotated[float, Field(ge=0.0, le=0.5)] = 0.05
    """largest change of both rates, there and back in a minute, as a part"""
    size_drift: Annotated[float, Field(ge=0.0, le=0.5)] = 0.1
    """of both sizes"""


class LabConfig(Strict):
    """The virtual lab."""

    format: Format = 1
    """of this file"""
    title: str = "virtual lab: simulated tubes and devices, parameters that differ from the controller's"
    """as recordings and reports call it"""
    devices: Literal["wire", "ideal"] = "wire"
    """as real ones behave on their wires, or without flaw: no noise, no delay, no wires"""
    plant: PlantConfig = PlantConfig()
    """the true tubes, and what they rub on"""
    tracker: TrackerConfig = TrackerConfig()
    """how the simulated one measures"""
    sensors: BaseSensorConfig = BaseSensorConfig()
    """how the simulated ones measure"""
    hidden: HiddenConfig = HiddenConfig()
    """what the station is told wrongly"""
    target: TargetConfig | None = None
    """none: the tracker has one coil"""

    @model_validator(mode="after")
    def _coil_on_a_wire(self) -> Self:
        """Refuse a target that nobody would see."""
        if self.target is not None and self.devices == "ideal":
            raise ValueError("target: ideal devices have no second coil; use devices = 'wire'")
        return self


#: Labs that had another name.
FORMER_NAMES = {"default": "gentle"}


def load_lab(name: str, robot: RobotFile) -> LabConfig:
    """A virtual lab for a robot, by preset name or by file.

    Raises:
        ConfigError: with file, key, value and what was expected.
    """
    path = preset("labs", FORMER_NAMES.get(name, name))
    lab = check(LabConfig, read_toml(path), str(path))
    try:
        lab.plant.check_names(robot)
        lab.hidden.check_names(robot)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    return lab
