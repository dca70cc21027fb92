"""Figures of a motion that presses: force against time with the contact, and the map of the palpated stiffness."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from numpy.typing import NDArray

from core.robot.robot import Array
from station.config.motions import PalpateMotion, PressMotion
from station.recording.press_outcome import (
    CONTACT,
    CONTACT_DEVIATIONS,
    counted_text,
    desired_force,
    estimated_stiffness,
    in_contact,
    obstacle_of,
    press_of,
    press_outcome,
    true_stiffness,
)
from station.report import style
from station.report.document import ReportFigure
from station.report.run import RecordedCase, RecordedRun

#: Shorter interruptions of the contact are not drawn [s].
SHORTEST_GAP_S = 0.1
CONTACT_LABEL = "contact, by the estimated force"
#: Largest number of points of the drawn desired force, which is a step function; `style.draw` thins longer lines.
DESIRED_POINTS = 2 * style.LINE_BINS
ESTIMATED = style.LineStyle("estimated", style.VERMILLION, "-", 1.2)
SIMULATED_TRUTH = style.TRUE._replace(label="true (simulated)", dash=(0.0, (4.0, 2.0)))


def presses(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield the force of each case whose motion presses, and the stiffness map of each palpation."""
    for case in run.cases:
        motion = press_of(case.settings)
        if motion is None:
            continue
        yield _press(case, motion)
        if isinstance(motion, PalpateMotion):
            yield _map(case, motion)


def _press(case: RecordedCase, motion: PressMotion) -> ReportFigure:
    """Return the figure with the force along the direction, and the position of the tip along it."""
    figure, axes = style.stacked(["force along the\ndirection [N]", "tip along the\ndirection [mm]"], height=1.8)
    time, along = case.time, motion.along
    contact = in_contact(case.of, motion)
    for number, (start, end) in enumerate(_spans(time, contact)):
        for each in axes:
            label = CONTACT_LABEL if number == 0 and each is axes[0] else None
            each.axvspan(start, end, color=style.GREY, alpha=0.15, linewidth=0.0, label=label)
    style.draw(axes[0], time, -case.of("force_filtered") @ along, ESTIMATED)
    origin = case.of("tip_desired")[0]
    at, measured = case.measured_tip()
    style.draw(axes[1], at, (measured - 1e3 * origin) @ along, style.MEASURED)
    if case.truth_known:
        style.draw(axes[0], time, -case.of("force_true") @ along, SIMULATED_TRUTH)
        style.draw(axes[1], time, 1e3 * (case.of("tip_true") - origin) @ along, SIMULATED_TRUTH, label=False)
    shown = time[:: max(1, len(time) // DESIRED_POINTS)]
    style.draw(axes[0], shown, desired_force(motion, shown), style.DESIRED)
    style.legend(figure, axes, columns=3)
    first = float(time[contact.argmax()]) if contact.any() else None
    found = "No contact was found." if first is None else f"First contact at {first:.2f} s."
    numbers = (case.numbers or press_outcome(case.of, motion, None, 0.0, case.counted_from)).get("press")
    errors = "" if numbers is None else f" Error of the force {counted_text(numbers)}: {_errors(numbers)}."
    return ReportFigure(
        f"press_{case.name}", f"Force on the obstacle{case.title_suffix}",
        f"Force of the tip on the obstacle along the direction of the press, and position of the tip along it from its"
        f" start. {found}{errors} Contact is an estimated force above {100.0 * CONTACT:g} % of the smallest desired"
        f" force and above {CONTACT_DEVIATIONS:g} standard deviations.",
        f"Desired and estimated force over time, and position of the tip over time. {found}{errors}",
        figure,
    )  # fmt: skip


def _spans(time: Array, contact: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return start and end of each period of contact [s]; interruptions below `SHORTEST_GAP_S` are ignored."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], contact, [False])).astype(int)))
    spans: list[tuple[float, float]] = []
    for start, end in zip(time[edges[::2]], time[edges[1::2] - 1], strict=True):
        if spans and start - spans[-1][1] < SHORTEST_GAP_S:
            start = spans.pop()[0]
        spans.append((float(start), float(end)))
    return spans


def _errors(numbers: Mapping[str, Any]) -> str:
    parts = [
        f"{name} mean {1e3 * numbers[f'{prefix}mean_error_N']:.1f} mN, RMS {1e3 * numbers[f'{prefix}rms_error_N']:.1f}"
        " mN"
        for name, prefix in (("estimated", ""), ("true", "true_"))
        if f"{prefix}mean_error_N" in numbers
    ]
    return "; ".join(parts)


def _map(case: RecordedCase, motion: PalpateMotion) -> ReportFigure:
    """Return the figure with the estimated stiffness of each place, and the true one of a simulated obstacle."""
    maps = {"estimated": estimated_stiffness(case.of, motion, 0.0)}
    obstacle = obstacle_of(case.settings)
    if obstacle is not None and case.truth_known:
        maps["simulated truth"] = true_stiffness(motion, obstacle)
    figure = style.blank(3.0)
    grid = figure.subplots(1, len(maps), squeeze=False)[0]
    known = np.concatenate([values[np.isfinite(values)] for values in maps.values()])
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    drawn = [_cells(*each, motion, low, high) for each in zip(grid, maps, maps.values(), strict=True)]
    figure.colorbar(drawn[0], ax=list(grid), label="stiffness [N/m]")
    missing = int(np.isnan(maps["estimated"]).sum())
    text = f"{maps['estimated'].size - missing} of {maps['estimated'].size} places have an estimate."
    found = case.numbers.get("palpation", {})
    if "rms_relative_error" in found:
        text += (
            " Error of the known estimates relative to the simulated truth:"
            f" RMS {100.0 * found['rms_relative_error']:.1f} %, largest {100.0 * found['max_relative_error']:.1f} %."
        )
    return ReportFigure(
        f"stiffness_{case.name}", f"Stiffness map{case.title_suffix}",
        f"Stiffness at each place: the difference between {motion.force:g} N and {motion.light:g} N, as estimated by"
        f" the controller, over the travel of the measured tip between the two. Crosses: no estimate. {text}",
        f"Map of the stiffness in N/m over the grid of places. {text}",
        figure,
    )  # fmt: skip


def _cells(axes: Axes, title: str, values: Array, motion: PalpateMotion, low: float, high: float) -> Any:
    """Draw a map (rows, columns) with its values as texts, and return its coloured cells."""
    step = 1e3 * motion.spacing
    across, up = ((np.arange(count) - 0.5 * (count - 1)) * step for count in (motion.columns, motion.rows))
    colours = colormaps["viridis"]
    cells = axes.pcolormesh(across, up, np.ma.masked_invalid(values), cmap=colours, vmin=low, vmax=high)
    for row, column in motion.grid:
        value = values[row, column]
        dark = np.isfinite(value) and value < 0.5 * (low + high)
        axes.text(
            across[column], up[row], f"{value:.0f}" if np.isfinite(value) else "x", ha="center", va="center",
            color="white" if dark else "black", fontsize=7.5,
        )  # fmt: skip
    axes.set_title(title)
    axes.grid(visible=False)
    axes.set_aspect("equal")
    axes.set_xlabel("along a row [mm]")
    axes.set_ylabel("across the rows [mm]")
    return cells
