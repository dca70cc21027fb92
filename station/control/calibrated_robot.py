"""Keys of a robot's file that a calibration replaces, and changes of the file that make a calibration wrong.

A calibration folder keeps the robot's file for which it was made (`described.toml`). All keys that a calibration has
not measured come from the present robot's file.
"""

import math
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple, cast

from core.errors import CtrError
from station.config.robots import RobotFile, TubeFile, check_robot
from station.config.strict import ConfigError

REGISTRATION_FILE, SENSORS_FILE, ROBOT_FILE = "registration.toml", "sensors.toml", "robot.toml"
#: Learned residual of the model; `ctr-station calibrate residual` writes it.
RESIDUAL_FILE = "residual.toml"
#: Latency of the tracker; `ctr-station calibrate latency` writes it.
LATENCY_FILE = "latency.toml"
#: Lenses and poses of cameras; `ctr-station cameras calibrate` writes it.
CAMERAS_FILE = "cameras.toml"
#: The robot's file for which the files of the folder were made.
DESCRIBED_FILE = "described.toml"


class CalibrationKind(NamedTuple):
    """Keys of the robot's file that a calibration file replaces, and keys on which it depends."""

    replaces: tuple[str, ...] = ()  #: patterns of the keys of the robot's file that it replaces
    made_for: tuple[str, ...] = ()  #: patterns of the keys that must not have changed since; any change is refused


#: Keys that assign motors to tubes.
_DRIVES = ("joints.*.name", "joints.*.tube", "joints.*.motion")
#: Keys of the robot's file that each calibration file replaces, and those on which it depends. The patterns match
#: dotted keys, which contain the names of tubes and joints, and the numbers of sections from 1.
KINDS: Mapping[str, CalibrationKind] = {
    REGISTRATION_FILE: CalibrationKind((), ("tubes.*", "base.*", *_DRIVES)),
    SENSORS_FILE: CalibrationKind((), ("tubes.*.name", "base.rotation_vector")),
    ROBOT_FILE: CalibrationKind(
        (
            "tubes.*.bending_stiffness",
            "tubes.*.poisson_ratio",
            "tubes.*.torsional_stiffness",
            "tubes.*.sections.*.length",
            "tubes.*.sections.*.curvature",
        ),
        ("tubes.*", *_DRIVES),
    ),
    RESIDUAL_FILE: CalibrationKind((), ("tubes.*", "base.*", *_DRIVES)),
    LATENCY_FILE: CalibrationKind(),
    CAMERAS_FILE: CalibrationKind(),
}
#: Keys whose changes do not concern a calibration: limits, texts, and the accuracy of the model. The values of the
#: robot's file apply.
INDEPENDENT = (
    "format", "name", "source", "working_pose.*", "workspace.*", "max_force", "integrator", "ends_in_order",
    "joints.*.lower", "joints.*.upper", "joints.*.speed", "joints.*.acceleration",
)  # fmt: skip

#: Largest factor between calibrated and described bending stiffness or curvature. Tubes made to a drawing differ by
#: 10 % (one standard deviation); heat-set nylon was measured with 0.67 of its described curvature.
STIFFNESS_FACTOR, CURVATURE_FACTOR = 2.0, 2.0
#: Largest factor between calibrated and described GJ; GJ differs by 25 %, and more if the tube is patterned.
TORSION_FACTOR = 4.0
#: Largest change of Poisson's ratio, five standard deviations of its prior.
POISSON_CHANGE = 0.25
#: Largest change of a section's length [m], four standard deviations of the prior of a tube's effective end.
LENGTH_CHANGE_M = 0.02
#: Largest change of a curve's direction [rad], nine standard deviations of a zero angle that was set by hand.
ZERO_ANGLE_CHANGE_RAD = math.radians(45.0)


def calibrated_robot(described: RobotFile, calibrated: RobotFile, path: Path) -> RobotFile:
    """Return the robot's file `described` with the measured keys of `calibrated`, which was read from `path`.

    Raises:
        ConfigError: a calibrated value is not plausible, or the calibrated tubes and the limits do not fit together.
    """
    for tube, new in zip(described.tubes, calibrated.tubes, strict=True):
        for key, value, lower, upper, unit in _ranges(tube, new):
            if not lower <= value <= upper:
                raise ConfigError(
                    f"{path}: tubes.{tube.name}.{key} = {value:.6g}{unit} is outside {lower:.6g} ... {upper:.6g}{unit},"
                    " the plausible range for the tube in the robot's file; calibrate again, or correct the robot's"
                    " file"
                )
    values = _replaced(described.model_dump(), calibrated.model_dump(), KINDS[ROBOT_FILE].replaces, "")
    robot = type(described).model_validate(values).sensed_at(described.robot().sensed, "sensors")
    try:
        check_robot(robot)
    except CtrError as error:
        raise ConfigError(f"{path}: the calibrated tubes do not fit the robot's file: {error}") from None
    return robot


def check_made_for(folder: Path, files: tuple[str, ...], made_for: RobotFile, now: RobotFile) -> tuple[str, ...]:
    """Compare the robot's file for which a calibration was made with the present one.

    Args:
        folder: folder of the calibration, for messages.
        files: names of the calibration's files to check.
        made_for: robot's file for which they were made.
        now: robot's file of the station or run.

    Returns:
        A warning for each change that neither makes the calibration wrong nor is independent of it.

    Raises:
        ConfigError: a change makes the calibration wrong; the message has the key and both values.
    """
    warnings: list[str] = []
    before, present = dict(_keys(made_for.model_dump())), dict(_keys(now.model_dump()))
    for key in (*before, *(key for key in present if key not in before)):
        was, is_ = before.get(key), present.get(key)
        if was == is_:
            continue
        for file in files:
            if _matches(key, KINDS[file].made_for):
                raise ConfigError(
                    f"{folder / file}: made for {key} = {_shown(was)}, but the robot's file now has {_shown(is_)}:"
                    " calibrate again, or correct the robot's file"
                )
        if not _matches(key, INDEPENDENT):
            warnings.append(
                f"calibration {folder} was made with {key} = {_shown(was)}, but the robot's file now has"
                f" {_shown(is_)}, which applies; check the calibration"
            )
    return tuple(warnings)


def check_unmeasured(path: Path, calibrated: RobotFile, now: RobotFile) -> tuple[str, ...]:
    """Compare the keys that a calibrated robot file copied from the robot's file with the present robot's file.

    Raises:
        ConfigError: as for `check_made_for`.
    """
    values = _replaced(calibrated.model_dump(), now.model_dump(), KINDS[ROBOT_FILE].replaces, "")
    return check_made_for(path.parent, (path.name,), type(calibrated).model_validate(values), now)


def _ranges(tube: TubeFile, new: TubeFile) -> Iterator[tuple[str, float, float, float, str]]:
    """Yield key, calibrated value, smallest and largest plausible value, and unit of each measured number of a tube."""
    stiffness = tube.bending_stiffness
    yield (
        "bending_stiffness", new.bending_stiffness,
        stiffness / STIFFNESS_FACTOR, stiffness * STIFFNESS_FACTOR, " N m^2",
    )  # fmt: skip
    nu = tube.poisson_ratio
    yield "poisson_ratio", new.poisson_ratio, nu - POISSON_CHANGE, nu + POISSON_CHANGE, ""
    torsion = _torsion(tube)
    yield "torsional_stiffness", _torsion(new), torsion / TORSION_FACTOR, torsion * TORSION_FACTOR, " N m^2"
    for number, (old, section) in enumerate(zip(tube.sections, new.sections, strict=True), 1):
        where = f"sections.{number}."
        length = old.length
        yield (
            where + "length", section.length,
            max(length - LENGTH_CHANGE_M, 0.1 * length), length + LENGTH_CHANGE_M, " m",
        )  # fmt: skip
        bent, curvature = math.hypot(*old.curvature), math.hypot(*section.curvature)
        yield where + "curvature", curvature, bent / CURVATURE_FACTOR, bent * CURVATURE_FACTOR, " 1/m"
        if bent > 0.0:
            (x, y), (u, v) = old.curvature, section.curvature
            turned = math.atan2(x * v - y * u, x * u + y * v)
            yield (
                where + "curvature, direction from the described one", turned,
                -ZERO_ANGLE_CHANGE_RAD, ZERO_ANGLE_CHANGE_RAD, " rad",
            )  # fmt: skip


def _torsion(tube: TubeFile) -> float:
    """Return the torsional stiffness GJ [N m^2]."""
    return tube.torsional_stiffness or tube.bending_stiffness / (1.0 + tube.poisson_ratio)


def _replaced(described: Any, calibrated: Any, patterns: tuple[str, ...], at: str) -> Any:
    """Return `described` with the values of `calibrated` at the keys that match the patterns."""
    if isinstance(described, Mapping) and isinstance(calibrated, Mapping):
        ours, theirs = cast(Mapping[str, Any], described), cast(Mapping[str, Any], calibrated)
        return {key: _replaced(value, theirs.get(key), patterns, f"{at}{key}.") for key, value in ours.items()}
    if _is_list(described) and _is_list(calibrated) and len(described) == len(calibrated):
        pairs = enumerate(zip(described, calibrated, strict=True), 1)
        return tuple(_replaced(ours, theirs, patterns, f"{at}{number}.") for number, (ours, theirs) in pairs)
    return calibrated if _matches(at[:-1], patterns) else described


def _keys(value: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each key with its value. Items of lists have their names or numbers from 1; `count` is their number."""
    if isinstance(value, Mapping):
        for key, one in cast(Mapping[str, Any], value).items():
            yield from _keys(one, f"{at}{key}.")
    elif _is_list(value):
        yield f"{at}count", len(value)
        for number, one in enumerate(value, 1):
            yield from _keys(one, f"{at}{one.get('name', number)}.")
    else:
        yield at[:-1], value


def _is_list(value: Any) -> bool:
    """Return whether a value is a list of tables."""
    return isinstance(value, tuple | list) and all(isinstance(one, Mapping) for one in cast(list[Any], value))


def _matches(key: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatchcase(key, pattern) or fnmatchcase(f"{key}.", pattern) for pattern in patterns)


def _shown(value: Any) -> str:
    return "no value" if value is None else repr(list(value) if isinstance(value, tuple) else value)
