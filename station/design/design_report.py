"""The report of a design: what the found tubes hold, how they stand there, and how they were found."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from core.errors import CtrError
from core.model.statics import Statics
from core.robot.robot import Array
from station.design import page
from station.design.candidates import NAME as KEPT
from station.design.design_output import ROBOT, parameter_rows, rows, sentences
from station.design.outcome import Design, Looked
from station.design.search import NONE
from station.design.study import largest
from station.report import document, style
from station.report.drawn import Drawn


def write_report(folder: Path, found: Design, said: Mapping[str, Any]) -> None:
    """report.html in `folder`.

    Raises:
        OSError: the folder does not take it.

    """
    names = said["before"]["robot"], said["after"]["robot"]
    with page.drawing():
        parts = page.begin(
            said["title"], f"{folder.name}: {said['candidates']} candidates, objective: {said['objective']}",
            "Computed by the loaded model, and held against the exact rod: nothing was measured.",
        )  # fmt: skip
        parts.append(document.table(("", *names, "times"), rows(said)))
        parts += [document.paragraph(text) for text in sentences(said)]
        parts.append(document.heading("Tubes"))
        parts.append(document.table(("parameter", *names, "looked for in"), parameter_rows(said)))
        parts.append(document.paragraph(f"The robot as a file: {ROBOT}; every candidate: {KEPT}."))
        parts.append(document.heading("Figures"))
        parts += [page.shown(drawn) for drawn in _figures(found)]
        page.write(folder, said["title"], parts)


def _figures(found: Design) -> Iterator[Drawn]:
    looked = [
        (each, look)
        for each, look in zip((found.before, found.after), (style.SERIES[0], style.SERIES[2]), strict=True)
        if each.outcome.held is not None
    ]
    if looked:
        yield _shapes(found, looked)
        yield _along(found, looked)
    yield _way(found)


def _shapes(found: Design, looked: list[tuple[Looked, style.Look]]) -> Drawn:
    task = found.study.file.task
    row = max(range(len(task.forces)), key=lambda number: largest([task.forces[number]]))
    force, points = np.array(task.forces[row]), 1e3 * np.array(task.points)
    figure = Figure(figsize=(style.WIDTH, 5.0))
    grid = figure.subplots(2, 1)
    for axes, up in zip(grid, (0, 1), strict=True):
        for each, look in looked:
            for number in sorted({0, len(points) - 1}):
                line = _shape(each, row, number, force)
                axes.plot(
                    line[:, 2], line[:, up], color=look.colour, linestyle=look.dash, linewidth=look.width,
                    label=f"'{each.file.name}'" if number == 0 else None,
                )  # fmt: skip
        axes.plot(points[:, 2], points[:, up], ".", color=style.GREEN, label="points of the task")
        axes.set(ylabel=f"{'xyz'[up]} [mm]", aspect="equal")
    grid[-1].set_xlabel("z [mm]")
    style.legend(figure, [grid[0]])
    return Drawn(
        "shapes", "The tubes at the first and the last point",
        f"Under {largest([task.forces[row]]):g} N in direction {' / '.join(f'{part:g}' for part in task.forces[row])}"
        " (x / y / z), by the loaded model.",
        "Shapes of both robots at the ends of the task, seen from two sides.", figure,
    )  # fmt: skip


def _shape(looked: Looked, row: int, number: int, force: Array) -> Array:
    held = looked.outcome.held
    model = Statics(looked.file.robot())
    if held is None:
        return np.full((1, 3), np.nan)
    try:
        at = model.solve(held.joints[row, number], np.concatenate((force, np.zeros(3))))
    except CtrError:
        return np.full((1, 3), np.nan)
    return 1e3 * model.shape(at)[:, 10:13]


def _along(found: Design, looked: list[tuple[Looked, style.Look]]) -> Drawn:
    task = found.study.file.task
    figure, axes = style.stacked(
        ("margin [1]", "dexterity [mm/s]", "stiffness [N/m]"), across="point of the task (number)"
    )
    numbers = np.arange(1, len(task.points) + 1)
    for each, look in looked:
        held = each.outcome.held
        if held is None:
            continue
        for row, force in enumerate(task.forces):
            size = largest([force])
            part = 0.35 + 0.65 * size / largest(task.forces)
            lines = held.margins[row], 1e3 * held.dexterities[row], held.stiffnesses[row]
            for one, values in zip(axes, lines, strict=True):
                one.plot(
                    numbers, values, color=look.colour, linestyle=look.dash, linewidth=look.width, alpha=part,
                    marker=".", label=f"'{each.file.name}', {size:g} N",
                )  # fmt: skip
    axes[0].axhline(task.margin, color=style.GREY, linestyle=":", label="least that is allowed")
    axes[1].axhline(1e3 * task.dexterity, color=style.GREY, linestyle=":")
    style.legend(figure, axes, columns=3)
    return Drawn(
        "along", "Along the task",
        "Margin of stability (1: straight and unloaded, 0: snaps), the tip's speed in its slowest direction with the"
        " joints at full speed, and stiffness against a force in the softest direction; paler lines are under smaller"
        " forces.",
        "Margin, dexterity and stiffness of both robots at every point.", figure,
    )  # fmt: skip


def _way(found: Design) -> Drawn:
    objective = found.study.file.objective
    unit, scale = {
        "load": ("largest force held [N]", largest(found.study.file.task.forces)),
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
    unable, none = int((costs >= 0.0).sum()), int((costs >= NONE).sum())
    return Drawn(
        "way", "How it was found",
        f"Every candidate in the order of the search; {unable} of {len(costs)} cannot carry out the task and are not"
        f" drawn ({none} of them cannot even be).",
        "The objective of every candidate, and the best so far.", figure,
    )  # fmt: skip
