"""ATI's calibrations: the page `netftapi2.xml` of a Net F/T box, and the .cal file of a sensor on an analog card.

The parsers are strict, because a wrong scale gives a wrong force. The page must be well-formed XML without a DOCTYPE.
Each of its five required elements must occur once and contain only text: positive finite numbers and known unit names.
The calibration's serial number and ranges are optional. The parser ignores all other elements.

A .cal file has a 6x6 matrix that converts six gauge voltages into a wrench: one row per axis about the transducer's
origin, a scale by which the row must be divided, and a transform to the tool's frame. Newer files (version 1.1) also
contain the resulting rows in the tool's frame.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

import numpy as np

from core.calibration.rigid_transform import cross_matrix, rotation_from_vector
from core.errors import CtrError
from core.robot.robot import Array

# Names and factors of ATI's C library for .cal files (`ForceConv`, `TorqueConv`, `DistConv` and `AngleConv` in ATIDAQ's
# ftconfig.c, which compares names with their case). The spellings gf, kgf and kgf-cm are not in the library.
_LBF, _KGF = 4.4482216152605, 9.80665
#: Force units of a page and of a file [N].
FORCE_UNITS = {
    "N": 1.0, "kN": 1e3, "lb": _LBF, "lbf": _LBF, "klb": 1e3 * _LBF, "klbf": 1e3 * _LBF,
    "g": 1e-3 * _KGF, "gf": 1e-3 * _KGF, "kg": _KGF, "kgf": _KGF,
}  # fmt: skip
#: Torque units of a page and of a file [N m].
TORQUE_UNITS = {
    "N-m": 1.0, "Nm": 1.0, "N-mm": 1e-3, "Nmm": 1e-3, "kN-m": 1e3, "kNm": 1e3,
    **dict.fromkeys(("in-lb", "in-lbf", "lb-in", "lbf-in"), 0.0254 * _LBF),
    **dict.fromkeys(("ft-lb", "ft-lbf", "lb-ft", "lbf-ft"), 0.3048 * _LBF),
    **dict.fromkeys(("kg-cm", "kgcm", "kgf-cm"), 0.01 * _KGF),
}  # fmt: skip
#: Length units of a file [m], and angle units [rad].
LENGTH_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "ft": 0.3048}
ANGLE_UNITS = {
    **dict.fromkeys(("deg", "degree", "degrees"), math.pi / 180.0),
    **dict.fromkeys(("rad", "radian", "radians"), 1.0),
}
REQUIRED_FIELDS = ("prodname", "cfgcpf", "cfgcpt", "scfgfu", "scfgtu")
OPTIONAL_FIELDS = ("cfgcalsn", "cfgmr")
MAX_PAGE_BYTES = 1 << 18  #: largest page that is read [bytes]; a real page has a few thousand bytes
#: Bounds of the counts per unit of force or torque; values outside are an error and could make a force infinite.
MIN_COUNTS, MAX_COUNTS = 1e-6, 1e15
_PAGE_NUMBER = re.compile(r"\d{1,20}(\.\d{0,20})?([eE][+-]?\d{1,3})?", re.ASCII)


class PageError(CtrError):
    """An invalid configuration page; the message names the element, its text and what was expected."""


@dataclass(frozen=True)
class NetftPage:
    """Content of a box's configuration page."""

    product: str
    serial: str  #: serial number of the calibration, which identifies a sensor; "" if the page has none
    force_count: float  #: force per count [N]
    torque_count: float  #: torque per count [N m]
    ranges: tuple[float, ...] | None  #: the calibration's six ranges [N, N m]; None if the page has none


def read_page(page: bytes) -> NetftPage:
    """Return the content of the page `netftapi2.xml`.

    Raises:
        PageError: the page is invalid; the message names the element, its text and what was expected.
    """
    texts = _texts(page)
    for name in REQUIRED_FIELDS:
        if name not in texts:
            raise PageError(f"netftapi2.xml has no <{name}>; is this an ATI Net F/T?")
    force = _page_unit(texts["scfgfu"], "scfgfu", FORCE_UNITS)
    torque = _page_unit(texts["scfgtu"], "scfgtu", TORQUE_UNITS)
    if not texts["prodname"]:
        raise PageError("netftapi2.xml: <prodname> is empty; expected the name of the product")
    return NetftPage(
        product=texts["prodname"],
        serial=texts.get("cfgcalsn", ""),
        force_count=force / _counts(texts["cfgcpf"], "cfgcpf"),
        torque_count=torque / _counts(texts["cfgcpt"], "cfgcpt"),
        ranges=_ranges(texts.get("cfgmr"), force, torque),
    )


def _texts(page: bytes) -> dict[str, str]:
    """Return the text of each required or optional element."""
    if len(page) > MAX_PAGE_BYTES:
        raise PageError(f"netftapi2.xml has {len(page)} bytes; at most {MAX_PAGE_BYTES} are read")
    found: dict[str, str] = {}
    known_fields = {*REQUIRED_FIELDS, *OPTIONAL_FIELDS}
    inside: list[str] = []  # name of the required or optional element that the parser is inside of

    def start(name: str, _: dict[str, str]) -> None:
        if inside:
            raise PageError(f"netftapi2.xml: <{inside[0]}> contains <{name}>; expected text only")
        if name in known_fields:
            if name in found:
                raise PageError(f"netftapi2.xml has <{name}> twice; expected it once")
            found[name] = ""
            inside.append(name)

    def end(_: str) -> None:
        inside.clear()

    def text(data: str) -> None:
        if inside:
            found[inside[0]] += data

    def doctype(*_: object) -> None:
        raise PageError("netftapi2.xml has a DOCTYPE; a Net F/T sends none")

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(page, True)
    except (expat.ExpatError, ValueError, LookupError) as error:  # ValueError, LookupError: an unknown encoding
        raise PageError(f"netftapi2.xml is not well-formed: {error}") from None
    return {name: value.strip() for name, value in found.items()}


def _page_unit(name: str, element: str, units: dict[str, float]) -> float:
    if name not in units:
        raise PageError(f"netftapi2.xml: <{element}> is '{name[:40]}'; expected one of {', '.join(units)}")
    return units[name]


def _counts(text: str, element: str) -> float:
    counts = float(text) if _PAGE_NUMBER.fullmatch(text) else math.nan
    if not MIN_COUNTS <= counts <= MAX_COUNTS:
        raise PageError(
            f"netftapi2.xml: <{element}> is '{text[:40]}' counts per unit; "
            f"expected a number in {MIN_COUNTS:g} ... {MAX_COUNTS:g}"
        )
    return counts


def _ranges(text: str | None, force: float, torque: float) -> tuple[float, ...] | None:
    """Return the six ranges, separated by `;`, `,` or blanks; None if they are not six positive numbers."""
    parts = re.split(r"[;,\s]+", text) if text else []
    if len(parts) != 6 or not all(_PAGE_NUMBER.fullmatch(part) for part in parts):
        return None
    values = [float(part) * unit for part, unit in zip(parts, [force] * 3 + [torque] * 3, strict=True)]
    return tuple(values) if all(0.0 < value < math.inf for value in values) else None


AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
#: Largest relative difference between a file's UserAxis rows, which have five decimals, and its converted Axis rows.
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

    def mean_wrench(self, voltages: Array) -> Array | None:
        """Return the untared wrench (6,) [N, N m] for the mean of k samples of the six gauge voltages (6, k) [V].

        The result is None if any sample is saturated or not a number, because the mean would hide the saturation.
        """
        return self.matrix @ voltages.mean(axis=1) if (np.abs(voltages) < self.volts).all() else None


def read_calibration(path: Path) -> GaugeCalibration:
    """Return the calibration in a .cal file.

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
    """Return the calibration in the content of a .cal file; raises CalibrationError."""
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
        matrix = _tool_transform(elements["BasicTransform"], head) @ matrix
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


def _unit(attributes: dict[str, str], name: str, units: dict[str, float], default: str = "") -> float:
    text = attributes.get(name) or default
    if text not in units:
        raise CalibrationError(f"{name} is '{text}'; expected one of {', '.join(units)}")
    return units[text]


def _tool_transform(transforms: list[dict[str, str]], head: dict[str, str]) -> Array:
    """Return the matrix (6, 6) that expresses a wrench about the transducer's origin in the tool's frame.

    As in `TTM` of ATI's library, the tool's frame is first moved to p = (Dx, Dy, Dz), and then turned by Rx, Ry and Rz
    about its own axes, each already turned by the angles before. R = (X Y Z)^T gives [[R, 0], [-R [p]x, R]].
    """
    if not transforms:
        return np.eye(6)
    values: list[float] = []
    for name in ("Dx", "Dy", "Dz", "Rx", "Ry", "Rz"):
        text = transforms[0].get(name) or "0"
        values.append(float(text) if _NUMBER.fullmatch(text) else math.nan)
        if not math.isfinite(values[-1]):
            raise CalibrationError(f"BasicTransform: {name} is '{text}'; expected a number")
    position = np.array(values[:3]) * _unit(head, "DistUnits", LENGTH_UNITS)
    angles = np.array(values[3:]) * _unit(head, "AngleUnits", ANGLE_UNITS, "degrees")
    about_x, about_y, about_z = (rotation_from_vector(vector) for vector in np.diag(angles))
    rotation = (about_x @ about_y @ about_z).T
    transform = np.zeros((6, 6))
    transform[:3, :3] = transform[3:, 3:] = rotation
    transform[3:, :3] = -rotation @ cross_matrix(position)
    return transform


def _compare(computed: Array, given: Array) -> None:
    """Raise CalibrationError if the UserAxis rows `given` in a file differ from its converted Axis rows `computed`."""
    off = np.abs(given - computed).max(axis=1) / np.abs(computed).max(axis=1)
    worst = int(np.argmax(off))
    if not off[worst] <= ROW_TOLERANCE:
        raise CalibrationError(
            f"UserAxis {AXES[worst]} differs from Axis and BasicTransform by {off[worst]:.2g} of the row; "
            f"expected at most {ROW_TOLERANCE:g}"
        )
