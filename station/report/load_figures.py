"""Figures of the load: force at the tip (Fig. 9), deflection (Fig. 4) and its rate, tip error over the load's rate."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from core.robot.robot import Array
from station.config.strict import merged
from station.experiments.experiment import crossed_name, variants
from station.experiments.results import hindsight_rate
from station.recording.run_outcome import rms
from station.report import style
from station.report.document import ReportFigure
from station.report.run import RecordedCase, RecordedRun

#: Start and end of the time interval that the paper's Fig. 9 shows [s].
PAPER_START_S, PAPER_END_S = 100.0, 200.0
DEFLECTION_PARTS = (
    ("deflection", style.LineStyle(r"$\Delta_{total}$", style.BLACK, "-", 1.3)),
    ("delta_1", style.LineStyle(r"$\Delta_1$: $\int C\,\dot w\,dt$", style.BLUE, (0.0, (6.0, 1.5)), 1.4)),
    (
        "delta_2",
        style.LineStyle(r"$\Delta_2$: $\int (J(q,w) - J(q,0))\,\dot q\,dt$", style.VERMILLION, (0.0, (2.0, 1.2)), 1.6),
    ),
)
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
#: Name of the cases in which no joint moves, as a reference for the strategies.
NO_MOTION = "held"
#: Line styles of the strategies by name; any other strategy gets the next style of `style.SERIES`.
STRATEGY_STYLES = {
    "regulation": style.LineStyle("dual layer, the live default", style.BLUE, "-", 1.4),
    "type_1": style.LineStyle("dual layer, as in the paper", style.VERMILLION, (0.0, (6.0, 1.5, 1.0, 1.5)), 1.4),
    NO_MOTION: style.LineStyle("no joint moves", style.BLACK, (0.0, (1.0, 1.2)), 1.6),
}
BEST_POSSIBLE_STYLE = style.LineStyle("best possible", style.GREEN, (0.0, (5.0, 2.0)), 1.6)
#: Position at which a step load is drawn on the axis of rates, as a multiple of the rate of the fastest ramp.
STEP_POSITION = 3.0
#: Errors below this value are drawn at this value [mm], because the axis is logarithmic and has no zero.
MIN_DRAWN_ERROR_MM = 0.01
#: Largest number of points of the drawn band of the force's standard deviations.
BAND_POINTS = 2 * style.LINE_BINS
SIDES = ("applied", "removed")


def paper_force(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield the force of the first case: 100 to 200 s as in the paper's Fig. 9, or the whole of a shorter run."""
    if run.cases:
        case, title = run.cases[0], "Fig. 9: estimated force at the tip"
        span = (PAPER_START_S, PAPER_END_S) if case.time[-1] > PAPER_START_S else (0.0, math.inf)
        yield force(case, "fig9", title, *span)


def force(case: RecordedCase, name: str, title: str, start: float = 0.0, end: float = math.inf) -> ReportFigure:
    """Return a figure of the force per axis: single samples, filtered and true, from `start` to `end` [s]."""
    shown = (case.time >= start) & (case.time <= end)
    time = case.time[shown]
    figure, axes = style.stacked([f"$F_{axis}$ [N]" for axis in style.AXES])
    filtered = case.of("force_filtered")[shown]
    style.draw_components(axes, time, case.of("force")[shown], style.SAMPLES)
    spread = 2.0 * np.sqrt(case.of("force_variance")[shown])
    nth = slice(None, None, max(1, len(time) // BAND_POINTS))
    low, high = (filtered - spread)[nth], (filtered + spread)[nth]
    for each, lower, upper in zip(axes, low.T, high.T, strict=True):
        each.fill_between(time[nth], lower, upper, color=style.FILTERED.colour, alpha=0.25, linewidth=0.0)
    style.draw_components(axes, time, filtered, style.FILTERED)
    if case.truth_known:
        dashed = style.TRUE._replace(dash=(0.0, (4.0, 2.0)), width=1.0)
        style.draw_components(axes, time, case.of("force_true")[shown], dashed)
    style.legend(figure, axes[:1])
    unknown = case.force_unknown
    summary = f" The force along {', '.join(unknown)} is unknown." if unknown else ""
    counted = shown & (case.time >= case.counted_from - 1e-9)
    if case.truth_known and counted.any():
        since, until = case.time[counted][[0, -1]]
        errors = (
            f"{label} {_by_axis(rms((case.of(group) - case.of('force_true'))[counted]), unknown)} N"
            for label, group in (("single samples", "force"), ("filtered", "force_filtered"))
        )
        summary += f" RMS error in x / y / z from {since:.4g} to {until:.4g} s: {', '.join(errors)}."
    source = "fused from the sensors at the tubes' bases" if case.senses else "from the deflection of the tip"
    errors = "from the sensors' errors" if case.senses else "from the tracker's and the model's errors"
    summary += f" The band is two standard deviations, as estimated {errors}."
    return ReportFigure(
        name, f"{title}{case.title_suffix}",
        f"Components of the force {source},"
        f" {time[0]:.0f} to {time[-1]:.0f} s.{summary}",
        f"Force in x, y and z over time.{summary}",
        figure,
    )  # fmt: skip


def _by_axis(values: Array, unknown: str) -> str:
    """Return a number for each axis as a text; `unknown` are axes whose number is unknown."""
    parts = zip(style.AXES, values, strict=True)
    return " / ".join("unknown" if axis in unknown else f"{value:.3f}" for axis, value in parts)


def deflection(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield figures like the paper's Fig. 4: total deflection, its compliance and Jacobian parts by eq. (22)."""
    for case in run.cases:
        figure, axes = style.stacked([rf"$\Delta_{axis}$ [mm]" for axis in style.AXES])
        for group, line in DEFLECTION_PARTS:
            style.draw_components(axes, case.time, 1e3 * case.of(group), line)
        style.legend(figure, axes[:1])
        longest = {group: 1e3 * np.linalg.norm(case.of(group), axis=1).max() for group, _ in DEFLECTION_PARTS}
        yield ReportFigure(
            "fig4", "Fig. 4: parts of the tip deflection",
            f"The model's deflection{case.title_suffix}. Largest length: total {longest['deflection']:.2f} mm,"
            f" part of the load {longest['delta_1']:.2f} mm, part of the Jacobian {longest['delta_2']:.2f} mm:"
            f" the first is {longest['delta_1'] / longest['delta_2']:.1f} times the second. The paper has no number;"
            " it reports that the first dominates.",
            f"Deflection in x, y and z over time: the total follows the part of the load, up to"
            f" {longest['delta_1']:.2f} mm, while the Jacobian's part stays below {longest['delta_2']:.2f} mm.",
            figure,
        )  # fmt: skip


def deflection_rate(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield a figure of the deflection's rate for the case `type_1`, or else for the first case."""
    case = run.case("type_1") or (run.cases[0] if run.cases else None)
    if case is not None and case.stride == 1 and (hindsight := hindsight_rate(case.of("deflection"))) is not None:
        yield _rates(case, 1e3 * hindsight)


def _rates(case: RecordedCase, hindsight: Array) -> ReportFigure:
    """Return a figure with one diagram per axis; `hindsight` (ticks, 3) is the reference rate [mm/s]."""
    labels = [rf"$\dot\Delta_{axis}$ [mm/s]" for axis in style.AXES]
    figure, axes = style.stacked([*labels, r"raw $\dot\Delta_x$ [mm/s]"], height=1.25)
    counted = case.time >= case.counted_from - 1e-9
    shown = case.time >= case.time[-1] - SHOWN_SPAN_S
    for group, line in ESTIMATES:
        style.draw_components(axes, case.time[shown], 1e3 * case.of(group)[shown], line)
    style.draw_components(axes, case.time[shown], hindsight[shown], HINDSIGHT_STYLE)
    style.draw(axes[3], case.time[shown], 1e3 * case.of("deflection_rate_raw")[shown, 0], RAW_STYLE)
    style.legend(figure, axes, columns=2)
    errors = (
        f"{name} {style.slashed(rms((1e3 * case.of(group) - hindsight)[counted]), '.3g')} mm/s"
        for name, group in COMPARED_CHANNELS.items()
    )
    summary = f"RMS difference from hindsight in x / y / z: {'; '.join(errors)}."
    return ReportFigure(
        "rates", f"Rate of the deflection{case.title_suffix}",
        f"Estimates of the rate of Delta_total and the reference in hindsight, last {SHOWN_SPAN_S:g} s. {summary}"
        " The raw difference of two ticks has all noise of the force sensors; it has a separate diagram.",
        f"Deflection rates in x, y and z over time. {summary}",
        figure,
    )  # fmt: skip


class LoadResult(NamedTuple):
    """Tip errors under one load with each strategy."""

    name: str
    rate: float  #: rate of a ramp whose rise and fall are equally fast [N/s]; inf for a step, NaN for other loads
    reached: Mapping[str, Sequence[float]]  #: largest true distance by strategy, after each change of the load [mm]
    best: Sequence[float | None]  #: best possible distance after each change of the load [mm]


def load_results(run: RecordedRun) -> list[LoadResult]:
    """Return the results of all loads of the run, in the order of its file."""
    cross, changes = run.table["cross"], variants(run.table)
    found: list[LoadResult] = []
    for name in cross["load"]:
        reached: dict[str, list[float]] = {}
        best: list[float | None] = []
        for strategy in cross["strategy"]:
            parts = run.summary.get("cases", {}).get(crossed_name(strategy, name), {}).get("by_change", {}).values()
            if parts:
                reached[strategy] = [part["true_max_distance_mm"] for part in parts]
                if strategy == NO_MOTION:  # stationary joints have an error only while the load acts
                    reached[strategy] = [max(reached[strategy])] * len(parts)
                best = best or [part.get("best_possible_mm") for part in parts]
        load = merged(run.table, changes[crossed_name(next(iter(cross["strategy"])), name)])["load"]
        found.append(LoadResult(name, _rate(load), reached, best))
    return found


def _rate(load: Mapping[str, Any]) -> float:
    if load["kind"] != "trapezoid" or load["rise"] != load.get("fall", 0.0):
        return math.nan
    return load["magnitude"] / load["rise"] if load["rise"] > 0.0 else math.inf


def load_rate(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield a figure: error over the load's rate when a load is applied and removed, and bars for other loads."""
    loads = [one for one in load_results(run) if one.reached] if "cross" in run.table else []
    if not loads:
        return
    ramps = sorted((one for one in loads if not math.isnan(one.rate)), key=lambda one: one.rate)
    others = [one for one in loads if math.isnan(one.rate)]
    styles = [
        (name, STRATEGY_STYLES.get(name, style.series(at, name)))
        for at, name in enumerate(run.table["cross"]["strategy"])
    ]
    figure = style.blank(3.6)
    grid = figure.subplots(1, 3 if others else 2, sharey=True)
    for side, axes in enumerate(grid[:2]):
        _curves(axes, ramps, styles, side)
        axes.set_title(f"load {SIDES[side]}")
    if others:
        _bars(grid[2], others, styles)
    grid[0].set_yscale("log")
    grid[0].set_ylabel("largest true error [mm]")
    style.legend(figure, list(grid[:1]), columns=4)
    numbers = "; ".join(_description(one) for one in (*ramps, *others))
    yield ReportFigure(
        "load_rate", "Largest error against the rate of the load",
        "Largest distance of the true tip from its desired position, from the moment at which the load starts to"
        " change. Best possible: joints within the speeds and accelerations of these stages, on the true tubes, with"
        " the whole course of the load known from that moment on."
        f" Smaller errors than {MIN_DRAWN_ERROR_MM:g} mm are drawn at {MIN_DRAWN_ERROR_MM:g} mm.",
        f"Largest true error in mm over the rate of the load in N/s. {numbers}.",
        figure,
    )  # fmt: skip


def _curves(axes: Axes, ramps: Sequence[LoadResult], styles: Sequence[tuple[str, style.LineStyle]], side: int) -> None:
    fastest = max((one.rate for one in ramps if math.isfinite(one.rate)), default=1.0)
    rates = [one.rate if math.isfinite(one.rate) else STEP_POSITION * fastest for one in ramps]
    for name, line in (*styles, ("", BEST_POSSIBLE_STYLE)):
        values = [_at(one.best if line is BEST_POSSIBLE_STYLE else one.reached.get(name, ()), side) for one in ramps]
        drawn = [
            (rate, max(value, MIN_DRAWN_ERROR_MM))
            for rate, value in zip(rates, values, strict=True)
            if value is not None
        ]
        if drawn:
            axes.plot(
                *zip(*drawn, strict=True), color=line.colour, linestyle=line.dash, linewidth=line.width, marker="o",
                markersize=3.0, label=line.label,
            )  # fmt: skip
    axes.set_xscale("log")
    decades = [10.0**power for power in range(-3, 4) if rates and min(rates) <= 10.0**power <= fastest]
    steps = [STEP_POSITION * fastest] if any(math.isinf(one.rate) for one in ramps) else []
    axes.set_xticks([*decades, *steps], [*(f"{each:g}" for each in decades), *["step"] * len(steps)])
    axes.minorticks_off()
    axes.set_xlabel("rate of the load [N/s]")


def _bars(axes: Axes, others: Sequence[LoadResult], styles: Sequence[tuple[str, style.LineStyle]]) -> None:
    shown = (*styles, ("", BEST_POSSIBLE_STYLE))
    width = 0.8 / len(shown)
    for number, (name, line) in enumerate(shown):
        for at, one in enumerate(others):
            values = [
                value
                for value in (one.best if line is BEST_POSSIBLE_STYLE else one.reached.get(name, ()))
                if value is not None
            ]
            if values:
                position = at + (number - 0.5 * (len(shown) - 1)) * width
                axes.bar(position, max(*values, MIN_DRAWN_ERROR_MM), 0.9 * width, color=line.colour)
    axes.set_xticks(range(len(others)), [one.name.replace("_", "\n") for one in others])
    axes.set_title("other loads")


def _at(values: Sequence[float | None], side: int) -> float | None:
    return values[side] if side < len(values) else None


def _description(one: LoadResult) -> str:
    parts = [f"{name} {style.slashed(values)}" for name, values in one.reached.items()]
    best = " / ".join("?" if value is None else f"{value:.2f}" for value in one.best)
    return f"{one.name.replace('_', ' ')}: {', '.join(parts)}, best possible {best} mm"
