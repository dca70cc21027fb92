"""A design on the screen and on disk."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.config.toml_text import toml_lines
from station.design.outcome import Design

NUMBERS, ROBOT = "design.json", "robot.toml"
#: Rows of the table: key of the summary, and what it is in words, with its unit.
ROWS = (
    ("largest_force_n", "largest force that is held [N]"),
    ("least_margin", "least margin of stability under the task's forces [1]"),
    ("least_dexterity_mm_s", "least dexterity under them [mm/s]"),
    ("least_stiffness_n_m", "least stiffness under them [N/m]"),
    ("exact_away_mm", "exact rod: largest distance from the points [mm]"),
    ("exact_margin", "exact rod: least margin [1]"),
    ("exact_away_under_largest_mm", "the same under the largest force [mm]"),
    ("exact_margin_under_largest", "the same under the largest force [1]"),
)


def rows(said: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """What it is, before, after, and after over before."""
    before, after, gain = said["before"], said["after"], said["gain"]
    return [
        (words, _number(before[key]), _number(after[key]), f"{gain[key]:.3g}" if key in gain else "")
        for key, words in ROWS
    ]


def parameter_rows(said: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """Parameter with its unit, before, after, and where it was looked for."""
    return [
        (f"{each['key']} [{each['unit']}]", f"{each['before']:.5g}", f"{each['after']:.5g}",
         f"{each['lower']:g} ... {each['upper']:g}")
        for each in said["parameters"]
    ]  # fmt: skip


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def tables(said: Mapping[str, Any]) -> list[Table]:
    """What the tubes do, and what they are."""
    names = said["before"]["robot"], said["after"]["robot"]
    does = Table(title=Text(f"{said['title']}\n{said['candidates']} candidates"), title_style="")
    does.add_column("")
    for title in (*names, "times"):
        does.add_column(title, justify="right")
    for row in rows(said):
        does.add_row(*row)
    are = Table()
    are.add_column("parameter")
    for title in (*names, "looked for in"):
        are.add_column(title, justify="right")
    for row in parameter_rows(said):
        are.add_row(*row)
    return [does, are]


def sentences(said: Mapping[str, Any]) -> list[str]:
    """What ends either robot's load, and what is to be known of the found one."""
    ends = [f"'{each['robot']}' holds no more, since {each['then']}." for each in (said["before"], said["after"])]
    worse = [] if said["better"] else ["Nothing was found that is better than what the study begins from."]
    return [*worse, *ends, *([said["warning"]] if said["warning"] else [])]


def robot_text(file: RobotFile) -> str:
    """A robot's file."""
    table = file.model_dump(mode="json", exclude_none=True)
    parts = {key: table.pop(key) for key in ("base", "workspace", "tubes", "joints") if key in table}
    lines = toml_lines(table)
    for name, part in parts.items():
        for each in part if isinstance(part, list) else [part]:
            lines += ["", f"[[{name}]]" if isinstance(part, list) else f"[{name}]", *toml_lines(each)]
    return "\n".join(lines) + "\n"


def write_design(folder: Path, found: Design, said: Mapping[str, Any]) -> None:
    """Numbers, the robot that was found, and the report in `folder`.

    Raises:
        ConfigError: the folder cannot be written to.

    """
    from station.design.design_report import write_report  # here: the figures' library takes a second

    try:
        (folder / ROBOT).write_text(robot_text(found.after.file), encoding="utf-8")
        (folder / NUMBERS).write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")
        write_report(folder, found, said)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write results there: {error.strerror}") from None
