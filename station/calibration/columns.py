"""Tables of poses as other laboratories write them: text, MATLAB and Excel files, with other names and units.

A choice of columns, `NAME=COLUMN[UNIT]`, states which column of the table has a joint, a tip coordinate, a force or the
time, and in which unit. `NAME=-COLUMN[UNIT]+OFFSET` reverses a column and adds an offset in SI units: a joint that
counts insertions forward needs both to become the tube's position behind the plate. Nothing is guessed.
"""

import csv
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np

from core.errors import CtrError
from station.config.strict import read_text

#: Columns of a file of poses, as help and error messages show them; the robot determines the names of the joints.
COLUMNS_HELP = (
    "the robot's joints by their names [rad or m], tip_x, tip_y, tip_z [m]; optional: force_x, force_y, force_z (on"
    " the tip, in the robot's frame) [N], time [s] where the order matters, trajectory (a number)"
)
#: Units of columns: SI value of one unit, and the SI unit.
UNITS = {
    "rad": (1.0, "rad"), "deg": (np.pi / 180.0, "rad"), "m": (1.0, "m"), "cm": (1e-2, "m"), "mm": (1e-3, "m"),
    "um": (1e-6, "m"), "N": (1.0, "N"), "mN": (1e-3, "N"), "s": (1.0, "s"), "ms": (1e-3, "s"), "us": (1e-6, "s"),
}  # fmt: skip
#: First bytes of a MATLAB file of version 7.3, which is an HDF5 file; no installed library reads it.
MATLAB_73 = b"MATLAB 7.3"
#: Texts of cells (in lower case) that mean a missing number.
MISSING_CELLS = frozenset(("", "nan", "na", "n/a", "null", "none"))
_CHOICE = re.compile(r"(?P<name>\w+)=(?P<sign>-?)(?P<column>[^\[\]+]+)(\[(?P<unit>\w+)\])?(?P<offset>[+-][\d.eE+-]+)?")


class PosesError(CtrError):
    """An invalid file of poses; the message names the line or column, and what was expected."""


class ColumnChoice(NamedTuple):
    """Column of a table that has a quantity, and its conversion to SI values: factor * number + offset."""

    name: str
    column: str  #: name in the header, or # and a number from 1
    unit: str  #: empty: the SI unit
    sign: float
    offset: float

    @property
    def factor(self) -> float:
        """SI value of one unit of the column, with the sign."""
        return self.sign * (UNITS[self.unit][0] if self.unit else 1.0)


class PoseTable(NamedTuple):
    """A table of texts, with the line number of each row."""

    header: list[str]
    rows: list[tuple[int, list[str]]]


def column_choice(text: str) -> ColumnChoice:
    """Parse a choice of a column.

    Raises:
        PosesError: the text is not a choice of a column, or its unit is unknown.
    """
    match = _CHOICE.fullmatch(text.strip())
    if match is None:
        raise PosesError(
            f"--columns {text!r}: expected NAME=COLUMN[UNIT], for example tip_x=X[mm], inner_translation=-d1[mm], or"
            " inner_translation=ins[mm]-0.15 with an offset in metres"
        )
    unit = match["unit"] or ""
    if unit and unit not in UNITS:
        raise PosesError(f"--columns {text!r}: unknown unit {unit!r}; known are {', '.join(UNITS)}")
    try:
        offset = float(match["offset"] or 0.0)
    except ValueError:
        raise PosesError(f"--columns {text!r}: the offset {match['offset']!r} is not a number") from None
    return ColumnChoice(match["name"], match["column"].strip(), unit, -1.0 if match["sign"] else 1.0, offset)


def pose_table(path: Path, choices: Sequence[ColumnChoice]) -> PoseTable:
    """Return the table of a file, with the chosen columns only if there are choices.

    Raises:
        PosesError: the file is missing or not a table, or lacks a chosen column.
    """
    suffix, named = path.suffix.lower(), {".mat": _matlab, ".parquet": _parquet}
    if suffix in named:
        table = named[suffix](path)
    else:
        table = _headed(path, _excel(path) if suffix == ".xlsx" else _text(path, bool(choices)), bool(choices))
    if not choices:
        return table
    places = {name: k for k, name in enumerate(table.header)} | {f"#{k + 1}": k for k in range(len(table.header))}
    for choice in choices:
        if choice.column not in places:
            raise PosesError(f"{path}: no column {choice.column!r} for {choice.name}; it has {', '.join(table.header)}")
    rows = [(line, [_converted(cells, places[c.column], c) for c in choices]) for line, cells in table.rows]
    return PoseTable([choice.name for choice in choices], rows)


def _converted(cells: Sequence[str], place: int, choice: ColumnChoice) -> str:
    cell = cells[place] if place < len(cells) else ""
    try:
        return repr(choice.factor * float(cell) + choice.offset)
    except ValueError:
        return cell


def _parquet(path: Path) -> PoseTable:
    """Return the table of a dataset; columns with a dot in their names, and the split, are not part of its poses."""
    try:
        from pyarrow import ArrowException, parquet
    except ImportError:
        raise PosesError(f"{path}: needs the package pyarrow: pip install 'ctr-station[parquet]'") from None
    try:
        table = parquet.read_table(path)
    except (OSError, ArrowException) as error:
        raise PosesError(f"{path}: cannot be read: {error}") from None
    names = [name for name in table.column_names if "." not in name and name != "split"]
    columns = [map(repr, table[name].to_pylist()) for name in names]
    return PoseTable(names, [(k, list(cells)) for k, cells in enumerate(zip(*columns, strict=True), 1)])


def _excel(path: Path) -> list[tuple[int, list[str]]]:
    """Return the rows of a workbook's first sheet, with the values that Excel has computed last."""
    try:
        from openpyxl import load_workbook
    except ImportError:
        raise PosesError(f"{path}: needs the package openpyxl: pip install 'ctr-station[excel]'") from None
    try:
        sheet = load_workbook(path, read_only=True, data_only=True).worksheets[0]
        rows = [(k, ["" if v is None else str(v).strip() for v in row]) for k, row in enumerate(sheet.values, 1)]
    except (OSError, ValueError, KeyError, IndexError, BadZipFile) as error:
        raise PosesError(f"{path}: no Excel workbook with a sheet: {error}") from None
    width = max((k + 1 for _, cells in rows for k, cell in enumerate(cells) if cell), default=0)
    return [(line, cells[:width]) for line, cells in rows]


def _headed(path: Path, rows: list[tuple[int, list[str]]], numbered: bool) -> PoseTable:
    """Return a table whose first row is the header; without one, the names of numbered columns are #1, #2, ..."""
    rows = [(line, cells) for line, cells in rows if any(cells) and not cells[0].startswith("#")]
    if not rows:
        raise PosesError(f"{path}: empty; columns: {COLUMNS_HELP}")
    header = rows[0][1]
    if numbered and all(cell_number(cell) is not None for cell in header):
        return PoseTable([f"#{k + 1}" for k in range(len(header))], rows)
    return PoseTable(header, rows[1:])


def _text(path: Path, numbered: bool) -> list[tuple[int, list[str]]]:
    """Return the rows of a text; commas separate cells, or for chosen columns also semicolons, tabs or spaces."""
    if path.suffix.lower() in (".xls", ".ods"):
        raise PosesError(f"{path}: this format of spreadsheets is not read; save it as .xlsx or CSV")
    lines = read_text(path, PosesError).splitlines()
    first = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    separator = next((mark for mark in ",;\t" if mark in first), " ") if numbered else ","
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    try:
        rows = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader]
    except csv.Error as error:
        raise PosesError(f"{path}: line {reader.line_num}: not CSV: {error}") from None
    return rows


def cell_number(cell: str) -> float | None:
    """Return a cell's number, NaN for a missing one; None for text."""
    if cell.lower() in MISSING_CELLS:
        return math.nan
    try:
        return float(cell)
    except ValueError:
        return None


def _matlab(path: Path) -> PoseTable:
    """Return the variables of a MATLAB file as columns: vectors by name, matrices (m, k) as NAME#1 ... NAME#k.

    Homogeneous transforms (4, 4, m) or (m, 4, 4) have their positions in NAME#1, NAME#2 and NAME#3.
    """
    from scipy.io import loadmat  # pyright: ignore  - slow to import

    try:
        with path.open("rb") as file:
            start = file.read(len(MATLAB_73))
        values: dict[str, Any] = {} if start == MATLAB_73 else loadmat(str(path), simplify_cells=True)
    except (OSError, ValueError, TypeError, NotImplementedError) as error:
        raise PosesError(f"{path}: cannot be read as a MATLAB file: {error}") from None
    if start == MATLAB_73:
        raise PosesError(f"{path}: a MATLAB file of version 7.3; save it with save(..., '-v7'), or as CSV")
    columns = dict(_columns_of({name: value for name, value in values.items() if not name.startswith("__")}))
    if not columns:
        raise PosesError(f"{path}: no numeric vector or matrix in it")
    lengths = {name: len(column) for name, column in columns.items()}
    rows = max(set(lengths.values()), key=list(lengths.values()).count)
    columns = {name: column for name, column in columns.items() if len(column) == rows}
    matrix = np.column_stack(list(columns.values()))
    return PoseTable(list(columns), [(k + 1, [repr(value) for value in row]) for k, row in enumerate(matrix.tolist())])


def _columns_of(values: dict[str, Any], within: str = "") -> Iterable[tuple[str, np.ndarray[Any, Any]]]:
    for key, value in values.items():
        name = f"{within}{key}"
        if isinstance(value, dict):
            yield from _columns_of(value, f"{name}.")  # pyright: ignore[reportUnknownArgumentType]
            continue
        array = np.asarray(value)
        if array.dtype.kind not in "fiu":
            continue
        if array.ndim == 1:
            yield name, array
        elif array.ndim == 2:
            yield from ((f"{name}#{k + 1}", array[:, k]) for k in range(array.shape[1]))
        elif array.ndim == 3 and array.shape[:2] == (4, 4):
            yield from ((f"{name}#{k + 1}", array[k, 3]) for k in range(3))
        elif array.ndim == 3 and array.shape[1:] == (4, 4):
            yield from ((f"{name}#{k + 1}", array[:, k, 3]) for k in range(3))
