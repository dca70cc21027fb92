"""Calibration of ATI force sensors on an analog card: the .cal file and the conversion to wrenches.

A 6x6 matrix converts six gauge voltages into a wrench. The file has one row of the matrix per axis, about the
transducer's origin, and a scale by which the row must be divided. It also has a translation to the tool's origin.
Newer files (version 1.1) also contain the resulting rows about the tool's origin.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

import numpy as np

from core.errors import CtrError
from core.robot.robot import Array
from station.devices.netft.page import FORCE_UNITS, TORQUE_UNITS

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
#: Length units of a file [m].
LENGTH_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "ft": 0.3048}
#: Largest relative difference between the resulting rows in the file, which have five decimals, and the computed rows.
ROW_TOLERANCE = 1e-3
MAX_FILE_BYTES = 1 << 20  #: largest file that is read [bytes]
_NUMBER = re.compile(r"[+-]?(\d{1,30}(\.\d{0,30})?|\.\d{1,30})([eE][+-]?\d{1,3})?", re.ASCII)


class CalibrationError(CtrError):
    """An invalid calibration file; the text names the file, the part of it and what was expected."""


@dataclass(frozen=True)
class GaugeCalibration:
    """Conversion of gauge voltages into a wrench."""

    serial: str
    part: str  #: part number of the calibration, such as SI-18-0.25
    matrix: Array  #: (6, 6) conversion of voltages into a wrench [N/V, N m/V]
    ranges: Array  #: (6,) calibrated range of each axis [N, N m]
    volts: float  #: voltage, of either sign, at which the converter saturates [V]

    def wrench(self, voltages: Array, bias: Array) -> Array:
        """Return the wrench (6,) [N, N m] of `voltages` (6,), with the voltages `bias` (6,) without load [V]."""
        return self.matrix @ (voltages - bias)

    def is_saturated(self, voltages: Array) -> bool:
        """Return whether a voltage is saturated or not a number, which makes the wrench invalid."""
        return not bool((np.abs(voltages) < self.volts).all())


def read_calibration(path: Path) -> GaugeCalibration:
    """Read a .cal file.

    Raises:
        CalibrationError: the file is invalid; the message names the file, the part of it and what was expected.
    """
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise CalibrationError(f"{path} has {path.stat().st_size} bytes; at most {MAX_FILE_BYTES} are read")
        text = path.read_bytes()
    except OSError as error:
        raise CalibrationError(f"{path} cannot be read: {error.strerror}") from None
    try:
        return parse_calibration(text)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None


def parse_calibration(text: bytes) -> GaugeCalibration:
    """Parse a .cal file's content; raises CalibrationError."""
    elements = _elements(text)
    head = elements["Calibration"][0]
    force = _unit(head, "ForceUnits", FORCE_UNITS)
    torque = _unit(head, "TorqueUnits", TORQUE_UNITS)
    to_si = np.array([force] * 3 + [torque] * 3)
    axes, ready = _rows(elements["Axis"], "Axis"), _rows(elements["UserAxis"], "UserAxis")
    if not axes and not ready:
        raise CalibrationError("there is neither an Axis nor a UserAxis row")
    matrix = np.zeros((6, 6))
    if axes:
        scale = np.array([_number(axes[name], "scale") for name in AXES])
        matrix = _values(axes) / scale[:, None] * to_si[:, None]
        matrix = _shift(elements["BasicTransform"], head) @ matrix
    if ready:
        given = _values(ready) * to_si[:, None]
        if axes:
            _compare(matrix, given)
        else:
            matrix = given
    if not np.isfinite(matrix).all() or np.linalg.matrix_rank(matrix) < 6:
        raise CalibrationError("the matrix is singular; are two rows the same?")
    ranges = np.array([_number((ready or axes)[name], "max") for name in AXES]) * to_si
    bipolar = head.get("OutputBipolar", "True") == "True"
    volts = _number(head, "OutputRange") / (2.0 if bipolar else 1.0)
    serial = elements["FTSensor"][0].get("Serial", "")
    return GaugeCalibration(serial, head.get("PartNumber", ""), matrix, ranges, volts)


def _elements(text: bytes) -> dict[str, list[dict[str, str]]]:
    """Return the attributes of the elements that describe the calibration, in the order of the file."""
    found: dict[str, list[dict[str, str]]] = {
        name: [] for name in ("FTSensor", "Calibration", "Axis", "BasicTransform", "UserAxis")
    }

    def start(name: str, attributes: dict[str, str]) -> None:
        if name in found:
            found[name].append(attributes)

    def doctype(*_: object) -> None:
        raise CalibrationError("there is a DOCTYPE; a calibration file has none")

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(text, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise CalibrationError(f"not well-formed XML: {error}") from None
    for name, upper in (("FTSensor", 1), ("Calibration", 1), ("BasicTransform", 1)):
        lower = 0 if name == "BasicTransform" else 1
        if not lower <= len(found[name]) <= upper:
            raise CalibrationError(f"{len(found[name])} elements <{name}>; expected one")
    return found


def _rows(rows: list[dict[str, str]], kind: str) -> dict[str, dict[str, str]]:
    """Return the rows by axis: six rows, or none if the file has no rows of this kind."""
    names = [row.get("Name", "") for row in rows]
    if rows and sorted(names) != sorted(AXES):
        raise CalibrationError(f"{kind} rows are {', '.join(names)}; expected {', '.join(AXES)}, each once")
    return dict(zip(names, rows, strict=True))


def _values(rows: dict[str, dict[str, str]]) -> Array:
    """Return the six coefficients of each axis (6, 6)."""
    matrix = np.zeros((6, 6))
    for index, name in enumerate(AXES):
        parts = rows[name].get("values", "").split()
        if len(parts) != 6 or not all(_NUMBER.fullmatch(part) for part in parts):
            raise CalibrationError(f"{name}: values are '{' '.join(parts)[:60]}'; expected six numbers")
        matrix[index] = [float(part) for part in parts]
    return matrix


def _number(attributes: dict[str, str], name: str) -> float:
    """Return the attribute `name` as a number, which must be positive and finite."""
    text = attributes.get(name, "")
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not 0.0 < value < math.inf:
        raise CalibrationError(
            f"{attributes.get('Name', 'Calibration')}: {name} is '{text}'; expected a positive number"
        )
    return value


def _unit(attributes: dict[str, str], name: str, units: dict[str, float]) -> float:
    text = attributes.get(name, "")
    if text not in units:
        raise CalibrationError(f"{name} is '{text}'; expected one of {', '.join(units)}")
    return units[text]


def _shift(transforms: list[dict[str, str]], head: dict[str, str]) -> Array:
    """Return the matrix [[I, 0], [-[p]x, I]] (6, 6) that moves a wrench's reference point from the origin to p."""
    shift = np.eye(6)
    if not transforms:
        return shift
    numbers: dict[str, float] = {}
    for name in ("Dx", "Dy", "Dz", "Rx", "Ry", "Rz"):
        text = transforms[0].get(name, "0")
        numbers[name] = float(text) if _NUMBER.fullmatch(text) else math.nan
        if not math.isfinite(numbers[name]):
            raise CalibrationError(f"BasicTransform: {name} is '{text}'; expected a number")
        if name.startswith("R") and numbers[name]:
            raise CalibrationError(f"BasicTransform: {name} is {text}; only translations are supported, expected 0")
    unit = _unit(head, "DistUnits", LENGTH_UNITS)
    x, y, z = (numbers[name] * unit for name in ("Dx", "Dy", "Dz"))
    shift[3:, :3] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return shift


def _compare(computed: Array, given: Array) -> None:
    """Raise if the resulting rows in a file differ from the rows computed from the file's other numbers."""
    off = np.abs(given - computed).max(axis=1) / np.abs(computed).max(axis=1)
    worst = int(np.argmax(off))
    if not off[worst] <= ROW_TOLERANCE:
        raise CalibrationError(
            f"UserAxis {AXES[worst]} differs from Axis and BasicTransform by {off[worst]:.2g} of the row; "
            f"expected at most {ROW_TOLERANCE:g}"
        )
