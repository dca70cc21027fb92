"""The report of a workspace: where the tip gets, what the tubes are like there, and which joints make it so."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from core.robot.robot import Array
from station.control.margins import Margins
from station.design import page
from station.design.workspace import Workspace
from station.design.workspace_output import POSES, head, rows, sentences
from station.report import document, style
from station.report.drawn import Drawn

#: Cells across a map, and pieces that a joint's travel is cut into.
CELLS, PIECES = 45, 24
COLOURS = "viridis"  # as even for colour-blind eyes, and in grey


def write_report(folder: Path, found: Workspace, said: Mapping[str, Any]) -> None:
    """report.html in `folder`.

    Raises:
        OSError: the folder does not take it.

    """
    with page.drawing():
        parts = page.begin(
            head(said), f"{folder.name}; robot '{found.file.name}' ({found.file.source or 'source not said'})",
            "Computed by the loaded model: nothing was measured.",
        )  # fmt: skip
        parts += [document.paragraph(text, "result") for text in sentences(said)]
        parts.append(document.table(("over the poses", "least", "5 %", "median", "95 %", "most"), rows(said)))
        parts.append(document.heading("Figures"))
        parts += [page.shown(drawn) for drawn in (_reach(found), _maps(found), _joints(found))]
        parts.append(document.paragraph(f"Every pose with its numbers: {POSES}."))
        page.write(folder, head(said), parts)


def _reach(found: Workspace) -> Drawn:
    figure = Figure(figsize=(style.WIDTH, 3.0))
    tips = 1e3 * found.tips
    maps: list[Any] = []
    for axes, (across, up) in zip(figure.subplots(1, 3), ((2, 0), (2, 1), (1, 0)), strict=True):
        there = tips[:, across], tips[:, up]
        maps.append(axes.hexbin(*there, gridsize=CELLS, cmap=COLOURS, norm=LogNorm(), mincnt=1))
        axes.set(xlabel=f"{'xyz'[across]} [mm]", ylabel=f"{'xyz'[up]} [mm]", aspect="equal")
    figure.colorbar(maps[-1], ax=figure.axes, label="poses in a cell", shrink=0.8)
    return Drawn(
        "reach", "Reach",
        "Where the tip gets, seen along each axis; colour: how many of the poses bring it there. World frame: x down,"
        " z along the straight tubes.",
        "Maps of the places of the tip in the planes z-x, z-y and y-x.", figure,
    )  # fmt: skip


def _maps(found: Workspace) -> Drawn:
    figure = Figure(figsize=(style.WIDTH, 3.0))
    base = np.asarray(found.file.robot().base.position)
    x, y, z = 1e3 * (found.tips - base).T
    away = np.hypot(x, y)
    worst: tuple[tuple[str, Array], ...] = (
        ("dexterity [mm/s]", 1e3 * found.dexterity),
        ("stiffness [N/m]", found.stiffness),
        ("margin of stability [1]", found.margin),
    )
    for axes, (label, values) in zip(figure.subplots(1, 3), worst, strict=True):
        drawn = axes.hexbin(z, away, C=values, reduce_C_function=np.median, gridsize=CELLS, cmap=COLOURS)
        axes.set(xlabel="z from the plate [mm]", ylabel="distance from the axis [mm]", aspect="equal", title=label)
        figure.colorbar(drawn, ax=axes, shrink=0.8)
    return Drawn(
        "maps", "Dexterity, stiffness and margin where the tip is",
        "Median of the poses that bring the tip to a cell. Dexterity is the speed of the tip in its slowest direction"
        " with the joints at full speed, stiffness that against a force in the softest direction.",
        "Maps of dexterity, stiffness and margin over the distance along and from the axis.", figure,
    )  # fmt: skip


def _joints(found: Workspace) -> Drawn:
    across = list(_coordinates(found))
    rows = (
        ("dexterity [mm/s]", 1e3 * found.dexterity, False),
        ("stiffness [N/m]", found.stiffness, True),
        ("margin [1]", found.margin, False),
    )
    figure = Figure(figsize=(style.WIDTH, 5.2))
    grid = figure.subplots(3, len(across), sharex="col", sharey="row", squeeze=False)
    for line, (label, values, logarithmic) in zip(grid, rows, strict=True):
        for axes, (name, places) in zip(line, across, strict=True):
            centres, bands = _bands(places, values)
            axes.fill_between(centres, bands[0], bands[2], color=style.SKY, alpha=0.4, linewidth=0, label="5 to 95 %")
            axes.plot(centres, bands[1], color=style.BLUE, label="median")
            if label.startswith("margin"):
                axes.axhline(Margins().stability, color=style.GREY, linestyle=":", label="motions are held below")
            if logarithmic:
                axes.set_yscale("log")
            if axes in grid[-1]:
                axes.set_xlabel(name)
        line[0].set_ylabel(label)
    figure.align_ylabels(list(grid[:, 0]))
    style.legend(figure, list(grid[:, 0]))
    return Drawn(
        "joints", "Over the joint space",
        "Each quantity over each joint, whatever the others are. Rotations are against the outermost tube that turns:"
        " only that bends the tubes differently while nothing pulls at them.",
        "Median and 5 to 95 % of dexterity, stiffness and margin over each joint.", figure,
    )  # fmt: skip


def _coordinates(found: Workspace) -> Iterator[tuple[str, Array]]:
    """Names with units, and places (k,) of the poses."""
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


def _bands(places: Array, values: Array) -> tuple[Array, Array]:
    """Middles (p,) of pieces of an axis, and 5 %, median and 95 % (3, p) of the values there."""
    edges = np.linspace(places.min(), places.max(), PIECES + 1)
    piece = np.clip(np.digitize(places, edges) - 1, 0, PIECES - 1)
    there = [number for number in range(PIECES) if (piece == number).any()]
    bands = np.array([np.percentile(values[piece == number], (5.0, 50.0, 95.0)) for number in there])
    return 0.5 * (edges[:-1] + edges[1:])[there], bands.T
