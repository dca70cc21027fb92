"""A target that is followed: its place and the tip's, and how far the tip is from where it should be beside it."""

from collections.abc import Iterator

import numpy as np

from station.report import style
from station.report.drawn import Drawn
from station.report.run import Case, Run

BESIDE = style.Look("target and offset, true", style.GREEN, (0.0, (5.0, 2.0)), 1.3)
SETPOINT = style.Look("setpoint", style.BLUE, (0.0, (1.0, 1.2)), 1.1)


def draw(run: Run) -> Iterator[Drawn]:
    """A figure of each case with a target, and one that compares their errors."""
    cases = [case for case in run.cases if case.follows and case.truth_known]
    for case in cases:
        yield _curves(case)
    if len(cases) > 1:
        yield _compared(cases)


def _curves(case: Case) -> Drawn:
    """Tip and target by axis from their means, and the error as a distance."""
    labels = [*(f"$X_{axis}$ [mm]" for axis in style.AXES), "error [mm]"]
    figure, axes = style.stacked(labels, height=1.2)
    wanted, tip, setpoint = 1e3 * case.beside(), 1e3 * case.of("tip_true"), 1e3 * case.of("tip_desired")
    middle = wanted.mean(axis=0)
    for column, each in enumerate(axes[:3]):
        style.draw(each, case.time, tip[:, column] - middle[column], style.TRUE)
        style.draw(each, case.time, wanted[:, column] - middle[column], BESIDE)
        style.draw(each, case.time, setpoint[:, column] - middle[column], SETPOINT)
    error = np.linalg.norm(wanted - tip, axis=1)
    style.draw(axes[3], case.time, error, style.TRUE, label=False)
    before, after = _largest(case, error)
    axes[3].set_ylim(0.0, 1.15 * max(after, 0.1))
    for each in axes:
        each.axvspan(0.0, case.settled_from, color=style.GREY, alpha=0.10, linewidth=0.0)
    style.legend(figure, axes[:1])
    words = (
        f"Largest true error: {before:.2f} mm in the first {case.settled_from:g} s (grey), while the rhythms are found"
        f" and the load is hung on, {after:.2f} mm after that."
    )
    return Drawn(
        f"follow_{case.name}", f"Following a target (case '{case.name}')",
        f"The simulated plant's tip, the simulated target with the offset of the start, and the setpoint, each from the"
        f" target's mean; below, the distance between tip and target with offset. {words}",
        f"Tip and target in x, y and z over time, and the error. {words}", figure,
    )  # fmt: skip


def _compared(cases: list[Case]) -> Drawn:
    figure, (axes,) = style.stacked(["error [mm]"], height=2.4)
    words: list[str] = []
    for number, case in enumerate(cases):
        error = 1e3 * np.linalg.norm(case.beside() - case.of("tip_true"), axis=1)
        style.draw(axes, case.time, error, style.series(number, case.name.replace("_", " ")))
        words.append(f"{case.name} {_largest(case, error)[1]:.2f} mm")
    axes.set_yscale("log")
    axes.set_ylim(bottom=0.02)
    style.legend(figure, [axes], columns=2)
    said = f"Largest true error after the settling time: {', '.join(words)}."
    return Drawn("follow_errors", "Errors with and without prediction", said, f"Errors over time. {said}", figure)


def _largest(case: Case, error: np.ndarray) -> tuple[float, float]:
    """Before and after the settling time [mm]."""
    settled = case.time >= case.settled_from - 1e-9
    before, after = error[~settled], error[settled]
    return float(before.max(initial=0.0)), float(after.max(initial=0.0))
