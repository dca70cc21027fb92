"""Results of a design study: tables on the screen, files on the disk."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from station.config.robots import RobotFile
from station.config.strict import ConfigError, toml_lines
from station.design.outcome import DesignResult

NUMBERS_FILE, ROBOT_FILE = "design.json", "robot.toml"
#: Rows of the table that compares the start robot with the found one: key of the summary, and label with unit.
TABLE_ROWS = (
    ("largest_force_n", "largest held force [N]"),
    ("least_margin", "smallest margin of stability under the task's forces [1]"),
    ("least_dexterity_mm_s", "smallest dexterity under them [mm/s]"),
    ("least_stiffness_n_m", "smallest stiffness under them [N/m]"),
    ("exact_away_mm", "exact rod: largest distance from the points [mm]"),
    ("exact_margin", "exact rod: smallest margin [1]"),
    ("exact_away_under_largest_mm", "the same under the largest force [mm]"),
    ("exact_margin_under_largest", "the same under the largest force [1]"),
)


def rows(summary: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """Return the rows of the results table: label, value of the start robot, value of the found robot, their ratio."""
    before, after, gain = summary["before"], summary["after"], summary["gain"]
    return [
        (label, _number(before[key]), _number(after[key]), f"{gain[key]:.3g}" if key in gain else "")
        for key, label in TABLE_ROWS
    ]


def parameter_rows(summary: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """Return the rows of the parameter table: parameter and unit, start value, found value, search range."""
    return [
        (f"{each['key']} [{each['unit']}]", f"{each['before']:.5g}", f"{each['after']:.5g}",
         f"{each['lower']:g} ... {each['upper']:g}")
        for each in summary["parameters"]
    ]  # fmt: skip


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def tables(summary: Mapping[str, Any]) -> list[Table]:
    """Return a table of the results and a table of the parameters."""
    names = summary["before"]["robot"], summary["after"]["robot"]
    results = Table(title=Text(f"{summary['title']}\n{summary['candidates']} candidates"), title_style="")
    results.add_column("")
    for title in (*names, "times"):
        results.add_column(title, justify="right")
    for row in rows(summary):
        results.add_row(*row)
    parameters = Table()
    parameters.add_column("parameter")
    for title in (*names, "search range"):
        parameters.add_column(title, justify="right")
    for row in parameter_rows(summary):
        parameters.add_row(*row)
    return [results, parameters]


def sentences(summary: Mapping[str, Any]) -> list[str]:
    """Return a sentence for each robot about what limits its load, and warnings about the found robot."""
    ends = [
        f"Limit of the load of '{each['robot']}': {each['then']}." for each in (summary["before"], summary["after"])
    ]
    worse = [] if summary["better"] else ["The search found no robot that is better than the start robot."]
    return [*worse, *ends, *([summary["warning"]] if summary["warning"] else [])]


def robot_text(file: RobotFile) -> str:
    """Return a robot as the TOML text of its file."""
    table = file.model_dump(mode="json", exclude_none=True)
    parts = {key: table.pop(key) for key in ("base", "workspace", "tubes", "joints") if key in table}
    lines = toml_lines(table)
    for name, part in parts.items():
        for each in part if isinstance(part, list) else [part]:
            lines += ["", f"[[{name}]]" if isinstance(part, list) else f"[{name}]", *toml_lines(each)]
    return "\n".join(lines) + "\n"


def write_design(folder: Path, found: DesignResult, summary: Mapping[str, Any]) -> None:
    """Write the numbers, the found robot and the report into `folder`.

    Raises:
        ConfigError: the folder cannot be written to.

    """
    from station.design.design_report import write_report  # imported here: the plotting library takes a second

    try:
        (folder / ROBOT_FILE).write_text(robot_text(found.after.file), encoding="utf-8")
        (folder / NUMBERS_FILE).write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
        write_report(folder, found, summary)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write results: {error.strerror}") from None
