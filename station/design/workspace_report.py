"""Results of a workspace study: table on the screen, files on the disk, and a report with figures.

The figures show the region that the tip reaches, and quality measures over this region and each joint.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from rich.table import Table
from rich.text import Text

from core.robot.robot import Array
from station.design.workspace import PERCENTILES, WorkspaceStudy
from station.report import document, style
from station.report.document import ReportFigure

NUMBERS_FILE, POSES_FILE = "workspace.json", "poses.csv"
#: Rows of the table of quality measures: key of the summary, and label with unit.
TABLE_ROWS = (
    ("dexterity_mm_s", "dexterity: the tip's slowest direction, joints at full speed [mm/s]"),
    ("stiffness_n_m", "stiffness of the tip in its softest direction [N/m]"),
    ("margin", "margin of stability [1]: 1 straight and unloaded, 0 snaps"),
)
TABLE_HEAD = ("over the poses", "least", "5 %", "median", "95 %", "most")
#: Number of cells along each axis of a map, and number of bins into which a joint's travel is divided.
MAP_CELLS, TRAVEL_BINS = 45, 24
COLOUR_MAP = "viridis"  # perceptually uniform, also for colour-blind readers and in grey


def _title(summary: Mapping[str, Any]) -> str:
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
        f" in {100.0 * summary['may_snap']:.3g} % of the others, tubes that differ by"
        f" {100.0 * summary['tube_uncertainty']:g} % may snap, and a motion toward such a pose ends in HOLD.",
    ]


def _rows(summary: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the rows of the table of quality measures as texts."""
    return [(label, *(f"{summary[key][part]:.4g}" for part in PERCENTILES)) for key, label in TABLE_ROWS]


def table(summary: Mapping[str, Any]) -> Table:
    """Return a table for the terminal with a row for each quality measure."""
    return document.terminal_table(TABLE_HEAD, _rows(summary), title=Text(_title(summary), justify="left"))


def write_workspace(folder: Path, found: WorkspaceStudy, summary: Mapping[str, Any]) -> None:
    """Write the numbers, every pose and the report into `folder`.

    Raises:
        ConfigError: the folder cannot be written to.
    """
    joints = [f"{joint.name} [{joint.unit}]" for joint in found.file.robot().joints]
    columns = [*joints, "tip_x [m]", "tip_y [m]", "tip_z [m]", "dexterity [m/s]", "stiffness [N/m]", "margin [1]"]
    numbers = np.column_stack((found.joints, found.tips, found.dexterity, found.stiffness, found.margin))
    poses = [columns, *([f"{value:.9g}" for value in row] for row in numbers.tolist())]
    parts = _parts(folder, found, summary)
    document.write_results(folder, _title(summary), parts, {NUMBERS_FILE: summary}, {POSES_FILE: poses})


def _parts(folder: Path, found: WorkspaceStudy, summary: Mapping[str, Any]) -> Iterator[str]:
    yield from document.page_head(
        _title(summary), f"{folder.name}; robot '{found.file.name}' ({found.file.source or 'unknown source'})",
        "Computed by the loaded model: nothing was measured.",
    )  # fmt: skip
    for text in sentences(summary):
        yield document.paragraph(text, "result")
    yield document.table(TABLE_HEAD, _rows(summary))
    yield document.heading("Figures")
    for drawn in (_reach(found), _maps(found), _joints(found)):
        yield document.picture(drawn, "computed by the loaded model")
    yield document.paragraph(f"All poses with their numbers: {POSES_FILE}.")


def _reach(found: WorkspaceStudy) -> ReportFigure:
    figure = style.blank(3.0)
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
    figure = style.blank(3.0)
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
    figure = style.blank(5.2)
    grid = figure.subplots(3, len(across), sharex="col", sharey="row", squeeze=False)
    for line, (label, values, logarithmic) in zip(grid, rows, strict=True):
        for axes, (name, positions) in zip(line, across, strict=True):
            centres, bands = _bands(positions, values)
            axes.fill_between(centres, bands[0], bands[2], color=style.SKY, alpha=0.4, linewidth=0, label="5 to 95 %")
            axes.plot(centres, bands[1], color=style.BLUE, label="median")
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
