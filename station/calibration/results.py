"""Stored calibrations of a folder, with instructions for using each of them."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from pydantic import BaseModel, ConfigDict

from core.errors import CtrError
from station.calibration.catalogue import PROCEDURES
from station.calibration.files import REPORT_FILE, REPORT_NUMBERS_FILE, VISITS_FILE
from station.config.robots import RobotFile
from station.config.strict import Strict, text_of
from station.control.calibrated_robot import LATENCY_FILE, REGISTRATION_FILE, RESIDUAL_FILE, ROBOT_FILE, SENSORS_FILE
from station.regular_file import is_hidden, is_regular, read_in


class CalibrationNumbers(BaseModel):
    """Numbers of a calibration; fields with defaults exist for some procedures only."""

    model_config = ConfigDict(strict=True, extra="ignore", allow_inf_nan=False)

    procedure: str
    made: str
    lab: str
    simulated: bool
    findings: list[str]
    found: list[dict[str, str]]
    visits: int
    robot_s: float
    signs: dict[str, float] = {}


class NoResultError(CtrError):
    """Error: the requested calibration, or the requested file of a calibration, does not exist."""


class CalibrationUse(Strict):
    """Instructions for using the result of a calibration."""

    text: str
    line: str = ""
    """line for the top of the station file; empty if none is needed"""


class StoredCalibration(NamedTuple):
    """One stored calibration."""

    name: str  #: name of the calibration's folder
    numbers: CalibrationNumbers  #: numbers of the calibration, which the module `outcome` has written
    files: tuple[str, ...]  #: names of the files in the folder
    use: CalibrationUse


class Results:
    """Calibrations in one folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def all(self) -> list[StoredCalibration]:
        """Return all calibrations, the newest first; damaged and incomplete ones are left out."""
        found = [kept for path in self._folders() if (kept := _read(path)) is not None]
        return sorted(found, key=lambda kept: (kept.numbers.made, kept.name), reverse=True)

    def one(self, name: str) -> StoredCalibration:
        """Return the calibration with a name.

        Raises:
            NoResultError: there is no calibration with this name.
        """
        kept = _read(self._find(name))
        if kept is None:
            raise NoResultError(f"calibration '{name}' is damaged: no numbers in {REPORT_NUMBERS_FILE}")
        return kept

    def file(self, name: str, file: str) -> Path:
        """Return the path of a file of a calibration.

        Raises:
            NoResultError: there is no such calibration, or no such file in it.
        """
        folder = self._find(name)
        if file not in _files(folder):
            raise NoResultError(f"calibration '{name}' has no file '{file}', but {', '.join(_files(folder))}")
        return folder / file

    def _find(self, name: str) -> Path:
        # The name is compared with existing folders and never becomes a path, so it cannot select another folder.
        for path in self._folders():
            if path.name == name:
                return path
        raise NoResultError(f"'{name}' is not one of the calibrations in {self._folder}")

    def _folders(self) -> Iterator[Path]:
        if not self._folder.is_dir():
            return
        for path in self._folder.iterdir():
            if not path.is_symlink() and not is_hidden(path) and is_regular(path / REPORT_NUMBERS_FILE):
                yield path


def _files(folder: Path) -> tuple[str, ...]:
    return tuple(
        name
        for name in (
            REGISTRATION_FILE,
            SENSORS_FILE,
            ROBOT_FILE,
            RESIDUAL_FILE,
            LATENCY_FILE,
            REPORT_FILE,
            REPORT_NUMBERS_FILE,
            VISITS_FILE,
        )
        if is_regular(folder / name)
    )


def _read(folder: Path) -> StoredCalibration | None:
    try:
        folder.name.encode()  # a name that is not UTF-8 cannot be requested
        # pydantic's JSON parser raises ValueError for half a surrogate pair and for very deeply nested brackets.
        numbers = CalibrationNumbers.model_validate_json(text_of(read_in(folder, REPORT_NUMBERS_FILE)))
    except (OSError, ValueError):
        return None
    if numbers.procedure not in PROCEDURES:
        return None
    return StoredCalibration(folder.name, numbers, _files(folder), _use(folder.absolute(), numbers))


def _use(folder: Path, numbers: CalibrationNumbers) -> CalibrationUse:
    if any(is_regular(folder / name) for name in (REGISTRATION_FILE, SENSORS_FILE, ROBOT_FILE, LATENCY_FILE)):
        text = "To use this calibration elsewhere, put this line at the top of the station's file."
        return CalibrationUse(text=text, line=f"calibration = {json.dumps(str(folder))}")
    wrong = [name for name, sign in numbers.signs.items() if sign < 0.0]
    if wrong:
        turned = ", ".join(f"joints.{name}.backwards" for name in wrong)
        return CalibrationUse(
            text=f"Invert {turned} under [devices.stages] of the station's file, then repeat this procedure."
        )
    if unseen := [name for name, sign in numbers.signs.items() if sign == 0.0]:
        return CalibrationUse(
            text=f"The tip does not show the direction of {', '.join(unseen)}: check it by eye. The other axes move in"
            " the described directions."
        )
    return CalibrationUse(
        text="Nothing has to be changed: the axes move as described. 'tubes' finds the zero angles more accurately."
    )


class CheckItem(Strict):
    """One task of the checklist for a bench whose tubes or stages have changed."""

    procedure: str
    """name of the procedure to run; empty: a task for the operator"""
    text: str


def connection_checklist(before: RobotFile, now: RobotFile) -> list[CheckItem]:
    """Return the tasks before the first run with `now` on a bench that was calibrated with `before`."""
    todo = [
        ("", "Switch the stages' power off before you reach in; fit the new tubes, innermost first."),
        ("", "Check that each tube turns and slides freely in the next, and that its zero mark points along +x."),
        ("", "Home the stages with nothing near the tubes."),
    ]
    stages = [(joint.name, joint.motion, joint.microstep) for joint in before.joints]
    if stages != [(joint.name, joint.motion, joint.microstep) for joint in now.joints]:
        todo.append(("axes", "The stages have changed: find the direction of each axis."))
        todo.append(("latency", "The stages have changed: measure the latency again."))
    elif [tube.name for tube in before.tubes] != [tube.name for tube in now.tubes]:
        todo.append(("axes", "The tubes have changed: check that each stage moves the correct tube."))
    if len(before.tubes) != len(now.tubes):
        todo.append(("force", "The number of sensors has changed: calibrate all of them."))
    if before.tubes != now.tubes:
        todo.append(("tubes", "EI, curvature, nu, lengths, zeros, coil and frames belong to the old tubes."))
    else:
        todo.append(("tracker", "The coil was removed and mounted again: find its position."))
    return [CheckItem(procedure=procedure, text=text) for procedure, text in todo]
