"""Figure like the paper's Fig. 9: force at the tip, estimated from the force sensors at the bases of the tubes."""

import math
from collections.abc import Iterator

import numpy as np

from station.report import style
from station.report.figure import ReportFigure
from station.report.run import RecordedCase, RecordedRun

#: Start and end of the time interval that the paper's Fig. 9 shows [s].
PAPER_START_S, PAPER_END_S = 100.0, 200.0


def draw(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield the force figure of the first case: 100 to 200 s as in the paper, or the whole of a shorter run."""
    if run.cases:
        case, title = run.cases[0], "Fig. 9: estimated force at the tip"
        yield (
            force(case, "fig9", title, PAPER_START_S, PAPER_END_S)
            if case.time[-1] > PAPER_START_S
            else force(case, "fig9", title)
        )


def force(case: RecordedCase, name: str, title: str, start: float = 0.0, end: float = math.inf) -> ReportFigure:
    """Return a figure of the force per axis: single samples, filtered and true, from `start` to `end` [s]."""
    shown = (case.time >= start) & (case.time <= end)
    time = case.time[shown]
    figure, axes = style.stacked([f"$F_{axis}$ [N]" for axis in style.AXES])
    uncertain = bool(case.names("force_variance"))  # older recordings have no variance
    for column, each in enumerate(axes):
        style.draw(each, time, case.of("force")[shown, column], style.SAMPLES)
        filtered = case.of("force_filtered")[shown, column]
        if uncertain:
            spread = 2.0 * np.sqrt(case.of("force_variance")[shown, column])
            each.fill_between(
                time, filtered - spread, filtered + spread, color=style.FILTERED.colour, alpha=0.25, linewidth=0.0
            )
        style.draw(each, time, filtered, style.FILTERED)
        if case.truth_known:
            dashed = style.TRUE._replace(dash=(0.0, (4.0, 2.0)), width=1.0)
            style.draw(each, time, case.of("force_true")[shown, column], dashed)
    style.legend(figure, axes[:1])
    summary = ""
    if case.truth_known:
        errors = (
            f"{label} {' / '.join(f'{value:.3f}' for value in rms)} N"
            for label, group in (("single samples", "force"), ("filtered", "force_filtered"))
            for rms in [np.sqrt(np.mean((case.of(group) - case.of("force_true"))[shown] ** 2, axis=0))]
        )
        summary = f" RMS error in x / y / z: {', '.join(errors)}."
    if uncertain:
        summary += " The band is two standard deviations, as estimated from the sensors' errors."
    return ReportFigure(
        name, f"{title}{case.title_suffix}",
        f"Components of the force fused from the sensors at the tubes' bases,"
        f" {time[0]:.0f} to {time[-1]:.0f} s.{summary}",
        f"Force in x, y and z over time.{summary}",
        figure,
    )  # fmt: skip
