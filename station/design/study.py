"""Study files: each has a task, the parameters of the tubes that a search may change, and the objective."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import RobotFile, load_robot
from station.config.strict import (
    ConfigError,
    Document,
    Format,
    NotNegative,
    Positive,
    Strict,
    Vector,
    check,
    line_reference,
    preset,
    read_toml,
)

#: Quantity to maximise: largest load that the robot holds, or smallest margin or stiffness along the loaded task.
Objective = Literal["load", "margin", "stiffness"]


class StudyTaskFile(Strict):
    """Task of the tubes: bring the tip to every point under every load."""

    points: Annotated[tuple[Vector, ...], Field(min_length=1, max_length=200, strict=False)]
    """desired tip positions in the world frame, in the order of the motion and close to each other [m]"""
    forces: Annotated[tuple[Vector, ...], Field(min_length=1, max_length=20, strict=False)]
    """forces at the tip in the world frame; each acts at each of the points [N]"""
    tolerance: Positive = 1e-4
    """largest distance of the tip from a point [m]"""
    margin: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.1
    """smallest allowed margin of stability: 1 is straight and unloaded, 0 snaps"""
    dexterity: NotNegative = 0.001
    """smallest allowed speed of the tip in its slowest direction with the joints at full speed [m/s]"""
    stiffness: NotNegative = 0.0
    """smallest allowed stiffness of the tip in its softest direction [N/m]"""

    @model_validator(mode="after")
    def _loaded(self) -> Self:
        if all(force == (0.0, 0.0, 0.0) for force in self.forces):
            raise ValueError("at least one of the forces must be more than 0 N")
        return self


class ParameterFile(Strict):
    """Number of the robot's file that the search changes, with its range."""

    key: str
    """TUBE.bending_stiffness, TUBE.sections.N.length or TUBE.sections.N.curvature (about x); sections count from 1"""
    lower: float
    """smallest value, in the unit of the key; must be below `upper`"""
    upper: float
    """largest value, in the unit of the key; must be above `lower`"""

    @model_validator(mode="after")
    def _range(self) -> Self:
        if not self.lower < self.upper:
            raise ValueError(f"'{self.key}': lower {self.lower:g} is not below upper {self.upper:g}")
        return self


class SearchFile(Strict):
    """Length of the search by differential evolution."""

    population: Annotated[int, Field(ge=2, le=100)] = 8
    """candidates of a generation for each parameter"""
    generations: Annotated[int, Field(ge=1, le=10_000)] = 40
    """number of generations"""
    seed: Annotated[int, Field(ge=0)] = 0
    """seed of the random numbers"""


class StudyFile(Strict):
    """File of a study that searches for tubes."""

    format: Format = 1
    """format of this file"""
    title: str
    """title of the report"""
    robot: str = "paper"
    """start robot: preset, or .toml file in the folder of the study; the result is compared with it"""
    objective: Objective = "load"
    """load: largest held multiple of the task's forces; margin, stiffness: smallest value along the task"""
    task: StudyTaskFile
    """task of the tubes"""
    parameters: Annotated[tuple[ParameterFile, ...], Field(min_length=1, max_length=40, strict=False)]
    """numbers of the tubes that the search changes"""
    search: SearchFile = SearchFile()
    """length of the search"""


class Study:
    """A checked study with its start robot."""

    def __init__(self, file: StudyFile, robot: RobotFile, name: str) -> None:
        self.file, self.robot, self.name = file, robot, name
        self._paths = [_path(parameter.key, robot) for parameter in file.parameters]
        self.bounds: list[tuple[float, float]] = [(each.lower, each.upper) for each in file.parameters]

    @property
    def start_parameters(self) -> Array:
        """Values of the searched parameters (p,) in the start robot."""
        table = self.robot.model_dump()
        return np.array([_inner(table, path)[path[-1]] for path in self._paths])

    def changed(self, values: Sequence[float]) -> RobotFile:
        """Return the start robot with the new values (p,) of the searched parameters.

        Raises:
            ConfigError: these values give no valid robot.

        """
        # The working pose of the start robot is not valid for other tubes, so it is left out.
        table = self.robot.model_dump(exclude_none=True, exclude={"working_pose"})
        for path, value in zip(self._paths, values, strict=True):
            _inner(table, path)[path[-1]] = float(value)
        try:
            file = check(RobotFile, table, "the searched robot")
            file.limits()
        except CtrError as error:
            raise ConfigError(str(error)) from None
        return file


def load_study(name: str) -> Study:
    """Return a study by preset name or file.

    Raises:
        ConfigError: the study is invalid; the message names file, key, value and the expected value.

    """
    path = preset("studies", name)
    table: Document = read_toml(path)
    file = check(StudyFile, table, str(path))
    robot_path = path.parent / file.robot
    try:
        robot = load_robot(str(robot_path) if robot_path.suffix == ".toml" else file.robot)
        study = Study(file, robot, path.stem)
        for ends in ([low for low, _ in study.bounds], [high for _, high in study.bounds]):
            study.changed(ends)
    except CtrError as error:
        raise ConfigError(f"{path}: {error}{line_reference(table, str(error))}") from None
    return study


def _path(key: str, robot: RobotFile) -> tuple[str | int, ...]:
    """Return the path of a parameter's key in the robot's table: a sequence of keys and list indices.

    Raises:
        ConfigError: the robot has no number with this key.

    """
    name, _, rest = key.partition(".")
    names = [tube.name for tube in robot.tubes]
    if name not in names:
        raise ConfigError(f"parameters: '{key}': robot '{robot.name}' has no tube '{name}'; it has {', '.join(names)}")
    number = names.index(name)
    if rest == "bending_stiffness":
        return ("tubes", number, rest)
    match rest.split("."):
        case ["sections", which, ("length" | "curvature") as what] if which.isdecimal():
            sections = len(robot.tubes[number].sections)
            if not 1 <= int(which) <= sections:
                raise ConfigError(f"parameters: '{key}': tube '{name}' has the sections 1 ... {sections}")
            section = ("tubes", number, "sections", int(which) - 1)
            return (*section, "length") if what == "length" else (*section, "curvature", 0)
        case _:
            raise ConfigError(
                f"parameters: '{key}' is none of {name}.bending_stiffness, {name}.sections.N.length,"
                f" {name}.sections.N.curvature"
            )


def _inner(table: Mapping[str, Any], path: Sequence[str | int]) -> Any:
    """Return the table or list that contains the last part of a path.

    Tuples along the path are replaced by lists, so that their elements can be changed.
    """
    at: Any = table
    for part in path[:-1]:
        if isinstance(at[part], tuple):
            at[part] = list(at[part])
        at = at[part]
    return at


def unit(key: str) -> str:
    """Return the unit of a searched parameter by its key."""
    return {"bending_stiffness": "N m^2", "length": "m"}.get(key.rsplit(".", 1)[-1], "1/m")


def largest(forces: Sequence[Sequence[float]]) -> float:
    """Return the magnitude of the largest force [N]."""
    return max(math.hypot(*force) for force in forces)
