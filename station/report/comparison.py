"""Comparison of a run's tip errors with the numbers that the paper reports, and a list of all errors of a run.

The errors come from the run's summary, in millimetres, from the time `counted_from_s` on. `measured` errors compare the
desired tip with the tracker, as in the paper; `true` errors compare it with the simulated real robot (plant).
"""

from collections.abc import Iterator
from typing import NamedTuple

from station.report.run import RecordedRun
from station.report.style import AXES


class ComparisonFigure(NamedTuple):
    """One number that the paper reports, with the measured and the true number of a run."""

    case: str
    quantity: str
    paper: float
    measured: float
    true: float | None  #: true number; None if the recording has no ground truth

    @property
    def ratio(self) -> float:
        """Ratio of the measured number to the paper's."""
        return self.measured / self.paper


class ComparedErrors(NamedTuple):
    """One kind of tip error of one case (e.g. largest true error) in x, y and z."""

    case: str
    kind: str
    values: tuple[float, float, float]


def paper_comparison(run: RecordedRun) -> Iterator[ComparisonFigure]:
    """Yield every number that the paper reports for a case of this run, with the numbers of the run."""
    for name, numbers in run.summary.get("cases", {}).items():
        true = numbers.get("true_max_abs_error_mm")
        for axis, paper in run.paper(name, "max_abs_error_mm").items():
            if "max_abs_error_mm" in numbers:
                at = AXES.index(axis)
                measured = numbers["max_abs_error_mm"][at]
                yield ComparisonFigure(name, f"largest |E| in {axis}", paper, measured, true[at] if true else None)
        for model, paper in run.paper(name, "model_error_mm").items():
            if model in numbers.get("model_error_mm", {}):
                measured = numbers["model_error_mm"][model]
                yield ComparisonFigure(name, f"mean distance of the {model} model", paper, measured, None)


def all_errors(run: RecordedRun) -> Iterator[ComparedErrors]:
    """Yield the largest and RMS errors of every case."""
    for name, numbers in run.summary.get("cases", {}).items():
        for kind, key in (("largest |E|", "max_abs_error_mm"), ("RMS E", "rms_error_mm")):
            for against, prefix in (("measured", ""), ("true", "true_")):
                if prefix + key in numbers:
                    x, y, z = numbers[prefix + key]
                    yield ComparedErrors(name, f"{kind}, {against}", (x, y, z))
