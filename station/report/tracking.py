"""Figures like the paper's Figs. 7, 8 and 10: tip error per axis, and the force that causes it."""

from collections.abc import Iterator

import numpy as np

from station.report import style
from station.report.figure import ReportFigure
from station.report.run import RecordedCase, RecordedRun

TITLES = {
    "fig7": "Fig. 7: regulation with the unloaded inverse Jacobian",
    "fig8": "Fig. 8: regulation with the dual-layer controller",
    "fig10": "Fig. 10: tracking error with the dual-layer controller",
}


def draw(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield a figure of tip error and force for each case; the case of the paper comes first."""
    for number, case in enumerate(run.cases):
        if number == 0:
            yield tracking_error(run, case, run.experiment, TITLES[run.experiment])
        else:
            yield tracking_error(run, case, f"{run.experiment}_{case.name}", "Tracking error")


def tracking_error(run: RecordedRun, case: RecordedCase, name: str, title: str) -> ReportFigure:
    """Return the figure with tip error and force of one case."""
    figure, axes = style.stacked([*(f"$E_{axis}$ [mm]" for axis in style.AXES), "$F$ [N]"], height=1.2)
    paper = run.paper(case.name, "max_abs_error_mm")
    at, measured = case.measured_error()
    for column, (axis, each) in enumerate(zip(style.AXES, axes[:3], strict=True)):
        style.draw(each, at, measured[:, column], style.MEASURED)
        if case.truth_known:
            style.draw(each, case.time, case.true_error()[:, column], style.TRUE)
        if axis in paper:
            style.bound(each, paper[axis])
        if case.counted_from > 0.0:
            each.axvspan(0.0, case.counted_from, color=style.GREY, alpha=0.10, linewidth=0.0)
    force = case.of("force_filtered")
    for column, (axis, dash) in enumerate(zip(style.AXES, ("-", (0.0, (5.0, 1.5)), (0.0, (1.0, 1.2))), strict=True)):
        colour = (style.VERMILLION, style.GREEN, style.BLUE)[column]
        style.draw(axes[3], case.time, force[:, column], style.LineStyle(f"estimated $F_{axis}$", colour, dash, 1.2))
    # The scale ignores a short large error in the first seconds, which would compress the rest.
    counted = [case.true_error()[case.time >= case.counted_from - 1e-9]] if case.truth_known else []
    counted.append(measured[at >= case.counted_from - 1e-9])
    for column, (axis, each) in enumerate(zip(style.AXES, axes[:3], strict=True)):
        reach = max([float(np.abs(part[:, column]).max()) for part in counted if len(part)] + [paper.get(axis, 0.0)])
        if reach > 0.0:
            each.set_ylim(-1.15 * reach, 1.15 * reach)
    style.legend(figure, axes, columns=3)
    largest = _largest(case)
    notes = (
        f" Grey: the first {case.counted_from:g} s, in which errors do not count." if case.counted_from > 0.0 else ""
    )
    notes += " Dotted: the largest error in the paper, if it has one." if paper else ""
    true = " and, for a simulated bench, minus true" if case.truth_known else ""
    return ReportFigure(
        name, f"{title}{case.title_suffix}",
        f"Desired minus measured{true} position of the tip; below, the estimated force.{notes} {largest}",
        f"Error in x, y and z over time, and force. {largest}",
        figure,
    )  # fmt: skip


def _largest(case: RecordedCase) -> str:
    at, measured = case.measured_error()
    parts = [("measured", measured[at >= case.counted_from - 1e-9])]
    if case.truth_known:
        parts.append(("true", case.true_error()[case.time >= case.counted_from - 1e-9]))
    parts = [
        f"{name} {' / '.join(f'{value:.2f}' for value in np.abs(error).max(axis=0))} mm"
        for name, error in parts
        if len(error)
    ]
    return f"Largest error in x / y / z: {', '.join(parts)}." if parts else "The run ended before errors counted."
