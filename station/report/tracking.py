"""Figs. 7, 8 and 10: the error of the tip, per axis, and the force that causes it."""

from collections.abc import Iterator

import numpy as np

from station.report import style
from station.report.drawn import Drawn
from station.report.run import Case, Run

TITLES = {
    "fig7": "Fig. 7: regulation with the unloaded inverse Jacobian",
    "fig8": "Fig. 8: regulation with the dual-layer controller",
    "fig10": "Fig. 10: tracking error with the dual-layer controller",
}


def draw(run: Run) -> Iterator[Drawn]:
    """A figure for each case, the paper's own first."""
    for number, case in enumerate(run.cases):
        if number == 0:
            yield tracking_error(run, case, run.experiment, TITLES[run.experiment])
        else:
            yield tracking_error(run, case, f"{run.experiment}_{case.name}", "Tracking error")


def tracking_error(run: Run, case: Case, name: str, title: str) -> Drawn:
    """Error and force of one case."""
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
        style.draw(axes[3], case.time, force[:, column], style.Look(f"estimated $F_{axis}$", colour, dash, 1.2))
    # What little of the first seconds is far outside must not flatten all the rest.
    counted = [case.true_error()[case.time >= case.counted_from - 1e-9]] if case.truth_known else []
    counted.append(measured[at >= case.counted_from - 1e-9])
    for column, (axis, each) in enumerate(zip(style.AXES, axes[:3], strict=True)):
        reach = max([float(np.abs(part[:, column]).max()) for part in counted if len(part)] + [paper.get(axis, 0.0)])
        if reach > 0.0:
            each.set_ylim(-1.15 * reach, 1.15 * reach)
    style.legend(figure, axes, columns=3)
    largest = _largest(case)
    notes = f" Grey: the first {case.counted_from:g} s, which do not count." if case.counted_from > 0.0 else ""
    notes += " Dotted: the largest error that the paper prints, where it does." if paper else ""
    true = " and, as only a simulated bench can tell, minus true" if case.truth_known else ""
    return Drawn(
        name, f"{title}{case.words}",
        f"Desired minus measured{true} position of the tip; below, the estimated force.{notes} {largest}",
        f"Error in x, y and z over time, and force. {largest}",
        figure,
    )  # fmt: skip


def _largest(case: Case) -> str:
    at, measured = case.measured_error()
    parts = [("measured", measured[at >= case.counted_from - 1e-9])]
    if case.truth_known:
        parts.append(("true", case.true_error()[case.time >= case.counted_from - 1e-9]))
    words = [
        f"{name} {' / '.join(f'{value:.2f}' for value in np.abs(error).max(axis=0))} mm"
        for name, error in parts
        if len(error)
    ]
    return f"Largest error in x / y / z: {', '.join(words)}." if words else "It ended before anything counted."
