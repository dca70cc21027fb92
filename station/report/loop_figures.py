"""Figures of the control loop: step responses, compared with eq. (31) of the paper, and timing in real time."""

from collections.abc import Iterator

import numpy as np

from core.robot.robot import Array
from station.config.motions import StepMotion
from station.config.strict import check
from station.experiments.results import fit_step, step_response
from station.report import style
from station.report.document import ReportFigure
from station.report.run import RecordedCase, RecordedRun

RESPONSE_STYLE = style.LineStyle("true tip, mean of all steps", style.ORANGE, "-", 1.6)
FIT_STYLE = style.LineStyle("fit: lag with dead time", style.BLACK, (0.0, (5.0, 1.5)), 1.1)
LAW_STYLE = style.LineStyle("eq. (31): rate k, no dead time", style.BLUE, (0.0, (1.0, 1.2)), 1.3)
TIMING_PARTS = (
    ("late_counts", "from the deadline to the start of the tick [µs]", style.BLUE),
    ("tick_counts", "work of a tick [µs]", style.VERMILLION),
)


def steps(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield a figure with a diagram for each case; a row has one diagram for each axis of the tip."""
    if not run.cases:
        return
    down = -(-len(run.cases) // 3)
    figure = style.blank(0.8 + 1.9 * down)
    grid = figure.subplots(down, min(3, len(run.cases)), sharex=True, sharey=True, squeeze=False).ravel()
    fits = []
    for case, axes in zip(run.cases, grid, strict=False):
        motion = check(StepMotion, case.settings["trajectory"], "trajectory")
        times, answer = step_response(case.of, "tip_true" if case.truth_known else "tip_observed", motion)
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


def _axis(case: RecordedCase) -> str:
    return style.AXES[int(np.abs(case.file["trajectory"]["offset"]).argmax())]


def timing(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield a figure with two histograms for each case that has timing.

    The recorded bins are a microsecond wide; the last bin also counts all longer times.
    """
    for name, numbers in run.summary.get("cases", {}).items():
        recorded = numbers.get("timing")
        if not recorded or "late_counts" not in recorded:
            continue
        figure = style.blank(2.6)
        for axes, (counts, label, colour) in zip(figure.subplots(1, 2), TIMING_PARTS, strict=True):
            axes.stairs(
                *even_on_a_log_axis(np.asarray(recorded[counts], dtype=float)), fill=True, color=colour, alpha=0.85
            )
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_ylim(bottom=0.7)
            axes.set_xlabel(label)
            axes.set_ylabel("ticks")
        quantiles = "; ".join(
            f"{what}: median {recorded[key]['p50']:.0f}, 99 % {recorded[key]['p99']:.0f},"
            f" largest {recorded[key]['max']:.0f} µs"
            for key, what in (("late_us", "late"), ("tick_us", "work"))
        )
        caption = (
            f"{recorded['ticks']} ticks, {recorded['missed']} periods missed, scheduling {recorded['scheduler']};"
            f" {quantiles}."
        )
        case = run.case(name)
        yield ReportFigure(
            f"timing_{name}", f"Timing of the loop{case.title_suffix if case else ''}",
            f"{caption} The bins are equally wide on their axis; the last one includes all larger values.",
            f"Histograms of lateness and work. {caption}", figure,
        )  # fmt: skip


def even_on_a_log_axis(counts: Array, bins: int = 80) -> tuple[Array, Array]:
    """Convert a histogram with bins of a microsecond to bins that have equal widths on a logarithmic axis.

    Args:
        counts: counts of 0 ... 1 us, 1 ... 2 us, ... (n,).
        bins: approximate number of bins on the logarithmic axis.

    Returns:
        Counts (m,), and edges (m + 1,) [us]. The first bin starts at 0 us; its edge is 0.5 us for the logarithmic axis.
    """
    steps = np.round(np.geomspace(1, len(counts), bins)).astype(int)
    starts = np.unique(np.concatenate(([0], steps[steps < len(counts)])))
    edges = np.append(starts, len(counts)).astype(float)
    edges[0] = 0.5
    return np.add.reduceat(counts, starts), edges
