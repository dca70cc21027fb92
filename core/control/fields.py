"""Description of the numbers that each tick records: name, unit, meaning, and the source of the value.

Telemetry, recordings, live streams and a table in the documents are all made from these descriptions.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from core.robot.robot import Robot

#: Source of a field's values. It decides when the values are unknown or come from an earlier tick.
Writer = Literal[
    "loop",  # the station's control loop: always known
    "stages",  # readings of the stages: always known
    "sensors",  # readings of the force sensors
    "tracker",  # readings of the tracker, and estimates that need them
    "force",  # estimates that need the force sensors
    "force or deflection",  # as "force"; on a bench without force sensors, estimates from the measured deflection
    "controller",  # computed in each tick of the controller
    "lab",  # the true values of a virtual lab
]
#: Function of a robot and a field's unit: returns name and unit of each part; a single number has an empty name.
Parts = Callable[[Robot, str], list[tuple[str, str]]]
XYZ = ("x", "y", "z")
#: Parts of a wrench and their units.
WRENCH = (("f", "N"), ("m", "N m"))


class Field(NamedTuple):
    """A number, or a group of numbers, of each tick."""

    name: str
    unit: str
    meaning: str
    by: Writer
    parts: Parts
    #: source of the values in the record of a tick: path of an attribute (empty: the field's name), or a function of
    #: the record; None: the values do not come from this record
    read: str | Callable[[Any], Any] | None = ""
    streamed: bool = False  #: whether live clients receive the field


def one(_robot: Robot, unit: str) -> list[tuple[str, str]]:
    """Return the only part of a field with a single number."""
    return [("", unit)]


def vector(_robot: Robot, unit: str) -> list[tuple[str, str]]:
    """Return the parts x, y and z of a vector."""
    return [(axis, unit) for axis in XYZ]


def direction(robot: Robot, unit: str) -> list[tuple[str, str]]:
    """Return the parts of a unit vector; all are 0 while the direction is neither measured nor controlled."""
    return vector(robot, unit)


def named(*names: str, units: tuple[str, ...] = ()) -> Parts:
    """Return a function that gives parts with these names; `units` replaces the field's unit if the parts differ."""
    return lambda _robot, unit: [(name, units[at] if units else unit) for at, name in enumerate(names)]


def joints(robot: Robot, per: str) -> list[tuple[str, str]]:
    """Return one part for each joint; its unit is the joint's unit followed by `per`."""
    return [(joint.name, joint.unit + per) for joint in robot.joints]


def joint_flags(robot: Robot, unit: str) -> list[tuple[str, str]]:
    """Return one part for each joint, with the field's unit instead of the joint's."""
    return [(joint.name, unit) for joint in robot.joints]


def base_wrenches(robot: Robot, _unit: str) -> list[tuple[str, str]]:
    """Return three forces and three moments for each force sensor."""
    return [(f"{name}_{kind}{axis}", unit) for name in robot.sensor_names for kind, unit in WRENCH for axis in XYZ]


def singular_values(robot: Robot, unit: str) -> list[tuple[str, str]]:
    """Return one part for each recorded singular value of the Jacobian."""
    return [(str(number), unit) for number in range(1, min(3, len(robot.joints)) + 1)]
