"""Error and force of a run as curves that are small enough for a page, their peaks kept."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import TypeAdapter, ValidationError

from core.robot.robot import Array
from station.config.strict import Row, Strict
from station.report.run import Case, read_run
from station.report.written import ReportError, written

NAME = "curves.json"
#: Of each line the largest value of so many pieces is kept.
PIECES = 240


class Line(Strict):
    """Values over the time since the motion's start."""

    time: tuple[float, ...] = Row
    """[s]"""
    value: tuple[float, ...] = Row


class Curve(Strict):
    """One case."""

    against: Literal["true", "measured"]
    """what the desired tip is compared with"""
    error: Line | None
    """distance from the desired tip [mm]; null where there is no path for the tip"""
    force: Line
    """size of the filtered force at the tip [N]"""
    counted_from: float
    """errors count from here on [s]"""


Curves = TypeAdapter(dict[str, Curve])


def write_curves(folder: Path) -> Path:
    """Leave the curves of the run in `folder` there.

    Raises:
        NoRun: there is no run in the folder.
        ConfigError, RecordingError: a file of the run cannot be read.
        ReportError: the file cannot be written.
    """
    found = {case.name: _curve(case) for case in read_run(folder).cases if case.moved}
    try:
        return written(Curves.dump_json(found).decode(), folder / NAME)
    except OSError as error:
        raise ReportError(f"{folder}: cannot write curves there: {error.strerror}") from None


def read_curves(folder: Path) -> Mapping[str, Curve] | None:
    """Those that were left in `folder`; None: there are none, or somebody has spoilt them."""
    try:
        return Curves.validate_json((folder / NAME).read_bytes())
    except (OSError, ValidationError):
        return None


def _curve(case: Case) -> Curve:
    times, error = (case.time, case.true_error()) if case.truth_known else case.measured_error()
    return Curve(
        against="true" if case.truth_known else "measured",
        error=None if case.sweeps else peaks(times, np.linalg.norm(error, axis=1)),
        force=peaks(case.time, np.linalg.norm(case.of("force_filtered"), axis=1)),
        counted_from=case.counted_from,
    )


def peaks(times: Array, values: Array, pieces: int = PIECES) -> Line:
    """The largest value of each piece of a line, when it was.

    Args:
        times: (m,) [s].
        values: (m,).
        pieces: at most.
    """
    each = max(1, -(-len(values) // pieces))
    at = [first + int(values[first : first + each].argmax()) for first in range(0, len(values), each)]
    return Line(time=tuple(np.round(times[at], 3).tolist()), value=tuple(np.round(values[at], 4).tolist()))
