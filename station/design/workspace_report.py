"""Report of a workspace study: region that the tip reaches, and quality measures over this region and each joint."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from core.robot.robot import Array
from station.control.monitors import Margins
from station.design import page
from station.design.workspace import WorkspaceStudy
from station.design.workspace_output import POSES_FILE, head, rows, sentences
from station.report import document, style
from station.report.figure import ReportFigure

#: Number of cells along each axis of a map, and number of bins into which a joint's travel is divided.
MAP_CELLS, TRAVEL_BINS = 45, 24
COLOUR_MAP = "viridis"  # perceptually uniform, also for colour-blind readers and in grey


def write_report(folder: Path, found: WorkspaceStudy, summary: Mapping[str, Any]) -> None:
    """Write report.html into `folder`.

    Raises:
        OSError: the file cannot be written.

    """
    with page.drawing():
        parts = page.page_head(
            head(summary), f"{folder.name}; robot '{found.file.name}' ({found.file.source or 'unknown source'})",
            "Computed by the loaded model: nothing was measured.",
        )  # fmt: skip
        parts += [document.paragraph(text, "result") for text in sentences(summary)]
        parts.append(document.table(("over the poses", "least", "5 %", "median", "95 %", "most"), rows(summary)))
        parts.append(document.heading("Figures"))
        parts += [page.figure_html(drawn) for drawn in (_reach(found), _maps(found), _joints(found))]
        parts.append(document.paragraph(f"All poses with their numbers: {POSES_FILE}."))
        page.write_page(folder, head(summary), parts)


def _reach(found: WorkspaceStudy) -> ReportFigure:
    figure = Figure(figsize=(style.WIDTH_INCH, 3.0))
    tips = 1e3 * found.tips
    maps: list[Any] = []
    for axes, (across, up) in zip(figure.subplots(1, 3), ((2, 0), (2, 1), (1, 0)), strict=True):
        maps.append(
            axes.hexbin(tips[:, across], tips[:, up], gridsize=MAP_CELLS, cmap=COLOUR_MAP, norm=LogNorm(), mincnt=1)
        )
        axes.set(xlabel=f"{'xyz'[across]} [mm]", ylabel=f"{'xyz'[up]} [mm]", aspect="equal")
    figure.colorbar(maps[-1], ax=figure.axes, label="poses in a cell", shrink=0.8)
    return ReportFigure(
        "reach", "Reach",
        "Positions of the tip, seen along each axis. Colour: number of poses in a cell. World frame: x down, z along"
        " the straight tubes.",
        "Maps of the tip's positions in the planes z-x, z-y and y-x.", figure,
    )  # fmt: skip


def _maps(found: WorkspaceStudy) -> ReportFigure:
    figure = Figure(figsize=(style.WIDTH_INCH, 3.0))
    base = np.asarray(found.file.robot().base.position)
    x, y, z = 1e3 * (found.tips - base).T
    radius = np.hypot(x, y)
    quantities: tuple[tuple[str, Array], ...] = (
        ("dexterity [mm/s]", 1e3 * found.dexterity),
        ("stiffness [N/m]", found.stiffness),
        ("margin of stability [1]", found.margin),
    )
    for axes, (label, values) in zip(figure.subplots(1, 3), quantities, strict=True):
        drawn = axes.hexbin(z, radius, C=values, reduce_C_function=np.median, gridsize=MAP_CELLS, cmap=COLOUR_MAP)
        axes.set(xlabel="z from the plate [mm]", ylabel="distance from the axis [mm]", aspect="equal", title=label)
        figure.colorbar(drawn, ax=axes, shrink=0.8)
    return ReportFigure(
        "maps", "Dexterity, stiffness and margin over the tip's position",
        "Median of the poses with the tip in a cell. Dexterity: speed of the tip in its slowest direction with the"
        " joints at full speed. Stiffness: against a force in the softest direction.",
        "Maps of dexterity, stiffness and margin over the distance along and from the axis.", figure,
    )  # fmt: skip


def _joints(found: WorkspaceStudy) -> ReportFigure:
    across = list(_coordinates(found))
    rows = (
        ("dexterity [mm/s]", 1e3 * found.dexterity, False),
        ("stiffness [N/m]", found.stiffness, True),
        ("margin [1]", found.margin, False),
    )
    figure = Figure(figsize=(style.WIDTH_INCH, 5.2))
    grid = figure.subplots(3, len(across), sharex="col", sharey="row", squeeze=False)
    for line, (label, values, logarithmic) in zip(grid, rows, strict=True):
        for axes, (name, positions) in zip(line, across, strict=True):
            centres, bands = _bands(positions, values)
            axes.fill_between(centres, bands[0], bands[2], color=style.SKY, alpha=0.4, linewidth=0, label="5 to 95 %")
            axes.plot(centres, bands[1], color=style.BLUE, label="median")
            if label.startswith("margin"):
                axes.axhline(Margins().stability, color=style.GREY, linestyle=":", label="motions end in HOLD below")
            if logarithmic:
                axes.set_yscale("log")
            if axes in grid[-1]:
                axes.set_xlabel(name)
        line[0].set_ylabel(label)
    figure.align_ylabels(list(grid[:, 0]))
    style.legend(figure, list(grid[:, 0]))
    return ReportFigure(
        "joints", "Over the joint space",
        "Each quantity over each joint, for all positions of the others. Rotations are relative to the outermost"
        " rotating tube: without a load only relative rotations change the shape.",
        "Median and 5 to 95 % of dexterity, stiffness and margin over each joint.", figure,
    )  # fmt: skip


def _coordinates(found: WorkspaceStudy) -> Iterator[tuple[str, Array]]:
    """Yield name with unit, and values at all poses (k,), of each joint coordinate that changes the tubes' shape."""
    joints = found.file.robot().joints
    turning = [j for j, joint in enumerate(joints) if joint.motion == "rotation"]
    outermost = max(turning, key=lambda j: joints[j].tube, default=None)
    for j, joint in enumerate(joints):
        if joint.motion == "translation":
            yield f"{joint.name} [mm]", 1e3 * found.joints[:, j]
        elif j != outermost and outermost is not None:
            turned = np.rad2deg(found.joints[:, j] - found.joints[:, outermost])
            yield f"{joint.name} - {joints[outermost].name} [deg]", (turned + 180.0) % 360.0 - 180.0
    if len(turning) == 1 and outermost is not None:
        yield f"{joints[outermost].name} [deg]", np.rad2deg(found.joints[:, outermost])


def _bands(positions: Array, values: Array) -> tuple[Array, Array]:
    """Return the centres of bins along an axis (p,), and 5th, 50th and 95th percentile of the values in each (3, p)."""
    edges = np.linspace(positions.min(), positions.max(), TRAVEL_BINS + 1)
    piece = np.clip(np.digitize(positions, edges) - 1, 0, TRAVEL_BINS - 1)
    filled = [number for number in range(TRAVEL_BINS) if (piece == number).any()]
    bands = np.array([np.percentile(values[piece == number], (5.0, 50.0, 95.0)) for number in filled])
    return 0.5 * (edges[:-1] + edges[1:])[filled], bands.T
