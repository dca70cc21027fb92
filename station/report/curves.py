"""Curves of tip error and force of a run for the operator's page, reduced to a few hundred points with all peaks."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import TypeAdapter, ValidationError

from core.robot.robot import Array
from station.config.strict import Row, Strict
from station.recording.run_folder import write_atomically
from station.recording.run_outcome import known_force
from station.regular_file import read_in
from station.report.run import RecordedCase, ReportError, read_run

CURVES_FILE = "curves.json"
#: Number of time intervals into which a curve is divided; the largest value of each interval is kept.
CURVE_BINS = 240


class CurveLine(Strict):
    """Line of a curve: values over the time since the motion's start."""

    time: tuple[float, ...] = Row
    """time since the motion's start [s]"""
    value: tuple[float, ...] = Row


class CurveMark(Strict):
    """Moment of a run that the operator has marked."""

    time: float
    """time since the motion's start [s]"""
    text: str


class Curve(Strict):
    """Curves of tip error and force of one case."""

    against: Literal["true", "measured"]
    """tip that is compared with the desired tip"""
    error: CurveLine | None
    """distance from the desired tip [mm]; null without a path of the tip"""
    force: CurveLine | None
    """magnitude of the filtered force at the tip [N]; null if it is unknown"""
    force_unknown: str = ""
    """axes in which the force is unknown, which are left out: "", "z", "xz" ..."""
    counted_from: float
    """time from which errors count [s]"""
    marks: tuple[CurveMark, ...] = ()


Curves = TypeAdapter(dict[str, Curve])


def write_curves(folder: Path) -> Path:
    """Write the curves of the run in `folder` as a file into this folder, and return its path.

    Raises:
        NoRun: the folder has no run.
        ConfigError, RecordingError: a file of the run cannot be read.
        ReportError: the file cannot be written.
    """
    found = {case.name: _curve(case) for case in read_run(folder).cases if case.moved}
    try:
        return write_atomically(Curves.dump_json(found).decode(), folder / CURVES_FILE)
    except OSError as error:
        raise ReportError(f"{folder}: cannot write curves: {error.strerror}") from None


def read_curves(folder: Path) -> Mapping[str, Curve] | None:
    """Return the stored curves of the run in `folder` by case; None if the file is missing or invalid."""
    try:
        return Curves.validate_json(read_in(folder, CURVES_FILE))
    except (OSError, ValidationError):
        return None


def _curve(case: RecordedCase) -> Curve:
    unknown = case.force_unknown
    return Curve(
        against="true" if case.truth_known else "measured",
        error=None if case.sweeps else peaks(*case.distance()),
        force=None if unknown == "xyz" else peaks(case.time, known_force(case.of, unknown)),
        force_unknown=unknown,
        counted_from=case.counted_from,
        marks=tuple(CurveMark(time=round(time, 3), text=text) for time, text in case.marks),
    )


def peaks(times: Array, values: Array, pieces: int = CURVE_BINS) -> CurveLine:
    """Return the largest value of a line in each of several time intervals, with its time.

    Args:
        times: (m,) [s].
        values: (m,).
        pieces: largest number of time intervals.
    """
    each = max(1, -(-len(values) // pieces))
    at = [first + int(values[first : first + each].argmax()) for first in range(0, len(values), each)]
    return CurveLine(time=tuple(np.round(times[at], 3).tolist()), value=tuple(np.round(values[at], 4).tolist()))
