"""How every figure looks: colours that colour-blind eyes tell apart (Okabe and Ito), dashes that a grey printer keeps.

A thing keeps its colour and its dash in every figure, and as far as there is one the colour of the panel.
"""

from collections.abc import Sequence
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

#: What matplotlib is told while figures are drawn and written.
SETTINGS: dict[Any, Any] = {
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
    "pdf.fonttype": 42,  # text stays text
    "svg.hashsalt": "ctr-station",  # the same data give the same file
}
WIDTH = 7.0  #: of every figure: the text width of A4 [inch]
AXES = ("x", "y", "z")
#: Height of the line that says where the data come from [inch].
STAMP = 0.14
#: Pieces of a long line of which lowest and highest values are kept.
PIECES = 700


class Look(NamedTuple):
    """How one thing is drawn wherever it appears."""

    label: str
    colour: str
    dash: str | tuple[float, tuple[float, ...]] = "-"
    width: float = 1.1
    alpha: float = 1.0


DESIRED = Look("desired", GREEN, (0.0, (5.0, 2.0)), 1.3)
MEASURED = Look("measured (tracker)", ORANGE, "-", 1.0)
TRUE = Look("true (simulated plant)", BLACK, "-", 1.2)
LOADED = Look("loaded model", BLUE, (0.0, (6.0, 1.5)), 1.3)
UNLOADED = Look("unloaded model", VERMILLION, (0.0, (6.0, 1.5, 1.0, 1.5)), 1.3)
SAMPLES = Look("single samples", SKY, "-", 0.4, 0.8)
FILTERED = Look("filtered", PURPLE, "-", 1.2)
BOUND = Look("largest in the paper (real bench)", GREY, (0.0, (1.0, 1.5)), 1.2)
#: For things without a look of their own, in their order.
SERIES = (
    Look("", VERMILLION, (0.0, (6.0, 1.5, 1.0, 1.5)), 1.2),
    Look("", SKY, (0.0, (2.0, 1.2)), 1.6),
    Look("", BLUE, "-", 1.2),
    Look("", BLACK, (0.0, (6.0, 2.0)), 1.2),
    Look("", PURPLE, (0.0, (1.0, 1.2)), 1.6),
    Look("", ORANGE, (0.0, (4.0, 1.0, 1.0, 1.0, 1.0, 1.0)), 1.2),
)


def series(number: int, label: str) -> Look:
    """Of the thing with that number; after the last the looks begin again."""
    return SERIES[number % len(SERIES)]._replace(label=label)


def stacked(labels: Sequence[str], *, height: float = 1.35, across: str = "time [s]") -> tuple[Figure, list[Axes]]:
    """A figure of diagrams below each other over one time; `labels` are those of the value axes, with units."""
    figure = Figure(figsize=(WIDTH, 0.7 + height * len(labels)))
    grid = figure.subplots(len(labels), 1, sharex=True, squeeze=False)
    axes = [row[0] for row in grid]
    for each, label in zip(axes, labels, strict=True):
        each.set_ylabel(label)
    axes[-1].set_xlabel(across)
    figure.align_ylabels(axes)
    return figure, axes


def finish(figure: Figure, text: str) -> None:
    """Say on the figure itself, on a line of its own at the bottom, where its data come from, and lay it out for good.

    All formats show the same layout, and the same data give the same file: the solver's last digits are cut off.
    """
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        height = STAMP / figure.get_figheight()
        engine.set(rect=(0.0, height, 1.0, 1.0 - height))
    figure.text(0.998, 0.004, text, ha="right", va="bottom", fontsize=6.5, color=GREY)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:
        left, bottom, width, height = np.round(axes.get_position().bounds, 5).tolist()
        axes.set_position((left, bottom, width, height))


def draw(axes: Axes, times: Array, values: Array, look: Look, *, label: bool = True) -> None:
    """One line over time, no more points of it than the eye can tell apart; `label`: name it in the legend."""
    shown, heights = thinned(times, values)
    axes.plot(
        shown, heights, color=look.colour, linestyle=look.dash, linewidth=look.width, alpha=look.alpha,
        label=look.label if label else None,
    )  # fmt: skip


def averaged(times: Array, values: Array, span: float) -> tuple[Array, Array]:
    """Means over pieces of `span` [s] of a line that noise would hide: (p,) and (p,)."""
    each = max(1, round(span / float(np.median(np.diff(times))))) if len(times) > 1 else 1
    whole = len(values) // each * each
    return times[:whole].reshape(-1, each).mean(axis=1), values[:whole].reshape(-1, each).mean(axis=1)


def bound(axes: Axes, value: float, *, label: bool = True) -> None:
    """A limit on either side of zero."""
    for number, height in enumerate((value, -value)):
        axes.axhline(
            height, color=BOUND.colour, linestyle=BOUND.dash, linewidth=BOUND.width,
            label=BOUND.label if label and number == 0 else None,
        )  # fmt: skip


def legend(figure: Figure, axes: Sequence[Axes], columns: int = 4) -> None:
    """One legend above all diagrams, each name once."""
    named = {}
    for each in axes:
        for handle, label in zip(*each.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    figure.legend(named.values(), named.keys(), loc="outside upper center", ncols=columns, handlelength=3.2)


def thinned(times: Array, values: Array, pieces: int = PIECES) -> tuple[Array, Array]:
    """Lowest and highest of each piece of a long line, in their order: peaks stay, points go.

    Args:
        times: (m,).
        values: (m,).
        pieces: how many of them; a line of less than four points a piece stays whole.
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
