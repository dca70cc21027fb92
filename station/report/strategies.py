"""Figures like the paper's Fig. 3: position and error of the tip with each control strategy."""

from collections.abc import Iterator

import numpy as np

from station.report import style
from station.report.figure import ReportFigure
from station.report.run import RecordedRun

TITLES = {
    "a": "(a) unloaded Jacobian",
    "b": "(b) loaded Jacobian",
    "c": "(c) inner loop: J(q, 0) and deflection rate, eq. (24)",
    "d": "(d) dual layer",
    "d_feedforward": "(d) with feed-forward",
}


def draw(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield a figure of positions as in the paper, and one of errors, where strategies (c) and (d) differ visibly."""
    if not run.cases:
        return
    figure, axes = style.stacked([f"$X_{axis}$ [mm]" for axis in style.AXES])
    first = run.cases[0]
    start = first.of("tip_desired")[0]
    for column, each in enumerate(axes):
        for number, case in enumerate(run.cases):
            position = 1e3 * (case.of("tip_true") - start)[:, column]
            style.draw(each, case.time, position, style.series(number, TITLES.get(case.name, case.name)))
        style.draw(each, first.time, 1e3 * (first.of("tip_desired") - start)[:, column], style.DESIRED)
    style.legend(figure, axes[:1], columns=3)
    largest = {case.name: np.abs(case.true_error()).max(axis=0) for case in run.cases}
    yield ReportFigure(
        "fig3", "Fig. 3: tip position under four strategies",
        "Position of the simulated rod's tip from its start, per axis, as in the paper's Fig. 3. (d) is also shown"
        " with the velocity of the path fed forward.",
        "Tip position in x, y and z over time for each strategy. " + _description(largest),
        figure,
    )  # fmt: skip

    figure, axes = style.stacked([f"$E_{axis}$ [mm]" for axis in style.AXES])
    for column, each in enumerate(axes):
        for number, case in enumerate(run.cases):
            line = style.series(number, TITLES.get(case.name, case.name))
            style.draw(each, case.time, case.true_error()[:, column], line)
        # A symmetric logarithmic axis shows both drifts of millimetres and errors of hundredths of a millimetre.
        each.set_yscale("symlog", linthresh=0.05, linscale=0.6)
        each.set_yticks([-10, -1, -0.1, 0, 0.1, 1, 10], ["-10", "-1", "-0.1", "0", "0.1", "1", "10"])
    style.legend(figure, axes[:1], columns=3)
    yield ReportFigure(
        "fig3_errors", "Errors of the four strategies",
        "Desired minus true position of the tip. Linear within 0.05 mm, logarithmic beyond.",
        "Tip error in x, y and z over time for each strategy. " + _description(largest),
        figure,
    )  # fmt: skip


def _description(largest: dict[str, np.ndarray]) -> str:
    parts = (f"{name}: {x:.2f}, {y:.2f}, {z:.2f} mm" for name, (x, y, z) in largest.items())
    return "Largest errors in x, y, z: " + "; ".join(parts) + "."
