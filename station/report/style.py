"""Style of all figures: colours for colour-blind readers (Okabe and Ito), and dashes for grey prints.

A quantity has the same colour and dash in every figure. If the operator's page also shows
the quantity, both use the same colour.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from core.robot.robot import Array
from station.config import palette

BLACK, GREY = palette.css(palette.BLACK), palette.css(palette.SLATE)
ORANGE, VERMILLION = palette.css(palette.ORANGE), palette.css(palette.VERMILLION)
SKY, BLUE = palette.css(palette.SKY), palette.css(palette.BLUE)
GREEN, PURPLE = palette.css(palette.GREEN), palette.css(palette.PURPLE)

#: Settings of matplotlib while figures are drawn and written.
MATPLOTLIB_SETTINGS: dict[Any, Any] = {
    "font.size": 8.5,
    "axes.titlesize": 9.0,
    "axes.labelsize": 8.5,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.xmargin": 0.01,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#d8dce0",
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.constrained_layout.use": True,
    "pdf.fonttype": 42,  # text in a PDF stays text and can be searched
    "svg.hashsalt": "ctr-station",  # fixed element ids: the same data give the same file
}
WIDTH_INCH = 7.0  #: width of every figure: the text width of A4 [inch]
AXES = ("x", "y", "z")
#: Height of the text line at the bottom of a figure that states the origin of the data [inch].
STAMP_HEIGHT_INCH = 0.14
#: Number of pieces into which a long line is divided; only the lowest and highest value of each piece are drawn.
LINE_BINS = 700


class LineStyle(NamedTuple):
    """Line style of one quantity in all figures: label, colour, dash and width."""

    label: str
    colour: str
    dash: str | tuple[float, tuple[float, ...]] = "-"
    width: float = 1.1
    alpha: float = 1.0


DESIRED = LineStyle("desired", GREEN, (0.0, (5.0, 2.0)), 1.3)
MEASURED = LineStyle("measured (tracker)", ORANGE, "-", 1.0)
TRUE = LineStyle("true (simulated plant)", BLACK, "-", 1.2)
LOADED = LineStyle("loaded model", BLUE, (0.0, (6.0, 1.5)), 1.3)
UNLOADED = LineStyle("unloaded model", VERMILLION, (0.0, (6.0, 1.5, 1.0, 1.5)), 1.3)
SAMPLES = LineStyle("single samples", SKY, "-", 0.4, 0.8)
FILTERED = LineStyle("filtered", PURPLE, "-", 1.2)
BOUND = LineStyle("largest in the paper (real bench)", GREY, (0.0, (1.0, 1.5)), 1.2)
#: Line styles for quantities without a fixed style, in the order in which they are used.
SERIES = (
    LineStyle("", VERMILLION, (0.0, (6.0, 1.5, 1.0, 1.5)), 1.2),
    LineStyle("", SKY, (0.0, (2.0, 1.2)), 1.6),
    LineStyle("", BLUE, "-", 1.2),
    LineStyle("", BLACK, (0.0, (6.0, 2.0)), 1.2),
    LineStyle("", PURPLE, (0.0, (1.0, 1.2)), 1.6),
    LineStyle("", ORANGE, (0.0, (4.0, 1.0, 1.0, 1.0, 1.0, 1.0)), 1.2),
)


def series(number: int, label: str) -> LineStyle:
    """Return style number `number` of `SERIES` with a label; after the last style the first one follows again."""
    return SERIES[number % len(SERIES)]._replace(label=label)


def blank(height: float) -> Figure:
    """Return an empty figure with the width of all figures and this height [inch]."""
    return Figure(figsize=(WIDTH_INCH, height))


def stacked(labels: Sequence[str], *, height: float = 1.35, across: str = "time [s]") -> tuple[Figure, list[Axes]]:
    """Return a figure with diagrams on top of each other over one time axis, one for each label of a value axis."""
    figure = blank(0.7 + height * len(labels))
    grid = figure.subplots(len(labels), 1, sharex=True, squeeze=False)
    axes = [row[0] for row in grid]
    for each, label in zip(axes, labels, strict=True):
        each.set_ylabel(label)
    axes[-1].set_xlabel(across)
    figure.align_ylabels(axes)
    return figure, axes


def pictures(count: int, shape: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels for pictures next to each other, whose height is `shape` times their width."""
    figure = blank(0.45 + WIDTH_INCH / count * shape)
    panels = figure.subplots(1, count, squeeze=False)[0].tolist()
    for panel in panels:
        panel.set_xticks([])
        panel.set_yticks([])
    return figure, panels


def finish(figure: Figure, text: str = "") -> None:
    """Add a line with the origin of the data, if there is a text, at the bottom of a figure, and fix its layout.

    SVG, PNG and PDF files get the same layout. Positions are rounded, so that the same data give the same file.
    """
    engine = figure.get_layout_engine()
    if text and isinstance(engine, ConstrainedLayoutEngine):
        height = STAMP_HEIGHT_INCH / figure.get_figheight()
        engine.set(rect=(0.0, height, 1.0, 1.0 - height))
    figure.text(0.998, 0.004, text, ha="right", va="bottom", fontsize=6.5, color=GREY)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:
        left, bottom, width, height = np.round(axes.get_position().bounds, 5).tolist()
        axes.set_position((left, bottom, width, height))


def draw(axes: Axes, times: Array, values: Array, line: LineStyle, *, label: bool = True) -> None:
    """Draw a line over time, reduced to the points that are visible; `label`: whether it is in the legend."""
    shown, heights = thinned(times, values)
    axes.plot(
        shown, heights, color=line.colour, linestyle=line.dash, linewidth=line.width, alpha=line.alpha,
        label=line.label if label else None,
    )  # fmt: skip


def draw_components(axes: Sequence[Axes], times: Array, values: Array, line: LineStyle) -> None:
    """Draw each component of `values` (m, k) over `times` (m,) on a separate diagram, the first k of `axes`."""
    for each, component in zip(axes, values.T, strict=False):
        draw(each, times, component, line)


def slashed(values: Iterable[float], form: str = ".2f") -> str:
    """Return numbers of several axes as a text, such as `0.10 / 0.20 / 0.30`."""
    return " / ".join(format(value, form) for value in values)


def averaged(times: Array, values: Array, span: float) -> tuple[Array, Array]:
    """Return a noisy line averaged over intervals of `span` [s]: times (p,) and values (p,)."""
    each = max(1, round(span / float(np.median(np.diff(times))))) if len(times) > 1 else 1
    whole = len(values) // each * each
    return times[:whole].reshape(-1, each).mean(axis=1), values[:whole].reshape(-1, each).mean(axis=1)


def bound(axes: Axes, value: float, *, label: bool = True) -> None:
    """Draw a bound as two horizontal lines, at `value` and at its negative."""
    for number, height in enumerate((value, -value)):
        axes.axhline(
            height, color=BOUND.colour, linestyle=BOUND.dash, linewidth=BOUND.width,
            label=BOUND.label if label and number == 0 else None,
        )  # fmt: skip


def legend(figure: Figure, axes: Sequence[Axes], columns: int = 4) -> None:
    """Add one legend above all diagrams of a figure, in which each label appears once."""
    named = {}
    for each in axes:
        for handle, label in zip(*each.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    figure.legend(named.values(), named.keys(), loc="outside upper center", ncols=columns, handlelength=3.2)


def thinned(times: Array, values: Array, pieces: int = LINE_BINS) -> tuple[Array, Array]:
    """Return the lowest and highest point of each piece of a long line, in their order, so that peaks remain.

    Args:
        times: (m,).
        values: (m,).
        pieces: number of pieces; a line with less than four points a piece is returned unchanged.
    """
    each = len(values) // pieces
    if each < 4:
        return times, values
    whole = len(values) // each * each
    blocks = values[:whole].reshape(-1, each)
    first = np.arange(len(blocks)) * each
    ends = np.stack((first + blocks.argmin(axis=1), first + blocks.argmax(axis=1)), axis=1)
    kept = np.unique(np.concatenate(([0], np.sort(ends, axis=1).ravel(), np.arange(whole, len(values)))))
    kept = np.append(kept, len(values) - 1) if kept[-1] != len(values) - 1 else kept
    return times[kept], values[kept]
