"""Results of a sweep: files on the disk, table on the screen, page with figures.

The figures have a point for every run. Each setting has a line from the 5th to the 95th percentile and a bar at the
median.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from station.recording.history import SWEEP_FILE
from station.recording.run_folder import EXPERIMENT_FILE, SUMMARY_FILE, write_json
from station.recording.run_outcome import RecordingError, RunOutcome
from station.report import document, style
from station.report.document import ReportFigure
from station.report.run import read_json

#: Quantities that the table of a sweep may show, with label and unit. The table shows the first quantity in this list
#: for which the runs have values.
TABLE_QUANTITIES = (
    ("true_max_abs_error_mm", "largest true |E|", "mm"),
    ("max_abs_error_mm", "largest measured |E|", "mm"),
    ("model_error_mm", "mean distance of the model", "mm"),
)
#: Largest number of failed or stopped runs that are listed one by one.
MAX_LISTED_FAILURES = 10
COMPONENT_LABELS = {"x": "x", "y": "y", "z": "z", "loaded": "loaded model", "unloaded": "unloaded model"}
TABLE_HEAD = ("setting", "case", "completed", "", "median", "worst", "5 %", "95 %")
MARKERS = ("o", "s", "^")


def quantity(settings: Sequence[Mapping[str, Any]]) -> tuple[str, str, str, list[str]]:
    """Return the quantity that a table shows: name, label, unit, and its components (axes or models).

    All four are empty if the runs have none of `TABLE_QUANTITIES`.
    """
    for name, label, unit in TABLE_QUANTITIES:
        parts = [part for part in COMPONENT_LABELS if any(f"{name}.{part}" in group["spreads"] for group in settings)]
        if parts:
            return name, label, unit, parts
    return "", "", "", []


def setting_label(setting: Mapping[str, Any]) -> str:
    """Return the label of a setting, such as `k1 = 2.5, lab = default`; keys are shown without their tables' names."""
    return ", ".join(f"{key.rsplit('.', 1)[-1]} = {value}" for key, value in setting.items()) or "as it is"


def sweep_table(summary: Mapping[str, Any]) -> Table:
    """Return a table of a sweep for the terminal, with one line for each setting, case and axis."""
    name, title, unit, parts = quantity(summary["settings"])
    table = document.terminal_table(TABLE_HEAD, (), 4, Text(f"{summary['title']}\n{title} [{unit}] over the seeds"))
    for group in summary["settings"]:
        label = _label(group)
        for row in _rows([group], name, parts):
            table.add_row(*label, *row[3:])
            label = ("", "", "")
        if label[0]:
            table.add_row(*label)
        table.add_section()
    if reasons := failure_lines(summary["runs"]):
        table.caption = Text("\n".join(reasons), justify="left")
        table.caption_style = ""
    return table


def failure_lines(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a line with the reason for each run that did not complete; after the first ones only their number."""
    found = [run for run in runs if not run["completed"]]
    lines = [f"{setting_label(run['setting'])}, {run['case']}, seed {run['seed']}: {run['cause']}" for run in found]
    more = len(lines) - MAX_LISTED_FAILURES
    return [*lines[:MAX_LISTED_FAILURES], f"and {more} more"] if more > 0 else lines


def write_sweep(folder: Path, summary: Mapping[str, Any], source: str, started: float) -> None:
    """Write the results of a sweep into the folder of its manifests.

    Args:
        folder: folder of the sweep.
        summary: results of the whole sweep, without the path of its folder.
        source: text of the experiment's file.
        started: start of the sweep [s since 1970].

    Raises:
        RecordingError: the results cannot be written.
    """
    short = {key: value for key, value in summary.items() if key not in ("settings", "runs")}
    label = RunOutcome.COMPLETE if summary["completed"] else RunOutcome.STOPPED
    try:
        (folder / EXPERIMENT_FILE).write_text(source, encoding="utf-8")
        write_json(folder / SWEEP_FILE, summary)
        write_json(folder / SUMMARY_FILE, {**short, "started": started, "label": label, "recording": str(folder)})
    except OSError as error:
        raise RecordingError(f"{folder}: cannot write results: {error.strerror}") from None


def draw(sweep: Mapping[str, Any]) -> Iterator[ReportFigure]:
    """Yield a figure of the errors of all seeds and settings for each case of a sweep."""
    settings = sweep["settings"]
    name, label, unit, parts = quantity(settings)
    for case in dict.fromkeys(group["case"] for group in settings) if parts else ():
        mine = [group for group in settings if group["case"] == case]
        figure = style.blank(3.2)
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
    simulated = f"Simulated bench. {'; '.join(sweep['labs'])}; seeds {_range(sweep['seeds'])}."
    sub = f"{folder.name}: sweep of {len(sweep['runs'])} runs"
    parts = [*document.page_head(sweep["title"] or sweep["experiment"], sub, simulated)]
    if not sweep["completed"]:
        parts.append(document.paragraph(f"Not complete: {sweep['planned']} runs were planned.", "note"))
    name, label, unit, shown = quantity(sweep["settings"])
    if shown:
        rows = list(_rows(sweep["settings"], name, shown))
        parts += [document.heading(f"{label[0].upper() + label[1:]} [{unit}]"), document.table(TABLE_HEAD, rows, 4)]
    parts.append(document.heading("Figures"))
    return sweep, parts


def _label(group: Mapping[str, Any]) -> tuple[str, str, str]:
    return setting_label(group["setting"]), group["case"], f"{group['completed']} of {group['runs']}"


def _rows(settings: Sequence[Mapping[str, Any]], name: str, shown: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield a table row for each setting and component of the quantity `name` that has values."""
    for group in settings:
        for part in shown:
            if spread := group["spreads"].get(f"{name}.{part}"):
                numbers = (f"{spread[key]:.3f}" for key in ("median", "worst", "p5", "p95"))
                yield *_label(group), COMPONENT_LABELS[part], *numbers


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
