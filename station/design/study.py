"""Study files: which tubes are searched, for what task, and what makes one robot better than another."""

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
    on_line,
    preset,
    read_toml,
)

#: What is searched: the largest load that is held, or what is least along the task under its own load.
Objective = Literal["load", "margin", "stiffness"]


class StudyTaskFile(Strict):
    """What the tubes are to do: bring the tip to every point, under every load."""

    points: Annotated[tuple[Vector, ...], Field(min_length=1, max_length=200, strict=False)]
    """of the tip, world frame, neighbours close to each other: the tubes go from one to the next [m]"""
    forces: Annotated[tuple[Vector, ...], Field(min_length=1, max_length=20, strict=False)]
    """at the tip, world frame; each of them comes at each of the points [N]"""
    tolerance: Positive = 1e-4
    """of the tip's place [m]"""
    margin: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.1
    """least margin of stability, everywhere: 1 is straight and unloaded, 0 snaps"""
    dexterity: NotNegative = 0.001
    """least speed of the tip in its slowest direction with the joints at full speed, everywhere [m/s]"""
    stiffness: NotNegative = 0.0
    """least stiffness of the tip in its softest direction, everywhere [N/m]"""

    @model_validator(mode="after")
    def _loaded(self) -> Self:
        if all(force == (0.0, 0.0, 0.0) for force in self.forces):
            raise ValueError("one of the forces must be more than 0 N")
        return self


class ParameterFile(Strict):
    """One number of the robot's file, and where it may lie."""

    key: str
    """TUBE.bending_stiffness, TUBE.sections.N.length or TUBE.sections.N.curvature (about x); sections count from 1"""
    lower: float
    """least value, in the key's own unit; any below `upper`"""
    upper: float
    """largest value, in the key's own unit; any above `lower`"""

    @model_validator(mode="after")
    def _room(self) -> Self:
        if not self.lower < self.upper:
            raise ValueError(f"'{self.key}': lower {self.lower:g} is not below upper {self.upper:g}")
        return self


class SearchFile(Strict):
    """How long is searched: differential evolution."""

    population: Annotated[int, Field(ge=2, le=100)] = 8
    """candidates of a generation for each parameter"""
    generations: Annotated[int, Field(ge=1, le=10_000)] = 40
    """how often all candidates are replaced"""
    seed: Annotated[int, Field(ge=0)] = 0
    """of what is drawn at random"""


class StudyFile(Strict):
    """A search for tubes."""

    format: Format = 1
    """of this file"""
    title: str
    """for people"""
    robot: str = "paper"
    """preset, or .toml file beside the study: what is changed, and what the outcome is held against"""
    objective: Objective = "load"
    """load: the largest multiple of the task's forces that is held; margin, stiffness: the least along the task"""
    task: StudyTaskFile
    """what the tubes are to do"""
    parameters: Annotated[tuple[ParameterFile, ...], Field(min_length=1, max_length=40, strict=False)]
    """the numbers of the tubes that are searched"""
    search: SearchFile = SearchFile()
    """how long"""


class Study:
    """A study that has been checked, with the robot that it begins from."""

    def __init__(self, file: StudyFile, robot: RobotFile, name: str) -> None:
        self.file, self.robot, self.name = file, robot, name
        self._places = [_place(parameter.key, robot) for parameter in file.parameters]
        self.bounds: list[tuple[float, float]] = [(each.lower, each.upper) for each in file.parameters]

    @property
    def begun(self) -> Array:
        """The parameters (p,) of the robot that the study begins from."""
        table = self.robot.model_dump()
        return np.array([_inner(table, place)[place[-1]] for place in self._places])

    def changed(self, values: Sequence[float]) -> RobotFile:
        """The robot with these parameters (p,).

        Raises:
            ConfigError: such a robot cannot be.

        """
        # What is not said stays unsaid: a working pose is one of the old tubes.
        table = self.robot.model_dump(exclude_none=True, exclude={"working_pose"})
        for place, value in zip(self._places, values, strict=True):
            _inner(table, place)[place[-1]] = float(value)
        try:
            file = RobotFile.model_validate(table)
            file.limits()
        except CtrError as error:
            raise ConfigError(str(error)) from None
        return file


def load_study(name: str) -> Study:
    """A study by preset name or by file.

    Raises:
        ConfigError: with file, key, value and what was expected.

    """
    path = preset("studies", name)
    table: Document = read_toml(path)
    file = check(StudyFile, table, str(path))
    beside = path.parent / file.robot
    try:
        robot = load_robot(str(beside) if beside.suffix == ".toml" else file.robot)
        study = Study(file, robot, path.stem)
        for ends in ([low for low, _ in study.bounds], [high for _, high in study.bounds]):
            study.changed(ends)
    except CtrError as error:
        raise ConfigError(f"{path}: {error}{on_line(table, str(error))}") from None
    return study


def _place(key: str, robot: RobotFile) -> tuple[str | int, ...]:
    """Where a key stands in the robot's table; the last part is a key or a number there.

    Raises:
        ConfigError: there is no such number.

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
            place = ("tubes", number, "sections", int(which) - 1)
            return (*place, "length") if what == "length" else (*place, "curvature", 0)
        case _:
            raise ConfigError(
                f"parameters: '{key}' is none of {name}.bending_stiffness, {name}.sections.N.length,"
                f" {name}.sections.N.curvature"
            )


def _inner(table: Mapping[str, Any], place: Sequence[str | int]) -> Any:
    """What holds the place's last part; tuples on the way become lists, to be changed."""
    at: Any = table
    for part in place[:-1]:
        if isinstance(at[part], tuple):
            at[part] = list(at[part])
        at = at[part]
    return at


def unit(key: str) -> str:
    """Of a parameter."""
    return {"bending_stiffness": "N m^2", "length": "m"}.get(key.rsplit(".", 1)[-1], "1/m")


def largest(forces: Sequence[Sequence[float]]) -> float:
    """The largest of the forces [N]."""
    return max(math.hypot(*force) for force in forces)
