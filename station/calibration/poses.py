"""Poses measured elsewhere, read from a CSV file: named columns, SI units, one row per pose.

An invalid file is refused; the message names the column or the line. An unusable row (missing number, a joint
beyond its travel, no shape under the load) is left out and reported.
"""

import difflib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.calibration.external_poses import arrival_directions
from core.calibration.measurements import Measurement
from core.calibration.residual import paths
from core.errors import CtrError
from core.model.solution import pure_force
from core.model.statics import Statics
from core.robot.limits import JointLimit
from core.robot.robot import Array, Robot
from station.calibration.columns import COLUMNS_HELP, ColumnChoice, PosesError, cell_number, pose_table
from station.config.robots import RobotFile

TIP_COLUMNS = ("tip_x", "tip_y", "tip_z")
FORCE_COLUMNS = ("force_x", "force_y", "force_z")
TIME_COLUMN, TRAJECTORY_COLUMN = "time", "trajectory"
#: Number of trajectories of a file without labels: parts of consecutive poses.
DEFAULT_TRAJECTORIES = 5
#: Share of a column's values beyond the joint's travel above which the column is refused as having a wrong unit.
WRONG_UNIT_SHARE = 0.2
#: Largest distance by which a tube may end behind its outer neighbour and still count as flush, because joint positions
#: and lengths in files are rounded [m].
FLUSH_TOLERANCE_M = 0.5e-3


class RejectedPose(NamedTuple):
    """An unusable row of a file of poses, which is left out."""

    line: int  #: line number in the file
    reason: str


class Poses(NamedTuple):
    """Measured poses, in the order of their times if they have any."""

    path: Path
    lines: tuple[int, ...]  #: line number in the file of each pose
    measurements: tuple[Measurement, ...]  #: measurement of each pose; its `coil` is the measured point, in any frame
    forces: Array  #: (m, 3) force at the tip at each pose [N]
    trajectories: NDArray[np.int64]  #: (m,) trajectory of each pose
    timed: bool
    left_out: tuple[RejectedPose, ...]
    moved_flush: float = 0.0  #: largest shift of a translation to make tubes end flush [m]


class _Row(NamedTuple):
    line: int
    time: float
    trajectory: float
    joints: Array
    tip: Array
    force: Array


def read_poses(path: Path, robot: RobotFile, choices: Sequence[ColumnChoice] = ()) -> Poses:
    """Read the poses of a file, from the chosen columns if there are choices.

    Raises:
        PosesError: the file is missing or not a table, a column is missing, unknown or in a wrong unit, a cell is not a
            number, or no pose is usable.
    """
    header, lines = pose_table(path, choices)
    names = [joint.name for joint in robot.joints]
    _check_columns(path, header, names)
    left: list[RejectedPose] = []
    rows = [row for line, cells in lines if (row := _row(path, line, header, cells, names, left)) is not None]
    if not rows:
        raise PosesError(f"{path}: no row with a number in every column{_first(left)}; columns: {_columns(names)}")
    timed = TIME_COLUMN in header
    rows.sort(key=lambda row: row.time)
    _check_units(path, robot, rows)
    limits = robot.limits().joints
    feasible = [_flush(row, robot.robot()) for row in rows if _is_feasible(row, limits, left)]
    model = Statics(robot.robot(), integrator="fourth_order")
    useful = [row for row in feasible if _has_shape(row, model, left)]
    if not useful:
        raise PosesError(
            f"{path}: '{robot.name}' can take none of {len(rows)} poses{_first(left)}; a translation is the position of"
            " the tube's proximal end relative to the front plate, behind it and therefore never positive"
        )
    joints = np.array([row.joints for row in useful])
    read = {row.line: row.joints for row in rows}
    moved = max(float(np.abs(row.joints - read[row.line]).max()) for row in useful)
    came, history = (arrival_directions(joints), paths(joints)) if timed else (None, None)
    no_wrenches = np.zeros((len(robot.sensor_names), 6))
    measurements = [
        Measurement(
            row.time,
            row.joints,
            row.tip,
            no_wrenches,
            None if row.force.any() else 0.0,
            came=None if came is None else came[k],
            path=None if history is None else history[k],
        )
        for k, row in enumerate(useful)
    ]
    forces = np.array([row.force for row in useful])
    order = tuple(sorted(left, key=lambda each: each.line))
    trajectories = np.array([row.trajectory for row in useful]).astype(np.int64)
    if np.ptp(trajectories) == 0:
        trajectories = np.arange(len(useful)) * DEFAULT_TRAJECTORIES // len(useful)
    lines = tuple(row.line for row in useful)
    return Poses(path, lines, tuple(measurements), forces, trajectories, timed, order, moved)


def _check_columns(path: Path, header: Sequence[str], joints: Sequence[str]) -> None:
    known = [*joints, *TIP_COLUMNS, *FORCE_COLUMNS, TIME_COLUMN, TRAJECTORY_COLUMN]
    if len(header) == 1 and any(mark in header[0] for mark in ";\t"):
        raise PosesError(f"{path}: columns are separated by commas; the header is {header[0]!r}")
    if all(cell_number(cell) is not None for cell in header):
        raise PosesError(f"{path}: the first line contains numbers, but it must name the columns: {_columns(joints)}")
    for name in header:
        if name not in known:
            similar = difflib.get_close_matches(name, known, 1)
            hint = f", did you mean '{similar[0]}'?" if similar else ""
            raise PosesError(
                f"{path}: unknown column '{name}'{hint}; rename or remove it, or choose columns by --columns;"
                f" columns: {_columns(joints)}"
            )
        if header.count(name) > 1:
            raise PosesError(f"{path}: column '{name}' occurs {header.count(name)} times")
    some_force = any(name in header for name in FORCE_COLUMNS)
    missing = [name for name in (*joints, *TIP_COLUMNS, *(FORCE_COLUMNS if some_force else ())) if name not in header]
    if missing:
        raise PosesError(f"{path}: no column {', '.join(map(repr, missing))}; columns: {_columns(joints)}")


def _columns(joints: Sequence[str]) -> str:
    return COLUMNS_HELP.replace("the robot's joints by their names", ", ".join(joints))


def _row(
    path: Path, line: int, header: Sequence[str], cells: Sequence[str], joints: Sequence[str], left: list[RejectedPose]
) -> _Row | None:
    if len(cells) != len(header):
        raise PosesError(f"{path}: line {line} has {len(cells)} columns, the header {len(header)}")
    values: dict[str, float] = {}
    for name, cell in zip(header, cells, strict=True):
        value = cell_number(cell)
        if value is None:
            raise PosesError(f"{path}: line {line}: {name} is {cell!r}, not a number")
        values[name] = value
    if wrong := [name for name, value in values.items() if not math.isfinite(value)]:
        left.append(RejectedPose(line, f"{', '.join(wrong)}: no finite number"))
        return None

    def of(names: Sequence[str]) -> Array:
        return np.array([values.get(name, 0.0) for name in names])

    time, trajectory = values.get(TIME_COLUMN, 0.0), values.get(TRAJECTORY_COLUMN, 0.0)
    return _Row(line, time, trajectory, of(joints), of(TIP_COLUMNS), of(FORCE_COLUMNS))


def _check_units(path: Path, robot: RobotFile, rows: Sequence[_Row]) -> None:
    """Refuse degrees and millimetres: many joints beyond their travel, or tips further apart than the robot is long."""
    joints = np.array([row.joints for row in rows])
    for column, limit in zip(joints.T, robot.limits().joints, strict=True):
        beyond = (column < limit.lower) | (column > limit.upper)
        if beyond.mean() > WRONG_UNIT_SHARE:
            farthest = float(column[beyond][np.argmax(np.abs(column[beyond]))])
            unit, other = ("radians", "degrees") if limit.unit == "rad" else ("metres", "millimetres")
            example = f"{limit.name}={limit.name}[{'deg' if limit.unit == 'rad' else 'mm'}]"
            if limit.unit == "m" and (column > 0.0).mean() > WRONG_UNIT_SHARE:
                other += " or positive insertions"
                example += f" or {limit.name}=-{limit.name}"
            raise PosesError(
                f"{path}: {limit.name} is {farthest:g} {limit.unit}, outside {limit.lower:.4g} ... {limit.upper:.4g}"
                f" {limit.unit} (its travel), and so are {int(beyond.sum())} of {len(column)} rows: are these {other}?"
                f" State it by --columns, for example {example}, with all other"
                f" columns; if they are {unit}, widen lower and upper in the robot's file"
            )
    tips = np.array([row.tip for row in rows])
    length = max(tube.length for tube in robot.robot().tubes)
    apart = float(np.linalg.norm(np.ptp(tips, axis=0)))
    if apart > 4.0 * length:
        raise PosesError(
            f"{path}: the tips are {apart:.4g} m apart, and '{robot.name}' is {length:.4g} m long: are these"
            " millimetres? State it by --columns, for example tip_x=tip_x[mm], with all other columns"
        )


def _is_feasible(row: _Row, limits: Sequence[JointLimit], left: list[RejectedPose]) -> bool:
    for limit, value in zip(limits, row.joints.tolist(), strict=True):
        if not limit.lower <= value <= limit.upper:
            left.append(
                RejectedPose(
                    row.line,
                    f"{limit.name} {value:.4g} {limit.unit} is outside {limit.lower:.4g} ... {limit.upper:.4g}"
                    f" {limit.unit} (its travel)",
                )
            )
            return False
    return True


def _flush(row: _Row, robot: Robot) -> _Row:
    """Return the row with translations shifted so that tubes within `FLUSH_TOLERANCE_M` end flush."""
    joints = row.joints.copy()
    sliding = {joint.tube: k for k, joint in enumerate(robot.joints) if joint.motion == "translation"}
    for i in range(len(robot.tubes) - 2, -1, -1):
        _, beta = robot.tube_poses(joints)
        behind = beta[i + 1] + robot.tubes[i + 1].length - beta[i] - robot.tubes[i].length
        if 0.0 < behind <= FLUSH_TOLERANCE_M:
            if i in sliding:
                joints[sliding[i]] += behind
            elif i + 1 in sliding:
                joints[sliding[i + 1]] -= behind
    return row._replace(joints=joints)


def _has_shape(row: _Row, model: Statics, left: list[RejectedPose]) -> bool:
    try:
        model.solve(row.joints, pure_force(row.force))
    except CtrError as error:
        left.append(RejectedPose(row.line, str(error)))
        return False
    return True


def _first(left: Sequence[RejectedPose]) -> str:
    """Return line and reason of the first rejected pose in brackets; empty if none was rejected."""
    return f" (line {left[0].line}: {left[0].reason})" if left else ""


def recorded(poses: Poses, errors: Array, joints: Sequence[str]) -> Iterator[list[object]]:
    """Return the rows of a table of measurements and errors (m, 3) [m]; the first row names the columns."""
    yield ["line", *joints, *TIP_COLUMNS, *FORCE_COLUMNS, "error_x", "error_y", "error_z", "error"]
    for line, measurement, force, error in zip(poses.lines, poses.measurements, poses.forces, errors, strict=True):
        values = (*measurement.joints, *measurement.coil, *force, *error, np.linalg.norm(error))
        yield [line, *(f"{value:.9g}" for value in values)]
