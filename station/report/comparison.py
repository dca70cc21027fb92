"""The paper's number, ours and their ratio, side by side; and all errors of a run.

Numbers are those of the summary, in millimetres from `counted_from_s` on: `measured` against the tracker,
as in the paper, `true` against the simulated plant.
"""

from collections.abc import Iterator
from typing import NamedTuple

from station.report.run import Run
from station.report.style import AXES


class Beside(NamedTuple):
    """One number that the paper prints, and ours."""

    case: str
    quantity: str
    paper: float
    measured: float
    true: float | None  #: where it is known

    @property
    def ratio(self) -> float:
        """Measured here in units of the paper's."""
        return self.measured / self.paper


class Errors(NamedTuple):
    """One kind of error of one case, x, y and z."""

    case: str
    kind: str
    values: tuple[float, float, float]


def beside_the_paper(run: Run) -> Iterator[Beside]:
    """Every number that the paper prints for a case of this run."""
    for name, numbers in run.summary.get("cases", {}).items():
        true = numbers.get("true_max_abs_error_mm")
        for axis, paper in run.paper(name, "max_abs_error_mm").items():
            if "max_abs_error_mm" in numbers:
                at = AXES.index(axis)
                measured = numbers["max_abs_error_mm"][at]
                yield Beside(name, f"largest |E| in {axis}", paper, measured, true[at] if true else None)
        for model, paper in run.paper(name, "model_error_mm").items():
            if model in numbers.get("model_error_mm", {}):
                measured = numbers["model_error_mm"][model]
                yield Beside(name, f"mean distance of the {model} model", paper, measured, None)


def all_errors(run: Run) -> Iterator[Errors]:
    """Largest and RMS errors of every case."""
    for name, numbers in run.summary.get("cases", {}).items():
        for kind, key in (("largest |E|", "max_abs_error_mm"), ("RMS E", "rms_error_mm")):
            for against, prefix in (("measured", ""), ("true", "true_")):
                if prefix + key in numbers:
                    x, y, z = numbers[prefix + key]
                    yield Errors(name, f"{kind}, {against}", (x, y, z))
