"""Report of a sweep.

Its figures have a point for every run. Each setting has a line from the 5th to the 95th percentile and a bar at the
median.
"""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from station.experiments.sweep_output import COMPONENT_LABELS, SWEEP_FILE, quantity, setting_label
from station.report import document, style
from station.report.figure import ReportFigure
from station.report.run import read_json

MARKERS = ("o", "s", "^")


def draw(sweep: Mapping[str, Any]) -> Iterator[ReportFigure]:
    """Yield a figure of the errors of all seeds and settings for each case of a sweep."""
    settings = sweep["settings"]
    name, label, unit, parts = quantity(settings)
    for case in dict.fromkeys(group["case"] for group in settings) if parts else ():
        mine = [group for group in settings if group["case"] == case]
        figure = Figure(figsize=(style.WIDTH_INCH, 3.2))
        axes = figure.subplots()
        for number, group in enumerate(mine):
            runs = [run for run in sweep["runs"] if run["case"] == case and run["setting"] == group["setting"]]
            for column, part in enumerate(parts):
                _strip(axes, number + 0.22 * (column - 0.5 * (len(parts) - 1)), column, _values(runs, name, part))
        for column, part in enumerate(parts):
            line = style.SERIES[2 * column % len(style.SERIES)]
            axes.plot([], [], MARKERS[column % 3], color=line.colour, label=COMPONENT_LABELS[part])
        axes.set_xticks(range(len(mine)), [setting_label(group["setting"]).replace(", ", "\n") for group in mine])
        axes.set_xlim(-0.6, len(mine) - 0.4)
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel(f"{label} [{unit}]")
        axes.grid(visible=False, axis="x")
        style.legend(figure, [axes])
        medians = "; ".join(
            f"{setting_label(group['setting'])}: "
            + " / ".join(f"{group['spreads'][f'{name}.{part}']['median']:.3f}" for part in parts)
            for group in mine
            if f"{name}.{parts[0]}" in group["spreads"]
        )
        yield ReportFigure(
            f"spread_{case}", f"{label[0].upper() + label[1:]} over {len(sweep['seeds'])} seeds (case '{case}')",
            f"Point: a run. Line: 5 to 95 %. Bar: median. Medians of"
            f" {' / '.join(COMPONENT_LABELS[part] for part in parts)} [{unit}]: {medians}.",
            f"{label} of every run by setting. Medians: {medians}.",
            figure,
        )  # fmt: skip


def sweep_parts(folder: Path) -> tuple[Mapping[str, Any], list[str]]:
    """Return the JSON of a sweep and the parts of its page before the figures.

    Raises:
        NoRun: the file does not exist, or is not JSON.
    """
    sweep = read_json(folder / SWEEP_FILE)
    parts = [f"<h1>{escape(sweep['title'] or sweep['experiment'])}</h1>"]
    parts.append(document.paragraph(f"{folder.name}: sweep of {len(sweep['runs'])} runs", "sub"))
    simulated = f"Simulated bench. {'; '.join(sweep['labs'])}; seeds {_range(sweep['seeds'])}."
    parts.append(document.paragraph(simulated, "note"))
    if not sweep["completed"]:
        parts.append(document.paragraph(f"Not complete: {sweep['planned']} runs were planned.", "note"))
    name, label, unit, shown = quantity(sweep["settings"])
    if shown:
        parts += [document.heading(f"{label[0].upper() + label[1:]} [{unit}]"), _table(sweep["settings"], name, shown)]
    parts.append(document.heading("Figures"))
    return sweep, parts


def _table(settings: Sequence[Mapping[str, Any]], name: str, shown: Sequence[str]) -> str:
    rows = (
        (
            setting_label(group["setting"]), group["case"], f"{group['completed']} of {group['runs']}",
            COMPONENT_LABELS[part],
            *(f"{group['spreads'][f'{name}.{part}'][key]:.3f}" for key in ("median", "worst", "p5", "p95")),
        )
        for group in settings
        for part in shown
        if f"{name}.{part}" in group["spreads"]
    )  # fmt: skip
    head = ("setting", "case", "completed", "", "median", "worst", "5 %", "95 %")
    return document.table(head, rows, texts=4)


def _strip(axes: Any, position: float, column: int, values: Sequence[float]) -> None:
    if not values:
        return
    line = style.SERIES[2 * column % len(style.SERIES)]
    # The points have fixed horizontal offsets, so that the same sweep gives the same figure.
    offsets = 0.05 * (np.arange(len(values)) % 5 - 2) / 2.0
    axes.plot(
        position + offsets, values, MARKERS[column % 3], color=line.colour, markersize=4.0, alpha=0.7, linewidth=0
    )
    p5, median, p95 = np.percentile(values, (5.0, 50.0, 95.0))
    axes.plot([position, position], [p5, p95], color=style.BLACK, linewidth=1.0)
    axes.plot([position - 0.08, position + 0.08], [median, median], color=style.BLACK, linewidth=2.0)


def _values(runs: Sequence[Mapping[str, Any]], name: str, part: str) -> list[float]:
    values = (run[name] for run in runs if run["completed"] and name in run)
    return [value[part] if isinstance(value, Mapping) else value["xyz".index(part)] for value in values]


def _range(seeds: Sequence[int]) -> str:
    whole = len(seeds) > 2 and list(seeds) == list(range(seeds[0], seeds[-1] + 1))
    return f"{seeds[0]} ... {seeds[-1]}" if whole else ", ".join(map(str, seeds))
