"""What a case does, in words with numbers and units, as the page tells it before the start."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from station.config.controllers import ControllerFile
from station.config.motions import JointSweepMotion, WaypointsMotion
from station.config.robots import RobotFile
from station.config.strict import Strict
from station.config.units import shown, unit_in
from station.experiments.experiment import Case

#: Keys of a controller that matter to each strategy.
GAINS = ("inner", "feedback", "k1", "k2", "feedforward", "filter_bandwidth")
MATTER: dict[str, tuple[str, ...]] = {"inner_loop": ("inner", "filter_bandwidth"), "dual_layer": GAINS}
AXES = "xyz"
DIRECTIONS = ("direction", "normal", "axis")


class Fact(NamedTuple):
    """One line of what a case does."""

    what: str
    text: str


def facts(case: Case) -> tuple[Fact, ...]:
    """Everything that a person should know of a case before it is started."""
    file = case.file
    sweep = file.trajectory if isinstance(file.trajectory, JointSweepMotion) else None
    rotations = [joint.name for joint in case.robot.joints if joint.motion == "rotation"]
    turns = sweep is None or sweep.joint in rotations
    found = [
        Fact("motion", described(file.trajectory, turns=turns)),
        Fact("load", described(file.load)),
        Fact("control", control(file.controller)),
        Fact("duration", f"{shown(file.duration, 's')}, errors count from {shown(file.counted_from, 's')} on"),
        Fact("start pose", pose(file.start, case.robot)),
    ]
    if file.faults:
        found.append(Fact("faults", "; ".join(described(fault) for fault in file.faults)))
    if file.calibration:
        found.append(Fact("calibration", file.calibration))
    return tuple(found)


def control(file: ControllerFile) -> str:
    """A controller by its strategy and what matters to it."""
    keys = MATTER.get(file.strategy, ())
    task = () if file.task == "position" else (_words(file.task),)
    return ", ".join((_words(file.strategy), *task, *_parts(file, keys)))


def described(model: Strict, *, turns: bool = True) -> str:
    """A motion, load or fault: its kind, and its keys with numbers and units; `turns`: of a joint that is turned."""
    if isinstance(model, WaypointsMotion):
        reach = max(math.hypot(*point[1:]) for point in model.points)
        count = len(model.points)
        text = f"{count} point{'s' * (count > 1)} in {shown(model.points[-1][0], 's')}"
        return f"waypoints: {text}, up to {shown(reach, 'm')} from the start"
    keys = tuple(key for key in type(model).model_fields if key != "kind")
    parts = ", ".join(_parts(model, keys, turns=turns))
    kind = _words(str(getattr(model, "kind", "")))
    return f"{kind}: {parts}" if parts else kind


def pose(joints: Mapping[str, float], robot: RobotFile) -> str:
    """Where joints stand."""
    units = {joint.name: "rad" if joint.motion == "rotation" else "m" for joint in robot.joints}
    return ", ".join(f"{_words(name)} {shown(value, units[name])}" for name, value in joints.items())


def _parts(model: Strict, keys: tuple[str, ...], *, turns: bool = True) -> list[str]:
    fields = type(model).model_fields
    return [
        text for key in keys if (text := _part(key, getattr(model, key), unit_in(fields[key].description, turns=turns)))
    ]


def _part(key: str, value: Any, unit: str) -> str:
    """One key; empty when it says nothing."""
    if value is None or value is False or value == ():
        return ""
    if key == "directions":
        return f"{len(value)} directions in {shown(value[-1][0], 's')}"
    if value is True:
        return _words(key)
    if key == "directions":
        count = len(value)
        return f"pointing in {count} direction{'s' * (count > 1)}, the last at {shown(value[-1][0], 's')}"
    if isinstance(value, tuple):
        return f"along {_direction(value)}" if key in DIRECTIONS else f"{_words(key)} {_row(value, unit)}"
    return f"{_words(key)} {shown(value, unit) if isinstance(value, float | int) else _words(str(value))}"


def _row(values: tuple[float, ...], unit: str) -> str:
    *others, last = values
    return ", ".join((*(shown(value, unit).split(" ")[0] for value in others), shown(last, unit)))


def _direction(values: tuple[float, ...]) -> str:
    """An axis by its name, any other direction by its numbers."""
    one = [axis for axis, value in zip(AXES, values, strict=True) if value]
    if len(one) == 1:
        return f"{'-' if sum(values) < 0.0 else ''}{one[0]}"
    return f"({_row(values, '')})"


def _words(name: str) -> str:
    return name.replace("_", " ")
