"""Results of a design study: tables on the screen, files on the disk, and a report with figures.

The figures show the loads that the found tubes hold, their shapes, and the course of the search.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from core.errors import CtrError
from core.model.statics import Statics
from core.robot.robot import Array
from station.calibration.files import robot_text
from station.design.outcome import DesignResult, EvaluatedDesign
from station.design.search import CANDIDATES_FILE, IMPOSSIBLE_COST
from station.design.study import largest
from station.report import document, style
from station.report.document import ReportFigure

NUMBERS_FILE, ROBOT_FILE = "design.json", "robot.toml"
#: Rows of the table that compares the start robot with the found one: key of the summary, and label with unit.
TABLE_ROWS = (
    ("largest_force_n", "largest held force [N]"),
    ("least_margin", "smallest margin of stability under the task's forces [1]"),
    ("least_dexterity_mm_s", "smallest dexterity under the task's forces [mm/s]"),
    ("least_stiffness_n_m", "smallest stiffness under the task's forces [N/m]"),
    ("exact_away_mm", "exact rod: largest distance from the points [mm]"),
    ("exact_margin", "exact rod: smallest margin [1]"),
    ("exact_away_under_largest_mm", "exact rod: largest distance under the largest force [mm]"),
    ("exact_margin_under_largest", "exact rod: smallest margin under the largest force [1]"),
)
#: Label on every figure: origin of its data.
ORIGIN_LABEL = "computed by the loaded model"


def _rows(summary: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """Return the rows of the results table: label, value of the start robot, value of the found robot, their ratio."""
    before, after, gain = summary["before"], summary["after"], summary["gain"]
    return [
        (label, _number(before[key]), _number(after[key]), f"{gain[key]:.3g}" if key in gain else "")
        for key, label in TABLE_ROWS
    ]


def _parameter_rows(summary: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
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
    title = Text(f"{summary['title']}\n{summary['candidates']} candidates")
    return [
        document.terminal_table(("", *names, "times"), _rows(summary), title=title),
        document.terminal_table(("parameter", *names, "search range"), _parameter_rows(summary)),
    ]


def sentences(summary: Mapping[str, Any]) -> list[str]:
    """Return a sentence for each robot about what limits its load, and warnings about the found robot."""
    ends = [
        f"Limit of the load of '{each['robot']}': {each['then']}." for each in (summary["before"], summary["after"])
    ]
    worse = [] if summary["better"] else ["The search found no robot that is better than the start robot."]
    return [*worse, *ends, *([summary["warning"]] if summary["warning"] else [])]


def write_design(folder: Path, found: DesignResult, summary: Mapping[str, Any]) -> None:
    """Write the numbers, the found robot and the report into `folder`.

    Raises:
        ConfigError: the folder cannot be written to.
    """
    texts, parts = {ROBOT_FILE: robot_text(found.after.file)}, _parts(folder, found, summary)
    document.write_results(folder, summary["title"], parts, {NUMBERS_FILE: summary}, texts=texts)


def _parts(folder: Path, found: DesignResult, summary: Mapping[str, Any]) -> Iterator[str]:
    names = summary["before"]["robot"], summary["after"]["robot"]
    yield from document.page_head(
        summary["title"], f"{folder.name}: {summary['candidates']} candidates, objective: {summary['objective']}",
        "Computed by the loaded model and checked with the exact rod: nothing was measured.",
    )  # fmt: skip
    yield document.table(("", *names, "times"), _rows(summary))
    for text in sentences(summary):
        yield document.paragraph(text)
    yield document.heading("Tubes")
    yield document.table(("parameter", *names, "search range"), _parameter_rows(summary))
    yield document.paragraph(f"The robot as a file: {ROBOT_FILE}; every candidate: {CANDIDATES_FILE}.")
    yield document.heading("Figures")
    for drawn in _figures(found):
        yield document.picture(drawn, ORIGIN_LABEL)


def _figures(found: DesignResult) -> Iterator[ReportFigure]:
    designs = [
        (each, line_style)
        for each, line_style in zip((found.before, found.after), (style.SERIES[0], style.SERIES[2]), strict=True)
        if each.outcome.nominal is not None
    ]
    if designs:
        yield _shapes(found, designs)
        yield _along(found, designs)
    yield _search_course(found)


def _shapes(found: DesignResult, designs: list[tuple[EvaluatedDesign, style.LineStyle]]) -> ReportFigure:
    task = found.study.file.task
    row = max(range(len(task.forces)), key=lambda number: largest([task.forces[number]]))
    force, points = np.array(task.forces[row]), 1e3 * np.array(task.points)
    figure = style.blank(5.0)
    grid = figure.subplots(2, 1)
    for axes, up in zip(grid, (0, 1), strict=True):
        for each, line_style in designs:
            for number in sorted({0, len(points) - 1}):
                line = _shape(each, row, number, force)
                axes.plot(
                    line[:, 2], line[:, up], color=line_style.colour, linestyle=line_style.dash,
                    linewidth=line_style.width, label=f"'{each.file.name}'" if number == 0 else None,
                )  # fmt: skip
        axes.plot(points[:, 2], points[:, up], ".", color=style.GREEN, label="points of the task")
        axes.set(ylabel=f"{'xyz'[up]} [mm]", aspect="equal")
    grid[-1].set_xlabel("z [mm]")
    style.legend(figure, [grid[0]])
    return ReportFigure(
        "shapes", "The tubes at the first and the last point",
        f"Under {largest([task.forces[row]]):g} N in direction {style.slashed(task.forces[row], 'g')}"
        " (x / y / z), by the loaded model.",
        "Shapes of both robots at the first and last point of the task, in two projections.", figure,
    )  # fmt: skip


def _shape(design: EvaluatedDesign, row: int, number: int, force: Array) -> Array:
    nominal = design.outcome.nominal
    model = Statics(design.file.robot())
    if nominal is None:
        return np.full((1, 3), np.nan)
    try:
        at = model.solve(nominal.joints[row, number], np.concatenate((force, np.zeros(3))))
    except CtrError:
        return np.full((1, 3), np.nan)
    return 1e3 * model.shape(at)[:, 10:13]


def _along(found: DesignResult, designs: list[tuple[EvaluatedDesign, style.LineStyle]]) -> ReportFigure:
    task = found.study.file.task
    figure, axes = style.stacked(
        ("margin [1]", "dexterity [mm/s]", "stiffness [N/m]"), across="point of the task (number)"
    )
    numbers = np.arange(1, len(task.points) + 1)
    for each, line_style in designs:
        nominal = each.outcome.nominal
        if nominal is None:
            continue
        for row, force in enumerate(task.forces):
            size = largest([force])
            part = 0.35 + 0.65 * size / largest(task.forces)
            lines = nominal.margins[row], 1e3 * nominal.dexterities[row], nominal.stiffnesses[row]
            for one, values in zip(axes, lines, strict=True):
                one.plot(
                    numbers, values, color=line_style.colour, linestyle=line_style.dash,
                    linewidth=line_style.width, alpha=part, marker=".", label=f"'{each.file.name}', {size:g} N",
                )  # fmt: skip
    axes[0].axhline(task.margin, color=style.GREY, linestyle=":", label="smallest allowed value")
    axes[1].axhline(1e3 * task.dexterity, color=style.GREY, linestyle=":")
    style.legend(figure, axes, columns=3)
    return ReportFigure(
        "along", "Along the task",
        "Margin of stability (1: straight and unloaded, 0: snaps). Dexterity: speed of the tip in its slowest direction"
        " with the joints at full speed. Stiffness: against a force in the softest direction. Paler lines: smaller"
        " forces.",
        "Margin, dexterity and stiffness of both robots at every point.", figure,
    )  # fmt: skip


def _search_course(found: DesignResult) -> ReportFigure:
    objective = found.study.file.objective
    unit, scale = {
        "load": ("largest held force [N]", largest(found.study.file.task.forces)),
        "margin": ("least margin [1]", 1.0),
        "stiffness": ("least stiffness [N/m]", 1.0),
    }[objective]
    costs = np.array([line["cost"] for line in found.lines])
    values = np.where(costs < 0.0, -scale * costs, np.nan)
    figure, (axes,) = style.stacked([unit], height=2.4, across="candidate (number)")
    numbers = np.arange(len(costs))
    axes.plot(numbers, values, ".", color=style.SKY, markersize=2.5, label="candidate")
    so_far = np.fmax.accumulate(values)
    axes.plot(numbers, so_far, color=style.BLACK, label="best so far")
    if np.isfinite(values[0]):
        axes.axhline(values[0], color=style.VERMILLION, linestyle="--", label=f"'{found.study.robot.name}'")
    style.legend(figure, [axes])
    unable, none = int((costs >= 0.0).sum()), int((costs >= IMPOSSIBLE_COST).sum())
    return ReportFigure(
        "way", "Course of the search",
        f"Every candidate in the order of the search. {unable} of {len(costs)} cannot carry out the task and are not"
        f" shown; {none} of them are impossible robots.",
        "Objective of every candidate and the best so far.", figure,
    )  # fmt: skip
