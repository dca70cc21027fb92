"""Figure of the tip's step responses, compared with the first-order lag of the paper's eq. (31)."""

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from core.robot.robot import Array
from station.experiments.case_summary import fit_step, fold
from station.report import style
from station.report.figure import ReportFigure
from station.report.run import RecordedCase, RecordedRun

RESPONSE_STYLE = style.LineStyle("true tip, mean of all steps", style.ORANGE, "-", 1.6)
FIT_STYLE = style.LineStyle("fit: lag with dead time", style.BLACK, (0.0, (5.0, 1.5)), 1.1)
LAW_STYLE = style.LineStyle("eq. (31): rate k, no dead time", style.BLUE, (0.0, (1.0, 1.2)), 1.3)


def draw(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield a figure with a diagram for each case; a row has one diagram for each axis of the tip."""
    if not run.cases:
        return
    down = -(-len(run.cases) // 3)
    figure = Figure(figsize=(style.WIDTH_INCH, 0.8 + 1.9 * down))
    grid = figure.subplots(down, min(3, len(run.cases)), sharex=True, sharey=True, squeeze=False).ravel()
    fits = []
    for case, axes in zip(run.cases, grid, strict=False):
        times, answer = _folded(case)
        fit, rate = fit_step(times, answer), float(case.file["controller"]["k1"])
        style.draw(axes, times, answer, RESPONSE_STYLE)
        style.draw(axes, times, -np.expm1(-fit.rate * np.maximum(times - fit.dead_time, 0.0)), FIT_STYLE)
        style.draw(axes, times, -np.expm1(-rate * times), LAW_STYLE)
        axes.set_title(f"{_axis(case)}, k = {rate:g} 1/s\nfit {fit.rate:.2f} 1/s, {1e3 * fit.dead_time:.0f} ms")
        fits.append(f"k {rate:g} {_axis(case)}: {fit.rate:.2f} 1/s after {1e3 * fit.dead_time:.0f} ms")
    for axes in grid[-min(3, len(run.cases)) :]:
        axes.set_xlabel("time since the step [s]")
    for axes in grid[:: min(3, len(run.cases))]:
        axes.set_ylabel("part of the step")
    style.legend(figure, list(grid[:1]))
    yield ReportFigure(
        "steps", "Step responses against eq. (31)",
        "Position of the tip along a step; steps in both directions are averaged. The dead time comes from the serial"
        " line and the ramps of the stages.",
        "Step responses; fitted rates and dead times: " + "; ".join(fits) + ".",
        figure,
    )  # fmt: skip


def _folded(case: RecordedCase) -> tuple[Array, Array]:
    motion = case.file["trajectory"]
    offset = np.array(motion["offset"], dtype=float)
    start = case.of("tip_desired")[0] - offset
    tip = case.of("tip_true" if case.truth_known else "tip_observed")
    answer = (tip - start) @ offset / float(offset @ offset)
    stay = motion.get("stay")
    return fold(case.time, answer, stay) if stay else (case.time, answer)


def _axis(case: RecordedCase) -> str:
    return style.AXES[int(np.abs(case.file["trajectory"]["offset"]).argmax())]
