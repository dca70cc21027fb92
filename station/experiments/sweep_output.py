"""Results of a sweep: files on the disk, table on the screen."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from station.recording.run_folder import EXPERIMENT_FILE, SUMMARY_FILE, write_json
from station.recording.run_outcome import RecordingError, RunOutcome

#: Name of the file with all results of a sweep; its folder also has a `summary.json`, as the folder of a run.
SWEEP_FILE = "sweep.json"
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
    table = Table(title=Text(f"{summary['title']}\n{title} [{unit}] over the seeds"), title_style="")
    for heading in ("setting", "case", "completed", ""):
        table.add_column(heading)
    for heading in ("median", "worst", "5 %", "95 %"):
        table.add_column(heading, justify="right")
    for group in summary["settings"]:
        label = (setting_label(group["setting"]), group["case"], f"{group['completed']} of {group['runs']}")
        for part in parts:
            if spread := group["spreads"].get(f"{name}.{part}"):
                numbers = (f"{spread[key]:.3f}" for key in ("median", "worst", "p5", "p95"))
                table.add_row(*label, COMPONENT_LABELS[part], *numbers)
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
