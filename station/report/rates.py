"""Figure of the deflection's rate, an input of the inner loop: three estimates and a reference computed afterwards."""

from collections.abc import Iterator

import numpy as np

from station.experiments.results import hindsight_rate
from station.report import style
from station.report.figure import ReportFigure
from station.report.run import RecordedCase, RecordedRun

ESTIMATES = (
    ("deflection_rate", style.LineStyle("filtered derivative, eq. (25)", style.ORANGE, "-", 1.2)),
    (
        "deflection_rate_exact",
        style.LineStyle(r"exact: $C\,\dot w + (J(q,w) - J(q,0))\,\dot q$", style.BLUE, (0.0, (5.0, 1.5)), 1.2),
    ),
)
RAW_STYLE = style.LineStyle("difference of two ticks", style.SKY, "-", 0.5)
HINDSIGHT_STYLE = style.LineStyle("hindsight: cubic through one second", style.BLACK, (0.0, (1.0, 1.2)), 1.3)

COMPARED_CHANNELS = {"raw": "deflection_rate_raw", "filtered": "deflection_rate", "exact": "deflection_rate_exact"}
#: Length of the time interval at the end of a run that the figure shows, after all transients [s].
SHOWN_SPAN_S = 20.0


def draw(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield the figure for one case whose inner loop uses this rate, preferably Type I on the tracker."""
    case = run.case("type_1") or (run.cases[0] if run.cases else None)
    if case is not None and case.stride == 1 and (hindsight := hindsight_rate(case.of("deflection"))) is not None:
        yield rates(case, 1e3 * hindsight)


def rates(case: RecordedCase, hindsight: np.ndarray) -> ReportFigure:
    """Return a figure with one diagram per axis; `hindsight` (ticks, 3) is the reference rate [mm/s]."""
    labels = [rf"$\dot\Delta_{axis}$ [mm/s]" for axis in style.AXES]
    figure, axes = style.stacked([*labels, r"raw $\dot\Delta_x$ [mm/s]"], height=1.25)
    counted = case.time >= case.counted_from - 1e-9
    shown = case.time >= case.time[-1] - SHOWN_SPAN_S
    for column, each in enumerate(axes[:3]):
        for group, line in ESTIMATES:
            style.draw(each, case.time[shown], 1e3 * case.of(group)[shown, column], line)
        style.draw(each, case.time[shown], hindsight[shown, column], HINDSIGHT_STYLE)
    style.draw(axes[3], case.time[shown], 1e3 * case.of("deflection_rate_raw")[shown, 0], RAW_STYLE)
    style.legend(figure, axes, columns=2)

    def rms(group: str) -> str:
        difference = (1e3 * case.of(group) - hindsight)[counted]
        return " / ".join(f"{value:.3g}" for value in np.sqrt(np.mean(difference**2, axis=0)))

    errors = (f"{name} {rms(group)} mm/s" for name, group in COMPARED_CHANNELS.items())
    summary = f"RMS difference from hindsight in x / y / z: {'; '.join(errors)}."
    return ReportFigure(
        "rates", f"Rate of the deflection{case.title_suffix}",
        f"Estimates of the rate of Delta_total and the reference in hindsight, last {SHOWN_SPAN_S:g} s. {summary}"
        " The raw difference of two ticks has all noise of the force sensors, and a separate diagram.",
        f"Deflection rates in x, y and z over time. {summary}",
        figure,
    )  # fmt: skip
