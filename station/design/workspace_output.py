"""A workspace on the screen and on disk."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from station.config.strict import ConfigError
from station.design.workspace import TOLD, Workspace

NUMBERS, POSES = "workspace.json", "poses.csv"
#: Rows of the table: key of the summary, and what it is in words, with its unit.
ROWS = (
    ("dexterity_mm_s", "dexterity: the tip's slowest direction, joints at full speed [mm/s]"),
    ("stiffness_n_m", "stiffness of the tip in its softest direction [N/m]"),
    ("margin", "margin of stability [1]: 1 straight and unloaded, 0 snaps"),
)


def head(said: Mapping[str, Any]) -> str:
    """What was looked at, in a line."""
    x, y, z = said["force_n"]
    load = f"under {x:g} / {y:g} / {z:g} N (x / y / z)" if x or y or z else "without load"
    return f"Workspace of '{said['robot']}' {load}"


def sentences(said: Mapping[str, Any]) -> list[str]:
    """What the table does not say."""
    reach = ", ".join(f"{axis} {ends['least']:.1f} ... {ends['most']:.1f}" for axis, ends in said["reach_mm"].items())
    return [
        f"The tip reaches {reach} mm: {said['reach_cm3']:.4g} cm^3, counted in cells of {said['reach_cell_mm']:g} mm.",
        f"{said['poses']} poses spread over the joints' travel; {said['without_shape']} have no shape;"
        f" {100.0 * said['below_it']:.3g} % of the others have a margin below {said['held_below_margin']:g},"
        " where a motion is held.",
    ]


def table(said: Mapping[str, Any]) -> Table:
    """A row for each quantity."""
    shown = Table(title=Text(head(said)), title_style="", title_justify="left")
    shown.add_column("over the poses")
    for name in ("least", "5 %", "median", "95 %", "most"):
        shown.add_column(name, justify="right")
    for row in rows(said):
        shown.add_row(*row)
    return shown


def rows(said: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The same as texts."""
    return [(words, *(f"{said[key][part]:.4g}" for part in TOLD)) for key, words in ROWS]


def write_workspace(folder: Path, found: Workspace, said: Mapping[str, Any]) -> None:
    """Numbers, every pose and the report in `folder`.

    Raises:
        ConfigError: the folder cannot be written to.

    """
    from station.design.workspace_report import write_report  # here: the figures' library takes a second

    joints = [f"{joint.name} [{joint.unit}]" for joint in found.file.robot().joints]
    columns = [*joints, "tip_x [m]", "tip_y [m]", "tip_z [m]", "dexterity [m/s]", "stiffness [N/m]", "margin [1]"]
    lines = zip(found.joints, found.tips, found.dexterity, found.stiffness, found.margin, strict=True)
    try:
        with (folder / POSES).open("w", encoding="utf-8", newline="") as file:
            out = csv.writer(file)
            out.writerow(columns)
            for pose, tip, *numbers in lines:
                out.writerow(f"{value:.9g}" for value in (*pose, *tip, *numbers))
        (folder / NUMBERS).write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")
        write_report(folder, found, said)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write results there: {error.strerror}") from None
