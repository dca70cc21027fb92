"""Error against the rate of the load: each strategy, nobody at all, and the best that such stages could do."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from station.config.strict import merged
from station.experiments.experiment import crossed, variants
from station.report import style
from station.report.drawn import Drawn
from station.report.run import Run

#: Looks of the strategies by name; any other gets the next one of the series.
HELD = "held"
LOOKS = {
    "regulation": style.Look("dual layer, the live default", style.BLUE, "-", 1.4),
    "type_1": style.Look("dual layer, as in the paper", style.VERMILLION, (0.0, (6.0, 1.5, 1.0, 1.5)), 1.4),
    HELD: style.Look("no joint moves", style.BLACK, (0.0, (1.0, 1.2)), 1.6),
}
BEST = style.Look("best possible", style.GREEN, (0.0, (5.0, 2.0)), 1.6)
#: How far to the right of the fastest ramp a step stands on the axis of rates.
STEP = 3.0
#: Errors below this are drawn there [mm].
LEAST = 0.01
SIDES = ("put on", "taken off")


class Tried(NamedTuple):
    """One load, and what came of it under each strategy."""

    name: str
    rate: float  #: of a load that comes and goes at one rate [N/s]; inf for a step, NaN for any other load
    reached: Mapping[str, Sequence[float]]  #: largest true distance by strategy, after each change of the load [mm]
    best: Sequence[float | None]  #: best possible, likewise


def tried(run: Run) -> list[Tried]:
    """All loads of the run, in the order of its file."""
    cross, changes = run.table["cross"], variants(run.table)
    found: list[Tried] = []
    for name in cross["load"]:
        reached: dict[str, list[float]] = {}
        best: list[float | None] = []
        for strategy in cross["strategy"]:
            parts = run.summary.get("cases", {}).get(crossed(strategy, name), {}).get("by_change", {}).values()
            if parts:
                reached[strategy] = [part["true_max_distance_mm"] for part in parts]
                if strategy == HELD:  # joints that did nothing about the load are off while it hangs, not as it goes
                    reached[strategy] = [max(reached[strategy])] * len(parts)
                best = best or [part.get("best_possible_mm") for part in parts]
        load = merged(run.table, changes[crossed(next(iter(cross["strategy"])), name)])["load"]
        found.append(Tried(name, _rate(load), reached, best))
    return found


def _rate(load: Mapping[str, Any]) -> float:
    if load["kind"] != "trapezoid" or load["rise"] != load.get("fall", 0.0):
        return math.nan
    return load["magnitude"] / load["rise"] if load["rise"] > 0.0 else math.inf


def draw(run: Run) -> Iterator[Drawn]:
    """Curves over the rate, where a load is put on and where it is taken off; bars for loads of another kind."""
    loads = [one for one in tried(run) if one.reached] if "cross" in run.table else []
    if not loads:
        return
    ramps = sorted((one for one in loads if not math.isnan(one.rate)), key=lambda one: one.rate)
    others = [one for one in loads if math.isnan(one.rate)]
    looks = [(name, LOOKS.get(name, style.series(at, name))) for at, name in enumerate(run.table["cross"]["strategy"])]
    figure = Figure(figsize=(style.WIDTH, 3.6))
    grid = figure.subplots(1, 3 if others else 2, sharey=True)
    for side, axes in enumerate(grid[:2]):
        _curves(axes, ramps, looks, side)
        axes.set_title(f"load {SIDES[side]}")
    if others:
        _bars(grid[2], others, looks)
    grid[0].set_yscale("log")
    grid[0].set_ylabel("largest true error [mm]")
    style.legend(figure, list(grid[:1]), columns=4)
    words = "; ".join(_in_words(one) for one in (*ramps, *others))
    yield Drawn(
        "load_rate", "Largest error against the rate of the load",
        "Largest distance between the true tip and where it should stay, from the moment at which the load begins to be"
        f" put on or taken off. Best possible: joints at the speeds and accelerations of these stages that know the"
        " whole course of the load from that moment on, on the true tubes."
        f" Below {LEAST:g} mm points stand at {LEAST:g} mm.",
        f"Largest true error in mm over the rate of the load in N/s. {words}.",
        figure,
    )  # fmt: skip


def _curves(axes: Axes, ramps: Sequence[Tried], looks: Sequence[tuple[str, style.Look]], side: int) -> None:
    fastest = max((one.rate for one in ramps if math.isfinite(one.rate)), default=1.0)
    places = [one.rate if math.isfinite(one.rate) else STEP * fastest for one in ramps]
    for name, look in (*looks, ("", BEST)):
        values = [_at(one.best if look is BEST else one.reached.get(name, ()), side) for one in ramps]
        drawn = [(place, max(value, LEAST)) for place, value in zip(places, values, strict=True) if value is not None]
        if drawn:
            axes.plot(
                *zip(*drawn, strict=True), color=look.colour, linestyle=look.dash, linewidth=look.width, marker="o",
                markersize=3.0, label=look.label,
            )  # fmt: skip
    axes.set_xscale("log")
    decades = [10.0**power for power in range(-3, 4) if places and min(places) <= 10.0**power <= fastest]
    steps = [STEP * fastest] if any(math.isinf(one.rate) for one in ramps) else []
    axes.set_xticks([*decades, *steps], [*(f"{each:g}" for each in decades), *["step"] * len(steps)])
    axes.minorticks_off()
    axes.set_xlabel("rate of the load [N/s]")


def _bars(axes: Axes, others: Sequence[Tried], looks: Sequence[tuple[str, style.Look]]) -> None:
    shown = (*looks, ("", BEST))
    width = 0.8 / len(shown)
    for number, (name, look) in enumerate(shown):
        for at, one in enumerate(others):
            values = [value for value in (one.best if look is BEST else one.reached.get(name, ())) if value is not None]
            if values:
                place = at + (number - 0.5 * (len(shown) - 1)) * width
                axes.bar(place, max(*values, LEAST), 0.9 * width, color=look.colour)
    axes.set_xticks(range(len(others)), [one.name.replace("_", "\n") for one in others])
    axes.set_title("other loads")


def _at(values: Sequence[float | None], side: int) -> float | None:
    return values[side] if side < len(values) else None


def _in_words(one: Tried) -> str:
    parts = [f"{name} {' / '.join(f'{value:.2f}' for value in values)}" for name, values in one.reached.items()]
    best = " / ".join("?" if value is None else f"{value:.2f}" for value in one.best)
    return f"{one.name.replace('_', ' ')}: {', '.join(parts)}, best possible {best} mm"
