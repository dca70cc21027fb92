"""Writes the result files of a comparison between model and measured poses, and its text for the terminal.

report.json has the numbers for scripts: errors in mm, all others in SI units.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from core.calibration.external_poses import ErrorStatistics, PoseFit
from core.calibration.rigid_transform import vector_from_rotation
from station.calibration import files
from station.calibration.files import REPORT_NUMBERS_FILE
from station.calibration.findings import findings, undetermined_parameters
from station.calibration.poses import Poses, recorded
from station.calibration.summary import FOUND_HEAD
from station.calibration.validation import ErrorBin, Validation, by_direction, by_joint, calibration, found_rows
from station.calibration.validation_report import ERROR_HEAD, error_rows, page_parts
from station.control.calibrated_robot import RESIDUAL_FILE
from station.control.residual_file import write_residual
from station.devices.aurora.tracker import TrackerMounting
from station.report import document

ERRORS_FILE = "errors.csv"
#: Largest number of left-out rows of a poses file that the terminal lists; the report lists more.
MAX_PRINTED_ROWS = 10
#: Assumed mounting of the tracker for the registration file: the identity, because measured points from a file are in
#: the tracker's own frame.
IDENTITY_REGISTRATION = TrackerMounting(np.eye(3), np.zeros(3))


def write_validation(folder: Path, validation: Validation, when: str) -> dict[str, Any]:
    """Write report.html, report.json and errors.csv to `folder`; return the numbers of report.json.

    Raises:
        ConfigError: the folder cannot be written to.
    """
    return _written(folder, f"Model of '{validation.robot.name}' and measured poses", validation, when, {}, ())


def write_calibration(folder: Path, validation: Validation, when: str) -> dict[str, Any]:
    """Write the files of `write_validation`, robot.toml (fitted tubes) and registration.toml (fitted frames).

    Other commands read robot.toml and registration.toml with the option `--calibration`.

    Raises:
        UnobservableCombination: the tubes could not be fitted.
        ConfigError: the folder cannot be written to.
    """
    found, learned = calibration(validation), validation.best.learned
    what = "tubes" if learned is None else "residual"
    made = f"'calibrate {what} --from {validation.poses.path.name}' of {when}; errors in {ERRORS_FILE}"
    written = [
        files.write_registration(
            folder, validation.robot, found.frames, found.fit, found.errors, IDENTITY_REGISTRATION, made
        ),
        files.write_robot(folder, validation.file, found, made),
        files.write_described(folder, validation.file),
    ]  # fmt: skip
    if learned is not None:
        count = len(validation.poses.measurements)
        written.append(write_residual(folder / RESIDUAL_FILE, validation.robot, learned, count, made))
    kept = {
        "procedure": what, "made": when, "lab": f"poses of {validation.poses.path.name}", "simulated": False,
        "visits": len(validation.poses.measurements), "robot_s": 0.0,
        "found": [r._asdict() for r in found_rows(validation)],
    }  # fmt: skip
    title = f"Tubes of '{validation.robot.name}' from measured poses"
    return _written(folder, title, validation, when, kept, [path.name for path in written])


def _written(
    folder: Path, title: str, validation: Validation, when: str, more: dict[str, Any], names: Sequence[str]
) -> dict[str, Any]:
    values = {**_numbers(validation), **more, "folder": str(folder), "files": [*names, ERRORS_FILE]}
    facts = [
        ("made", when),
        ("robot", validation.robot.name),
        ("poses", _location(validation.poses)),
        *([] if validation.test is None else [("tested with", _location(validation.test))]),
        ("source of the description", validation.file.source or "not stated"),
    ]
    errors = recorded(validation.poses, validation.errors[-1], validation.robot.joint_names)
    parts = page_parts(title, validation, facts)
    document.write_results(folder, title, parts, {REPORT_NUMBERS_FILE: values}, {ERRORS_FILE: errors})
    return values


def _location(poses: Poses) -> str:
    return f"{poses.path}: {len(poses.measurements)} poses" + (
        f", {len(poses.left_out)} left out" if poses.left_out else ""
    )


def tables(validation: Validation) -> list[Table]:
    """Return the tables for the terminal: errors of each fit, and fitted parameters if there are any."""
    title = Text(f"{validation.robot.name}: {_location(validation.poses)}", justify="left")
    errors = document.terminal_table(("distance [mm]", *ERROR_HEAD), error_rows(validation), 2, title)
    rows = found_rows(validation)
    return [errors, document.terminal_table(FOUND_HEAD, rows)] if rows else [errors]


def sentences(validation: Validation) -> list[str]:
    """Return the lines for the terminal: findings, and the first left-out rows of both poses files with the reasons."""
    lines = findings(validation)
    for poses in (validation.poses, validation.test):
        left = () if poses is None else poses.left_out
        lines += [f"line {each.line} left out: {each.reason}" for each in left[:MAX_PRINTED_ROWS]]
        if len(left) > MAX_PRINTED_ROWS:
            lines.append(f"and {len(left) - MAX_PRINTED_ROWS} more, in the report")
    return lines


def _numbers(validation: Validation) -> dict[str, Any]:
    """Return the numbers of a validation: errors in mm, all others in SI units."""
    best = validation.best
    return {
        "robot": validation.robot.name,
        "poses": str(validation.poses.path),
        "test": None if validation.test is None else str(validation.test.path),
        "used": len(validation.poses.measurements),
        "left_out": [each._asdict() for each in validation.poses.left_out],
        "test_left_out": [] if validation.test is None else [each._asdict() for each in validation.test.left_out],
        "fit": best.extent,
        "failed": validation.failed or None,
        "errors_mm": {
            found.extent: _mm(ErrorStatistics.of(errors))
            for found, errors in zip(validation.matches, validation.errors, strict=True)
        },
        "unseen_mm": {
            held_out.extent: {
                "how": "; ".join(validation.parts) if validation.test is None else "the other file",
                "fitted": _mm(held_out.fitted),
                "tested": _mm(held_out.tested),
            }
            for held_out in validation.held_out
        },
        "noise_mm": 1e3 * best.noise,
        "neighbours_alike": best.neighbour_correlation,
        "frames": {
            "rotation_vector": vector_from_rotation(best.frames.registration.rotation).tolist(),
            "position": best.frames.registration.position.tolist(),
            "offset": best.frames.coil.tolist(),
            "position_standard_deviation": best.position_errors.tolist(),
        },
        "residual": _residual(validation),
        "learned": _learned(validation),
        "parameters": _parameters(best),
        "cannot_tell": undetermined_parameters(best),
        "not_asked_for": list(best.requested.omitted),
        "by_joint": [_bin_numbers(each) for each in by_joint(validation)],
        "by_direction": [_bin_numbers(each) for each in by_direction(validation)],
        "findings": findings(validation),
    }


def _parameters(best: PoseFit) -> dict[str, dict[str, Any]]:
    if best.fit is None:
        return {}
    values, errors = best.fit.values.tolist(), best.fit.errors.tolist()
    return {
        p.name: {
            "value": value,
            "standard_deviation": None if p.name in best.undetermined else error,
            "unit": p.unit,
            "known_beforehand": p.prior if math.isfinite(p.prior) else None,
            "identified": p.name not in best.fixed_by_prior and p.name not in best.undetermined,
        }
        for p, value, error in zip(best.fit.parameters, values, errors, strict=True)
    }


def _residual(validation: Validation) -> dict[str, Any]:
    """Return cross-validated shares of the squared error; null where they do not exist."""
    left = validation.residual
    parts = {"last_pose_correlation": left.last_pose, "joints_predict": left.smooth, "joints_and_motion": left.motion}
    lengths = {"mean_mm": 1e3 * left.mean, "learned_mean_mm": 1e3 * left.learned}
    return {"kind": left.kind} | {
        key: value if math.isfinite(value) else None for key, value in (parts | lengths).items()
    }


def _learned(validation: Validation) -> dict[str, Any] | None:
    """Return size and strength of the learned residual, and its errors outside its data; None without a residual."""
    learned, outside = validation.best.learned, validation.extrapolation
    if learned is None:
        return None
    return {"support_points": len(learned.support), "strength": learned.strength} | (
        {} if outside is None else {
            "left_out": outside.where, "model_mm": 1e3 * outside.model, "corrected_mm": 1e3 * outside.corrected,
        }
    )  # fmt: skip


def _mm(spread: ErrorStatistics) -> dict[str, float | int | None]:
    """Return lengths [mm]; null for NaN, which JSON does not have."""
    lengths = {key: 1e3 * value for key, value in spread._asdict().items() if key != "poses"}
    return {"poses": spread.poses, **{key: value if math.isfinite(value) else None for key, value in lengths.items()}}


def _bin_numbers(each: ErrorBin) -> dict[str, Any]:
    return {
        "joint": each.joint,
        "where": each.where,
        **_mm(each.spread),
        "along_mm": [1e3 * a if math.isfinite(a) else None for a in each.along],
    }
