"""Fig. 3: where the tip goes under each control strategy, and how far that is from where it should be."""

from collections.abc import Iterator

import numpy as np

from station.report import style
from station.report.drawn import Drawn
from station.report.run import Run

TITLES = {
    "a": "(a) unloaded Jacobian",
    "b": "(b) loaded Jacobian",
    "c": "(c) inner loop: J(q, 0) and deflection rate, eq. (24)",
    "d": "(d) dual layer",
    "d_feedforward": "(d) with feed-forward",
}


def draw(run: Run) -> Iterator[Drawn]:
    """Positions as in the paper, and errors, where (c) and (d) can be told apart."""
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
    yield Drawn(
        "fig3", "Fig. 3: tip position under four strategies",
        "Position of the simulated rod's tip from its start, per axis, as in the paper's Fig. 3. (d) is also shown"
        " with the velocity of the path fed forward.",
        "Tip position in x, y and z over time for each strategy. " + _in_words(largest),
        figure,
    )  # fmt: skip

    figure, axes = style.stacked([f"$E_{axis}$ [mm]" for axis in style.AXES])
    for column, each in enumerate(axes):
        for number, case in enumerate(run.cases):
            look = style.series(number, TITLES.get(case.name, case.name))
            style.draw(each, case.time, case.true_error()[:, column], look)
        # What drifts by millimetres and what stays within hundredths, on one axis.
        each.set_yscale("symlog", linthresh=0.05, linscale=0.6)
        each.set_yticks([-10, -1, -0.1, 0, 0.1, 1, 10], ["-10", "-1", "-0.1", "0", "0.1", "1", "10"])
    style.legend(figure, axes[:1], columns=3)
    yield Drawn(
        "fig3_errors", "Errors of the four strategies",
        "Desired minus true position of the tip. Linear within 0.05 mm, logarithmic beyond.",
        "Tip error in x, y and z over time for each strategy. " + _in_words(largest),
        figure,
    )  # fmt: skip


def _in_words(largest: dict[str, np.ndarray]) -> str:
    parts = (f"{name}: {x:.2f}, {y:.2f}, {z:.2f} mm" for name, (x, y, z) in largest.items())
    return "Largest errors in x, y, z: " + "; ".join(parts) + "."
