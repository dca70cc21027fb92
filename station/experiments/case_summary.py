"""Human-readable summary of a case with numbers and units; the operator's page shows it before a run starts."""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

from core.control.controllers import STRATEGIES
from station.config.controllers import ControllerFile
from station.config.loads import Load, NoLoad, WallLoad
from station.config.motions import JointSweepMotion, WaypointsMotion
from station.config.robots import RobotFile
from station.config.strict import Strict
from station.config.units import format_quantity, unit_of_description
from station.experiments.experiment import Case


def load_windows(load: Load, duration: float) -> list[tuple[float, float]]:
    """Return start and end of each part of a motion [s]; the first part starts when the load does, at its onset."""
    return list(pairwise((*(time for time in load.changes if time < duration), duration)))


def window_name(start: float) -> str:
    """Return the name of a motion's part in a summary: the time of the load's change at its start, e.g. `2 s`."""
    return f"{start:g} s"


#: Keys of the table `[controller]` that the summary shows for the strategy `dual_layer`, which uses all of them.
CONTROLLER_KEYS = ("inner", "feedback", "k1", "k2", "feedforward", "filter_bandwidth", "stiffness")
KEYS_BY_STRATEGY: dict[str, tuple[str, ...]] = {
    "inner_loop": ("inner", "filter_bandwidth"),
    "dual_layer": CONTROLLER_KEYS,
}
AXES = "xyz"
DIRECTIONS = ("direction", "across", "normal", "axis")


class CaseFact(NamedTuple):
    """One line of a case's summary."""

    what: str
    text: str


def case_facts(case: Case) -> tuple[CaseFact, ...]:
    """Return everything that an operator should know about a case before its start."""
    file = case.file
    sweep = file.trajectory if isinstance(file.trajectory, JointSweepMotion) else None
    rotations = [joint.name for joint in case.robot.joints if joint.motion == "rotation"]
    turns = sweep is None or sweep.joint in rotations
    found = [
        CaseFact("motion", describe_keys(file.trajectory, turns=turns)),
        CaseFact("load", describe_keys(file.load)),
        CaseFact("control", describe_controller(file.controller)),
        CaseFact("model", case.controller.statics.discretisation),
        CaseFact(
            "duration",
            f"{format_quantity(file.duration, 's')}, errors count from {format_quantity(file.counted_from, 's')} on",
        ),
        CaseFact("start pose", describe_pose(file.start, case.robot)),
    ]
    if file.faults:
        found.append(CaseFact("faults", "; ".join(describe_keys(fault) for fault in file.faults)))
    if file.calibration:
        found.append(CaseFact("calibration", file.calibration))
    return tuple(found)


def describe_controller(file: ControllerFile) -> str:
    """Return the strategy of a controller with the values of the keys that this strategy uses."""
    # An installed outer loop may use every key, and has additional keys.
    keys = KEYS_BY_STRATEGY.get(file.strategy, () if file.strategy in STRATEGIES else CONTROLLER_KEYS)
    own = (
        f"{name}: {', '.join(f'{key} {value}' for key, value in keys.items())}" for name, keys in file.options.items()
    )
    task = () if file.task == "position" else (_words(file.task),)
    frame = () if file.stiffness is None else ("stiffness_frame",)
    return ", ".join((_words(file.strategy), *task, *_parts(file, keys + frame), *file.tasks, *file.limits, *own))


def describe_keys(model: Strict, *, turns: bool = True) -> str:
    """Return kind and keys of a motion, load or fault as a text with numbers and units.

    `turns`: whether a swept joint is rotational, so that its values are angles.
    """
    if isinstance(model, WaypointsMotion):
        reach = max(math.hypot(*point[1:]) for point in model.points)
        count = len(model.points)
        text = f"{count} point{'s' * (count > 1)} in {format_quantity(model.points[-1][0], 's')}"
        return f"waypoints: {text}, up to {format_quantity(reach, 'm')} from the start"
    unused = model.without_effect if isinstance(model, WallLoad) else ()
    keys = tuple(key for key in type(model).model_fields if key != "kind" and key not in unused)
    parts = ", ".join(_parts(model, keys, turns=turns))
    kind = _words(str(getattr(model, "kind", "")))
    return f"{kind}: {parts}" if parts else kind


def case_words(case: Case, experiment_title: str) -> str:
    """Return a short human-readable name of a case: its title, or its name if it has the experiment's title."""
    return case.file.title if case.file.title != experiment_title else ", ".join(_words(case.name).split("-"))


def motion_title(motion: Strict, load: Strict) -> str:
    """Return a title of a free motion: motion and load with the values that differ from their defaults."""
    title = describe_keys(motion) if isinstance(motion, WaypointsMotion) else _changed_keys(motion)
    return title if isinstance(load, NoLoad) else f"{title}; load {_changed_keys(load)}"


def _changed_keys(model: Strict) -> str:
    """Return kind and keys of a motion or load as a text, without the keys that have their default values."""
    fields = type(model).model_fields
    keys = tuple(key for key, field in fields.items() if key != "kind" and getattr(model, key) != field.default)
    return ", ".join((_words(str(getattr(model, "kind", ""))), *_parts(model, keys)))


def describe_pose(joints: Mapping[str, float], robot: RobotFile) -> str:
    """Return a text with the position and the unit of each joint."""
    units = {joint.name: "rad" if joint.motion == "rotation" else "m" for joint in robot.joints}
    return ", ".join(f"{_words(name)} {format_quantity(value, units[name])}" for name, value in joints.items())


def _parts(model: Strict, keys: tuple[str, ...], *, turns: bool = True) -> list[str]:
    fields = type(model).model_fields
    return [
        text
        for key in keys
        if (text := _part(key, getattr(model, key), unit_of_description(fields[key].description, turns=turns)))
    ]


def _part(key: str, value: Any, unit: str) -> str:
    """Return a key and its value as a text; empty for a value that means "not used": None, False or an empty list."""
    if value is None or value is False or value == ():
        return ""
    if key == "directions":
        return f"{len(value)} directions in {format_quantity(value[-1][0], 's')}"
    if value is True:
        return _words(key)
    if isinstance(value, Strict):
        return f"{_words(key)} {describe_keys(value)}"
    if isinstance(value, tuple):
        word = "across" if key == "across" else "along"
        return f"{word} {_direction(value)}" if key in DIRECTIONS else f"{_words(key)} {_row(value, unit)}"
    return f"{_words(key)} {format_quantity(value, unit) if isinstance(value, float | int) else _words(str(value))}"


def _row(values: tuple[float, ...], unit: str) -> str:
    *others, last = values
    return ", ".join((*(format_quantity(value, unit).split(" ")[0] for value in others), format_quantity(last, unit)))


def _direction(values: tuple[float, ...]) -> str:
    """Return a direction as the name of an axis with its sign, or as three numbers if it is not along an axis."""
    one = [axis for axis, value in zip(AXES, values, strict=True) if value]
    if len(one) == 1:
        return f"{'-' if sum(values) < 0.0 else ''}{one[0]}"
    return f"({_row(values, '')})"


def _words(name: str) -> str:
    return name.replace("_", " ")
