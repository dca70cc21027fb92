"""Figure of the control loop's timing, for runs in real time: lateness and computing time of the ticks."""

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from core.robot.robot import Array
from station.report import style
from station.report.figure import ReportFigure
from station.report.run import RecordedRun

TIMING_PARTS = (
    ("late_counts", "late_us", "from the deadline to the start of the tick [µs]", style.BLUE),
    ("tick_counts", "tick_us", "work of a tick [µs]", style.VERMILLION),
)


def draw(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield a figure with two histograms for each case that has timing.

    The recorded bins are a microsecond wide; the last bin also counts all longer times.
    """
    for name, numbers in run.summary.get("cases", {}).items():
        timing = numbers.get("timing")
        if not timing or "late_counts" not in timing:
            continue
        figure = Figure(figsize=(style.WIDTH_INCH, 2.6))
        for axes, (counts, _, label, colour) in zip(figure.subplots(1, 2), TIMING_PARTS, strict=True):
            axes.stairs(
                *even_on_a_log_axis(np.asarray(timing[counts], dtype=float)), fill=True, color=colour, alpha=0.85
            )
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_ylim(bottom=0.7)
            axes.set_xlabel(label)
            axes.set_ylabel("ticks")
        quantiles = "; ".join(
            f"{what}: median {timing[key]['p50']:.0f}, 99 % {timing[key]['p99']:.0f},"
            f" largest {timing[key]['max']:.0f} µs"
            for key, what in (("late_us", "late"), ("tick_us", "work"))
        )
        caption = (
            f"{timing['ticks']} ticks, {timing['missed']} periods missed, scheduling {timing['scheduler']};"
            f" {quantiles}."
        )
        case = run.case(name)
        yield ReportFigure(
            f"timing_{name}", f"Timing of the loop{case.title_suffix if case else ''}",
            f"{caption} The bins are equally wide on their axis; the last one includes all larger values.",
            f"Histograms of lateness and work. {caption}", figure,
        )  # fmt: skip


def even_on_a_log_axis(counts: Array, bins: int = 80) -> tuple[Array, Array]:
    """Convert a histogram with bins of a microsecond to bins that have equal widths on a logarithmic axis.

    Args:
        counts: counts of 0 ... 1 us, 1 ... 2 us, ... (n,).
        bins: approximate number of bins on the logarithmic axis.

    Returns:
        Counts (m,), and edges (m + 1,) [us]. The first bin starts at 0 us; its edge is 0.5 us for the logarithmic axis.
    """
    steps = np.round(np.geomspace(1, len(counts), bins)).astype(int)
    starts = np.unique(np.concatenate(([0], steps[steps < len(counts)])))
    edges = np.append(starts, len(counts)).astype(float)
    edges[0] = 0.5
    return np.add.reduceat(counts, starts), edges
