"""Figure of the tip error over the rate of the load: strategies, stationary joints and best possible joint path."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from station.config.strict import merged
from station.experiments.experiment import crossed_name, variants
from station.report import style
from station.report.figure import ReportFigure
from station.report.run import RecordedRun

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
SIDES = ("applied", "removed")


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
                if strategy == NO_MOTION:  # stationary joints have an error while the load acts, not after it
                    reached[strategy] = [max(reached[strategy])] * len(parts)
                best = best or [part.get("best_possible_mm") for part in parts]
        load = merged(run.table, changes[crossed_name(next(iter(cross["strategy"])), name)])["load"]
        found.append(LoadResult(name, _rate(load), reached, best))
    return found


def _rate(load: Mapping[str, Any]) -> float:
    if load["kind"] != "trapezoid" or load["rise"] != load.get("fall", 0.0):
        return math.nan
    return load["magnitude"] / load["rise"] if load["rise"] > 0.0 else math.inf


def draw(run: RecordedRun) -> Iterator[ReportFigure]:
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
    figure = Figure(figsize=(style.WIDTH_INCH, 3.6))
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
        "Largest distance of the true tip from its desired position, from the moment on at which the load starts to"
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
    parts = [f"{name} {' / '.join(f'{value:.2f}' for value in values)}" for name, values in one.reached.items()]
    best = " / ".join("?" if value is None else f"{value:.2f}" for value in one.best)
    return f"{one.name.replace('_', ' ')}: {', '.join(parts)}, best possible {best} mm"
