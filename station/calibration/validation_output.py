"""Writes the result files of a comparison between model and measured poses, and its text for the terminal."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from station.calibration import files
from station.calibration.findings import findings
from station.calibration.folder import REPORT_NUMBERS_FILE
from station.calibration.poses import Poses, recorded
from station.calibration.validation import Validation, calibration, found_rows
from station.calibration.validation_numbers import numbers
from station.config.strict import ConfigError
from station.devices.aurora.tracker import TrackerMounting

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
    found = calibration(validation)
    made = f"'calibrate tubes --from {validation.poses.path.name}' of {when}; errors in {ERRORS_FILE}"
    written = [
        files.write_registration(
            folder, validation.robot, found.frames, found.fit, found.errors, IDENTITY_REGISTRATION, made
        ),
        files.write_robot(folder, validation.file, found, made),
    ]  # fmt: skip
    kept = {
        "procedure": "tubes", "made": when, "lab": f"poses of {validation.poses.path.name}", "simulated": False,
        "visits": len(validation.poses.measurements), "robot_s": 0.0,
        "found": [r._asdict() for r in found_rows(validation)],
    }  # fmt: skip
    title = f"Tubes of '{validation.robot.name}' from measured poses"
    return _written(folder, title, validation, when, kept, [path.name for path in written])


def _written(
    folder: Path, title: str, validation: Validation, when: str, more: dict[str, Any], names: Sequence[str]
) -> dict[str, Any]:
    # This import loads the library for figures, which takes a second.
    from station.calibration.validation_report import write_report

    values = {**numbers(validation), **more, "folder": str(folder), "files": [*names, ERRORS_FILE]}
    facts = [
        ("made", when),
        ("robot", validation.robot.name),
        ("poses", _location(validation.poses)),
        *([] if validation.test is None else [("tested with", _location(validation.test))]),
        ("source of the description", validation.file.source or "not stated"),
    ]
    joints = validation.robot.joint_names
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / ERRORS_FILE).open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows(recorded(validation.poses, validation.errors[-1], joints))
        (folder / REPORT_NUMBERS_FILE).write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
        write_report(folder, title, validation, facts)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write results there: {error.strerror}") from None
    return values


def _location(poses: Poses) -> str:
    return f"{poses.path}: {len(poses.measurements)} poses" + (
        f", {len(poses.left_out)} left out" if poses.left_out else ""
    )


def tables(validation: Validation) -> list[Table]:
    """Return the tables for the terminal: errors of each fit, and fitted parameters if there are any."""
    from station.calibration.validation_report import error_rows

    title = f"{validation.robot.name}: {_location(validation.poses)}"
    errors = Table(title=Text(title), title_style="", title_justify="left")
    for column in ("distance [mm]", "at"):
        errors.add_column(column)
    for column in ("poses", "mean", "median", "95 %", "largest"):
        errors.add_column(column, justify="right")
    for row in error_rows(validation):
        errors.add_row(*row)
    found = Table()
    found.add_column("")
    for column in ("before", "found", "+- (95 %)"):
        found.add_column(column, justify="right")
    rows = found_rows(validation)
    for row in rows:
        found.add_row(*row)
    return [errors, found] if rows else [errors]


def sentences(validation: Validation) -> list[str]:
    """Return the lines for the terminal: findings, and the first left-out rows of both poses files with the reasons."""
    lines = findings(validation)
    for poses in (validation.poses, validation.test):
        left = () if poses is None else poses.left_out
        lines += [f"line {each.line} left out: {each.reason}" for each in left[:MAX_PRINTED_ROWS]]
        if len(left) > MAX_PRINTED_ROWS:
            lines.append(f"and {len(left) - MAX_PRINTED_ROWS} more, in the report")
    return lines
