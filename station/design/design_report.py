"""Report of a design study: loads that the found tubes hold, their shapes, and the course of the search."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from core.errors import CtrError
from core.model.statics import Statics
from core.robot.robot import Array
from station.design import page
from station.design.design_output import ROBOT_FILE, parameter_rows, rows, sentences
from station.design.outcome import DesignResult, EvaluatedDesign
from station.design.search import CANDIDATES_FILE as KEPT
from station.design.search import IMPOSSIBLE_COST
from station.design.study import largest
from station.report import document, style
from station.report.figure import ReportFigure


def write_report(folder: Path, found: DesignResult, results: Mapping[str, Any]) -> None:
    """Write report.html into `folder`.

    Raises:
        OSError: the file cannot be written.

    """
    names = results["before"]["robot"], results["after"]["robot"]
    with page.drawing():
        parts = page.page_head(
            results["title"], f"{folder.name}: {results['candidates']} candidates, objective: {results['objective']}",
            "Computed by the loaded model and checked with the exact rod: nothing was measured.",
        )  # fmt: skip
        parts.append(document.table(("", *names, "times"), rows(results)))
        parts += [document.paragraph(text) for text in sentences(results)]
        parts.append(document.heading("Tubes"))
        parts.append(document.table(("parameter", *names, "search range"), parameter_rows(results)))
        parts.append(document.paragraph(f"The robot as a file: {ROBOT_FILE}; every candidate: {KEPT}."))
        parts.append(document.heading("Figures"))
        parts += [page.figure_html(drawn) for drawn in _figures(found)]
        page.write_page(folder, results["title"], parts)


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
    figure = Figure(figsize=(style.WIDTH_INCH, 5.0))
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
        f"Under {largest([task.forces[row]]):g} N in direction {' / '.join(f'{part:g}' for part in task.forces[row])}"
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
