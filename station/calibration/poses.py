"""Poses that were measured anywhere, read from a CSV file: columns by name, SI units, a row a pose.

What cannot be a file of poses is refused with the column or the line. A single row that is of no use (no number, a
joint beyond its travel, tubes that cannot stand so, no shape under that load) is left out and said so.
"""

import csv
import difflib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from core.calibration.measured import ways
from core.calibration.measurements import Measurement
from core.errors import CtrError
from core.model.solution import pure_force
from core.model.statics import Statics
from core.robot.limits import JointLimit
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.config.strict import read_text

TIP = ("tip_x", "tip_y", "tip_z")
FORCE = ("force_x", "force_y", "force_z")
TIME = "time"
#: For help and messages; the joints' names come with the robot.
COLUMNS = (
    "the robot's joints by their names [rad or m], tip_x, tip_y, tip_z [m]; where there are any force_x, force_y,"
    " force_z (on the tip, in the robot's frame) [N]; time [s] where the order matters"
)
#: More of a column than this beyond the joint's travel is another unit, not a slip.
OTHER_UNIT = 0.2
#: Cells that stand for a number that is missing.
MISSING = frozenset(("", "nan", "na", "n/a", "null", "none"))


class PosesError(CtrError):
    """A file that is none of measured poses; says which line or column, and what was expected."""


class LeftOut(NamedTuple):
    """A row that is of no use."""

    line: int  #: of the file
    reason: str


class Poses(NamedTuple):
    """Measured poses, in the order of their times if they have any."""

    path: Path
    lines: tuple[int, ...]  #: of the file, one for each pose
    measurements: tuple[Measurement, ...]  #: `coil` is the measured point, in whatever frame
    forces: Array  #: (m, 3) at the tip [N]
    timed: bool
    left_out: tuple[LeftOut, ...]


class _Row(NamedTuple):
    line: int
    time: float
    joints: Array
    tip: Array
    force: Array


def read_poses(path: Path, robot: RobotFile) -> Poses:
    """The poses of a file.

    Raises:
        PosesError: no such file, not a table, a column that is missing or unknown, text for a number, other units, or
            no pose that is of use.
    """
    header, lines = _table(path)
    names = [joint.name for joint in robot.joints]
    _check_columns(path, header, names)
    left: list[LeftOut] = []
    rows = [row for line, cells in lines if (row := _row(path, line, header, cells, names, left)) is not None]
    if not rows:
        raise PosesError(f"{path}: no row with a number in every column{_first(left)}; columns: {_columns(names)}")
    timed = TIME in header
    rows.sort(key=lambda row: row.time)
    _check_units(path, robot, rows)
    limits = robot.limits().joints
    standing = [row for row in rows if _stands(row, limits, left)]
    model = Statics(robot.robot(), integrator="fourth_order")
    useful = [row for row in standing if _has_shape(row, model, left)]
    if not useful:
        raise PosesError(
            f"{path}: '{robot.name}' can stand in none of {len(rows)} poses{_first(left)}; a translation is the place"
            " of the tube's proximal end from the front plate, behind it and so never positive"
        )
    came = ways(np.array([row.joints for row in useful])) if timed else None
    nothing = np.zeros((len(robot.tubes), 6))
    measurements = [
        Measurement(
            row.time, row.joints, row.tip, nothing, None if row.force.any() else 0.0, None if came is None else came[k]
        )
        for k, row in enumerate(useful)
    ]
    forces = np.array([row.force for row in useful])
    order = tuple(sorted(left, key=lambda each: each.line))
    return Poses(path, tuple(row.line for row in useful), tuple(measurements), forces, timed, order)


def _table(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Header, and the other rows with their lines."""
    reader = csv.reader(read_text(path, PosesError).splitlines(), skipinitialspace=True)
    try:
        rows = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader]
    except csv.Error as error:
        raise PosesError(f"{path}: line {reader.line_num}: not CSV: {error}") from None
    rows = [(line, cells) for line, cells in rows if any(cells) and not cells[0].startswith("#")]
    if not rows:
        raise PosesError(f"{path}: empty; columns: {COLUMNS}")
    return rows[0][1], rows[1:]


def _check_columns(path: Path, header: Sequence[str], joints: Sequence[str]) -> None:
    known = [*joints, *TIP, *FORCE, TIME]
    if len(header) == 1 and any(mark in header[0] for mark in ";\t"):
        raise PosesError(f"{path}: columns are separated by commas; the header is {header[0]!r}")
    if all(_number(cell) is not None for cell in header):
        raise PosesError(f"{path}: the first line is numbers; it names the columns: {_columns(joints)}")
    for name in header:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            meant = f", did you mean '{near[0]}'?" if near else ""
            raise PosesError(
                f"{path}: unknown column '{name}'{meant}; rename or remove it; columns: {_columns(joints)}"
            )
        if header.count(name) > 1:
            raise PosesError(f"{path}: column '{name}' is there {header.count(name)} times")
    some_force = any(name in header for name in FORCE)
    missing = [name for name in (*joints, *TIP, *(FORCE if some_force else ())) if name not in header]
    if missing:
        raise PosesError(f"{path}: no column {', '.join(map(repr, missing))}; columns: {_columns(joints)}")


def _columns(joints: Sequence[str]) -> str:
    return COLUMNS.replace("the robot's joints by their names", ", ".join(joints))


def _number(cell: str) -> float | None:
    """A cell's number, NaN for a missing one; None for text."""
    if cell.lower() in MISSING:
        return math.nan
    try:
        return float(cell)
    except ValueError:
        return None


def _row(
    path: Path, line: int, header: Sequence[str], cells: Sequence[str], joints: Sequence[str], left: list[LeftOut]
) -> _Row | None:
    if len(cells) != len(header):
        raise PosesError(f"{path}: line {line} has {len(cells)} columns, the header {len(header)}")
    values: dict[str, float] = {}
    for name, cell in zip(header, cells, strict=True):
        value = _number(cell)
        if value is None:
            raise PosesError(f"{path}: line {line}: {name} is {cell!r}, not a number")
        values[name] = value
    if wrong := [name for name, value in values.items() if not math.isfinite(value)]:
        left.append(LeftOut(line, f"{', '.join(wrong)}: no finite number"))
        return None

    def of(names: Sequence[str]) -> Array:
        return np.array([values.get(name, 0.0) for name in names])

    return _Row(line, values.get(TIME, 0.0), of(joints), of(TIP), of(FORCE))


def _check_units(path: Path, robot: RobotFile, rows: Sequence[_Row]) -> None:
    """Refuse degrees and millimetres: joints far beyond their travel, tips further apart than the robot is long."""
    joints = np.array([row.joints for row in rows])
    for column, limit in zip(joints.T, robot.limits().joints, strict=True):
        beyond = (column < limit.lower) | (column > limit.upper)
        if beyond.mean() > OTHER_UNIT:
            farthest = float(column[beyond][np.argmax(np.abs(column[beyond]))])
            unit, other = ("radians", "degrees") if limit.unit == "rad" else ("metres", "millimetres")
            raise PosesError(
                f"{path}: {limit.name} is {farthest:g} {limit.unit}, outside {limit.lower:.4g} ... {limit.upper:.4g}"
                f" {limit.unit} (its travel), and so are {int(beyond.sum())} of {len(column)} rows: are these {other}?"
                f" Give {unit}; if they are {unit}, widen lower and upper in the robot's file"
            )
    tips = np.array([row.tip for row in rows])
    length = max(tube.length for tube in robot.robot().tubes)
    apart = float(np.linalg.norm(np.ptp(tips, axis=0)))
    if apart > 4.0 * length:
        raise PosesError(
            f"{path}: the tips are {apart:.4g} m apart, and '{robot.name}' is {length:.4g} m long: are these"
            " millimetres? Give metres"
        )


def _stands(row: _Row, limits: Sequence[JointLimit], left: list[LeftOut]) -> bool:
    for limit, value in zip(limits, row.joints.tolist(), strict=True):
        if not limit.lower <= value <= limit.upper:
            left.append(
                LeftOut(
                    row.line,
                    f"{limit.name} {value:.4g} {limit.unit} is outside {limit.lower:.4g} ... {limit.upper:.4g}"
                    f" {limit.unit} (its travel)",
                )
            )
            return False
    return True


def _has_shape(row: _Row, model: Statics, left: list[LeftOut]) -> bool:
    try:
        model.solve(row.joints, pure_force(row.force))
    except CtrError as error:
        left.append(LeftOut(row.line, str(error)))
        return False
    return True


def _first(left: Sequence[LeftOut]) -> str:
    """The first reason, in brackets."""
    return f" (line {left[0].line}: {left[0].reason})" if left else ""


def recorded(poses: Poses, errors: Array, joints: Sequence[str]) -> Iterator[list[object]]:
    """Rows of a table of what was measured and errors (m, 3) [m]; the first names the columns."""
    yield ["line", *joints, *TIP, *FORCE, "error_x", "error_y", "error_z", "error"]
    for line, measurement, force, error in zip(poses.lines, poses.measurements, poses.forces, errors, strict=True):
        values = (*measurement.joints, *measurement.coil, *force, *error, np.linalg.norm(error))
        yield [line, *(f"{value:.9g}" for value in values)]
