"""Every number of the virtual lab. The defaults are those that results are quoted with."""

import math
from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from station.config import ConfigError, NotNegative, Strict, check, preset, read_toml
from station.robots import RobotFile


class TubeError(Strict):
    """How a true tube differs from the one the controller believes in, as fractions."""

    stiffness: Annotated[float, Field(gt=-0.9, lt=10.0)] = 0.0
    """of EI"""
    curvature: Annotated[float, Field(gt=-0.9, lt=10.0)] = 0.0


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
    friction_force: NotNegative = 0.05
    """between neighbouring tubes, along z [N]"""
    friction_moment: NotNegative = 0.5e-3
    """between neighbouring tubes, about z [N m]"""
    step: Annotated[float, Field(ge=1e-4, le=0.05)] = 0.020
    """of the exact rod's integration [m]"""

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


class LineConfig(Strict):
    """The serial line to the stages, as a hold and a delay."""

    hold: NotNegative = 0.025
    """between two commands to the same axis [s]"""
    transport: NotNegative = 0.012
    """from the command to the motor [s]"""
    quantised: bool = True
    """speeds in units of 9.375 microsteps/s and positions in microsteps"""
    ramps: bool = True
    """speed changes at the stages' acceleration"""


class TrackerConfig(Strict):
    """Electromagnetic tracker."""

    rate: Annotated[float, Field(gt=0.0, le=1000.0)] = 40.0
    """[1/s]"""
    latency: NotNegative = 0.024
    """from the measurement to its arrival [s]"""
    noise: NotNegative = 0.1e-3
    """standard deviation an axis [m]"""


class BaseSensorConfig(Strict):
    """Six-axis sensors at the tubes' bases."""

    force_noise: NotNegative = 0.02
    """standard deviation of one sample [N]"""
    moment_noise: NotNegative = 0.2e-3
    """[N m]"""
    force_count: NotNegative = 1.0 / 256.0
    """one count of quantisation [N]"""
    moment_count: NotNegative = 0.05e-3
    """[N m]"""
    drift: NotNegative = 5e-3 / 60.0
    """slope of the slow drift of each force axis, either way [N/s]"""
    force_offset: NotNegative = 1.0
    """largest reading without load before the tare [N]"""
    moment_offset: NotNegative = 10e-3
    """[N m]"""


class LabConfig(Strict):
    """The virtual lab."""

    title: str = "virtual lab: simulated tubes and devices, parameters that differ from the controller's"
    plant: PlantConfig = PlantConfig()
    line: LineConfig = LineConfig()
    tracker: TrackerConfig = TrackerConfig()
    sensors: BaseSensorConfig = BaseSensorConfig()


def load_lab(name: str, robot: RobotFile) -> LabConfig:
    """A virtual lab for a robot, by preset name or by file.

    Raises:
        ConfigError: with file, key, value and what was expected.
    """
    path = preset("labs", name)
    lab = check(LabConfig, read_toml(path), str(path))
    try:
        lab.plant.check_names(robot)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    return lab
