"""Figures of runs that follow a target: target and tip positions, and distance of the tip from its desired offset."""

from collections.abc import Iterator

import numpy as np

from station.report import style
from station.report.figure import ReportFigure
from station.report.run import RecordedCase, RecordedRun

TARGET_STYLE = style.LineStyle("target and offset, true", style.GREEN, (0.0, (5.0, 2.0)), 1.3)
SETPOINT_STYLE = style.LineStyle("setpoint", style.BLUE, (0.0, (1.0, 1.2)), 1.1)


def draw(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield a figure for each case with a target, and a figure that compares the errors of these cases."""
    cases = [case for case in run.cases if case.follows and case.truth_known]
    for case in cases:
        yield _curves(case)
    if len(cases) > 1:
        yield _compared(cases)


def _curves(case: RecordedCase) -> ReportFigure:
    """Return a figure with tip and target by axis, relative to the target's mean, and the error as a distance."""
    labels = [*(f"$X_{axis}$ [mm]" for axis in style.AXES), "error [mm]"]
    figure, axes = style.stacked(labels, height=1.2)
    desired, tip, setpoint = 1e3 * case.desired_tip(), 1e3 * case.of("tip_true"), 1e3 * case.of("tip_desired")
    middle = desired.mean(axis=0)
    for column, each in enumerate(axes[:3]):
        style.draw(each, case.time, tip[:, column] - middle[column], style.TRUE)
        style.draw(each, case.time, desired[:, column] - middle[column], TARGET_STYLE)
        style.draw(each, case.time, setpoint[:, column] - middle[column], SETPOINT_STYLE)
    error = np.linalg.norm(desired - tip, axis=1)
    style.draw(axes[3], case.time, error, style.TRUE, label=False)
    before, after = _largest(case, error)
    axes[3].set_ylim(0.0, 1.15 * max(after, 0.1))
    for each in axes:
        each.axvspan(0.0, case.settled_from, color=style.GREY, alpha=0.10, linewidth=0.0)
    style.legend(figure, axes[:1])
    errors = (
        f"Largest true error: {before:.2f} mm in the first {case.settled_from:g} s (grey), while the frequencies are"
        f" estimated and the load is applied; {after:.2f} mm after that."
    )
    return ReportFigure(
        f"follow_{case.name}", f"Following a target (case '{case.name}')",
        f"Tip of the simulated plant, simulated target with the offset at the start, and setpoint, each relative to the"
        f" target's mean. Below: distance between tip and target with offset. {errors}",
        f"Tip and target in x, y and z over time, and the error. {errors}", figure,
    )  # fmt: skip


def _compared(cases: list[RecordedCase]) -> ReportFigure:
    figure, (axes,) = style.stacked(["error [mm]"], height=2.4)
    errors: list[str] = []
    for number, case in enumerate(cases):
        error = 1e3 * np.linalg.norm(case.desired_tip() - case.of("tip_true"), axis=1)
        style.draw(axes, case.time, error, style.series(number, case.name.replace("_", " ")))
        errors.append(f"{case.name} {_largest(case, error)[1]:.2f} mm")
    axes.set_yscale("log")
    axes.set_ylim(bottom=0.02)
    style.legend(figure, [axes], columns=2)
    caption = f"Largest true error after the settling time: {', '.join(errors)}."
    return ReportFigure(
        "follow_errors", "Errors with and without prediction", caption, f"Errors over time. {caption}", figure
    )


def _largest(case: RecordedCase, error: np.ndarray) -> tuple[float, float]:
    """Return the largest tip error of a case before and after the settling time [mm]."""
    settled = case.time >= case.settled_from - 1e-9
    before, after = error[~settled], error[settled]
    return float(before.max(initial=0.0)), float(after.max(initial=0.0))
