"""A sweep on disk and on the screen."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from station.recording.label import Label, RecordingError
from station.recording.run_folder import EXPERIMENT, SUMMARY, write_json

#: The sweep's file, beside the `summary.json` that every run has.
SWEEP = "sweep.json"
#: What is shown of a sweep: the first of these that its runs have, in words, with its unit.
SHOWN = (
    ("true_max_abs_error_mm", "largest true |E|", "mm"),
    ("max_abs_error_mm", "largest measured |E|", "mm"),
    ("model_error_mm", "mean distance of the model", "mm"),
)
#: So many runs that did not complete are told one by one.
MOST = 10
PARTS = {"x": "x", "y": "y", "z": "z", "loaded": "loaded model", "unloaded": "unloaded model"}


def quantity(settings: Sequence[Mapping[str, Any]]) -> tuple[str, str, str, list[str]]:
    """What is shown of a sweep: name, words, unit, and its parts (axes or models); no parts when there is nothing."""
    for name, words, unit in SHOWN:
        parts = [part for part in PARTS if any(f"{name}.{part}" in group["spreads"] for group in settings)]
        if parts:
            return name, words, unit, parts
    return "", "", "", []


def setting_words(setting: Mapping[str, Any]) -> str:
    """`k1 = 2.5, lab = default`: keys without the tables that they are in."""
    return ", ".join(f"{key.rsplit('.', 1)[-1]} = {value}" for key, value in setting.items()) or "as it is"


def sweep_table(summary: Mapping[str, Any]) -> Table:
    """One line for each setting, case and axis."""
    name, words, unit, parts = quantity(summary["settings"])
    table = Table(title=Text(f"{summary['title']}\n{words} [{unit}] over the seeds"), title_style="")
    for title in ("setting", "case", "completed", ""):
        table.add_column(title)
    for title in ("median", "worst", "5 %", "95 %"):
        table.add_column(title, justify="right")
    for group in summary["settings"]:
        label = (setting_words(group["setting"]), group["case"], f"{group['completed']} of {group['runs']}")
        for part in parts:
            if spread := group["spreads"].get(f"{name}.{part}"):
                numbers = (f"{spread[key]:.3f}" for key in ("median", "worst", "p5", "p95"))
                table.add_row(*label, PARTS[part], *numbers)
                label = ("", "", "")
        if label[0]:
            table.add_row(*label)
        table.add_section()
    if reasons := not_completed(summary["runs"]):
        table.caption = Text("\n".join(reasons), justify="left")
        table.caption_style = ""
    return table


def not_completed(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Runs that did not complete, each with its reason; of many the first."""
    found = [run for run in runs if not run["completed"]]
    lines = [f"{setting_words(run['setting'])}, {run['case']}, seed {run['seed']}: {run['cause']}" for run in found]
    more = len(lines) - MOST
    return [*lines[:MOST], f"and {more} more"] if more > 0 else lines


def write_sweep(folder: Path, summary: Mapping[str, Any], source: str, started: float) -> None:
    """Results beside the manifests.

    Args:
        folder: the sweep's.
        summary: all of the sweep, without the place where it is.
        source: the experiment's file.
        started: when it began [s since 1970].

    Raises:
        RecordingError: they cannot be written.
    """
    short = {key: value for key, value in summary.items() if key not in ("settings", "runs")}
    label = Label.COMPLETE if summary["completed"] else Label.STOPPED
    try:
        (folder / EXPERIMENT).write_text(source, encoding="utf-8")
        write_json(folder / SWEEP, summary)
        write_json(folder / SUMMARY, {**short, "started": started, "label": label, "recording": str(folder)})
    except OSError as error:
        raise RecordingError(f"{folder}: cannot write results there: {error.strerror}") from None
