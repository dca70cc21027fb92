"""Results of a workspace study: table on the screen, files on the disk."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from station.config.strict import ConfigError
from station.design.workspace import PERCENTILES, WorkspaceStudy

NUMBERS_FILE, POSES_FILE = "workspace.json", "poses.csv"
#: Rows of the table of quality measures: key of the summary, and label with unit.
TABLE_ROWS = (
    ("dexterity_mm_s", "dexterity: the tip's slowest direction, joints at full speed [mm/s]"),
    ("stiffness_n_m", "stiffness of the tip in its softest direction [N/m]"),
    ("margin", "margin of stability [1]: 1 straight and unloaded, 0 snaps"),
)


def head(summary: Mapping[str, Any]) -> str:
    """Return a title with the robot and the load."""
    x, y, z = summary["force_n"]
    load = f"under {x:g} / {y:g} / {z:g} N (x / y / z)" if x or y or z else "without load"
    return f"Workspace of '{summary['robot']}' {load}"


def sentences(summary: Mapping[str, Any]) -> list[str]:
    """Return sentences with the numbers of a workspace that are not in its table."""
    reach = ", ".join(
        f"{axis} {ends['least']:.1f} ... {ends['most']:.1f}" for axis, ends in summary["reach_mm"].items()
    )
    return [
        f"The tip reaches {reach} mm: {summary['reach_cm3']:.4g} cm^3,"
        f" counted in cells of {summary['reach_cell_mm']:g} mm.",
        f"{summary['poses']} poses are spread over the joints' travel;"
        f" {summary['without_shape']} have no model solution;"
        f" {100.0 * summary['below_it']:.3g} % of the others have a margin below {summary['held_below_margin']:g},"
        " at which a motion ends in HOLD.",
    ]


def table(summary: Mapping[str, Any]) -> Table:
    """Return a table for the terminal with a row for each quality measure."""
    shown = Table(title=Text(head(summary)), title_style="", title_justify="left")
    shown.add_column("over the poses")
    for name in ("least", "5 %", "median", "95 %", "most"):
        shown.add_column(name, justify="right")
    for row in rows(summary):
        shown.add_row(*row)
    return shown


def rows(summary: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the rows of the table of quality measures as texts."""
    return [(label, *(f"{summary[key][part]:.4g}" for part in PERCENTILES)) for key, label in TABLE_ROWS]


def write_workspace(folder: Path, found: WorkspaceStudy, summary: Mapping[str, Any]) -> None:
    """Write the numbers, every pose and the report into `folder`.

    Raises:
        ConfigError: the folder cannot be written to.

    """
    from station.design.workspace_report import write_report  # imported here: the plotting library takes a second

    joints = [f"{joint.name} [{joint.unit}]" for joint in found.file.robot().joints]
    columns = [*joints, "tip_x [m]", "tip_y [m]", "tip_z [m]", "dexterity [m/s]", "stiffness [N/m]", "margin [1]"]
    lines = zip(found.joints, found.tips, found.dexterity, found.stiffness, found.margin, strict=True)
    try:
        with (folder / POSES_FILE).open("w", encoding="utf-8", newline="") as file:
            out = csv.writer(file)
            out.writerow(columns)
            for pose, tip, *numbers in lines:
                out.writerow(f"{value:.9g}" for value in (*pose, *tip, *numbers))
        (folder / NUMBERS_FILE).write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
        write_report(folder, found, summary)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write results: {error.strerror}") from None
