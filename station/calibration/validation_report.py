"""The report of a validation: errors, where they are, what the poses told; one HTML file with everything in it."""

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from core.calibration.measured import Spread
from core.robot.robot import Array
from station.calibration.findings import cannot_tell, findings
from station.calibration.folder import REPORT
from station.calibration.poses import LeftOut
from station.calibration.report import intervals
from station.calibration.validation import (
    WORDS,
    Bin,
    Validation,
    by_direction,
    by_joint,
    found_rows,
)
from station.report import document, rendered, style
from station.report.drawn import Drawn

#: Errors are drawn so many times as long as the places.
LONGER = 10.0
#: Rows that were left out are listed up to here.
LISTED = 200
WAYS = ((1.0, "rising", 0), (-1.0, "falling", 2), (0.0, "not moved before", 3))


def write_report(folder: Path, title: str, validation: Validation, facts: Sequence[tuple[str, str]]) -> Path:
    """report.html in `folder`, which is there already.

    Raises:
        OSError: the folder does not take it.
    """
    with matplotlib.rc_context(style.SETTINGS):
        page = document.document(title, _parts(title, validation, facts))
    path = folder / REPORT
    path.write_text(page, encoding="utf-8")
    return path


def _parts(title: str, validation: Validation, facts: Sequence[tuple[str, str]]) -> Iterator[str]:
    best = validation.best
    yield f"<h1>{escape(title)}</h1>"
    yield document.table(("", ""), facts, texts=2)
    yield document.heading("Errors")
    yield document.paragraph(
        "Distance of the measured point from the model's, millimetres. Frames: a rigid motion, and a constant offset of"
        " the point in the frame of the tip. Tubes: these, and what can be wrong about the tubes."
    )
    yield document.table(("", "at", "poses", "mean", "median", "95 %", "largest"), error_rows(validation), texts=2)
    yield document.heading("What to know")
    for sentence in findings(validation):
        yield document.paragraph(sentence)
    if best.fit is not None:
        yield document.heading("What was found")
        rows = [(row.name, row.before, row.found, row.interval) for row in found_rows(validation)]
        yield document.table(("", "before", "found", "+- (95 %)"), rows)
        if told := cannot_tell(best):
            yield document.heading("What the data cannot tell")
            yield document.table(("",), [(text,) for text in told])
    for drawn in _figures(validation):
        style.finish(drawn.figure, f"measured poses of '{validation.robot.name}'")
        yield document.picture(rendered.data_uri(drawn), drawn.alt, drawn.title, drawn.caption)
    for heading, bins in (
        ("Errors by joint", by_joint(validation)),
        ("Errors by direction of travel", by_direction(validation)),
    ):
        yield document.heading(heading)
        if bins:
            yield document.paragraph("Millimetres, and the mean error along x, y, z of the robot's frame.")
            head = ("joint", "where", "poses", "mean", "95 %", "largest", "x", "y", "z")
            yield document.table(head, [_bin_row(each) for each in bins], texts=2)
        else:
            yield document.paragraph("No joint moved." if validation.poses.timed else "The poses tell no order.")
    for poses in (validation.poses, validation.test):
        if poses is not None and poses.left_out:
            yield document.heading(f"Rows of {poses.path.name} that were left out")
            yield document.table(("line", "why"), _left_rows(poses.left_out), texts=2)


def error_rows(validation: Validation) -> list[tuple[str, ...]]:
    """What was fitted, at which poses, how many, mean, median, 95 %, largest [mm]."""
    found: list[tuple[str, ...]] = []
    for each, errors in zip(validation.matches, validation.errors, strict=True):
        found.append((WORDS[each.extent], "these poses", *_cells(Spread.of(errors))))
        for unseen in validation.unseen:
            if unseen.extent == each.extent and validation.test is None:
                found.append((WORDS[each.extent], "every second: fitted", *_cells(unseen.fitted)))
                found.append((WORDS[each.extent], "the others: tested", *_cells(unseen.tested)))
            elif unseen.extent == each.extent and validation.test is not None:
                found.append((WORDS[each.extent], validation.test.path.name, *_cells(unseen.tested)))
    return found


def _cells(spread: Spread) -> tuple[str, ...]:
    return (str(spread.poses), *(f"{1e3 * value:.3f}" for value in spread[1:]))


def _bin_row(each: Bin) -> tuple[str, ...]:
    lengths = (each.spread.mean, each.spread.p95, each.spread.largest, *each.along)
    return (each.joint, each.where, str(each.spread.poses), *(f"{1e3 * value:.3f}" for value in lengths))


def _left_rows(left: Sequence[LeftOut]) -> list[tuple[str, str]]:
    rows = [(str(each.line), each.reason) for each in left[:LISTED]]
    return [*rows, ("...", f"and {len(left) - LISTED} more")] if len(left) > LISTED else rows


def _figures(validation: Validation) -> Iterator[Drawn]:
    yield _shares(validation)
    if any(
        np.ptp([measurement.joints[k] for measurement in validation.poses.measurements]) > 0.0
        for k in _joints(validation)
    ):
        yield _over_joints(validation)
    yield _over_poses(validation)
    yield _places(validation)
    if validation.best.extent == "tubes" and validation.best.fit is not None and validation.best.asked.quantities:
        yield intervals(validation.best.fit, len(validation.best.asked.quantities))


def _joints(validation: Validation) -> range:
    return range(len(validation.robot.joints))


def _lengths(errors: Array) -> Array:
    lengths = 1e3 * np.linalg.norm(errors, axis=1)
    return lengths[np.isfinite(lengths)]


def _shares(validation: Validation) -> Drawn:
    """Which part of the poses is off by less than what is on the axis."""
    figure = Figure(figsize=(style.WIDTH, 2.8))
    axes = figure.subplots()
    said: list[str] = []
    for number, (each, errors) in enumerate(zip(validation.matches, validation.errors, strict=True)):
        lengths = np.sort(_lengths(errors))
        if not lengths.size:
            continue
        look = style.series(number, WORDS[each.extent])
        part = 100.0 * np.arange(1, len(lengths) + 1) / len(lengths)
        axes.plot(lengths, part, color=look.colour, linestyle=look.dash, linewidth=look.width, label=look.label)
        said.append(f"{look.label}: half of the poses within {np.median(lengths):.3g} mm")
    axes.set_xscale("log")
    axes.set_xlabel("distance of the measured point from the model's [mm]")
    axes.set_ylabel("poses [%]")
    style.legend(figure, [axes])
    text = "; ".join(said)
    return Drawn("shares", "How many poses are how far off", f"{text}.", text, figure)


def _over_joints(validation: Validation) -> Drawn:
    """A panel a joint that moves: error of every pose, and the mean of each bin."""
    joints, errors = (
        np.array([measurement.joints for measurement in validation.poses.measurements]),
        validation.errors[-1],
    )
    lengths = 1e3 * np.linalg.norm(errors, axis=1)
    moving = [k for k in _joints(validation) if np.ptp(joints[:, k]) > 0.0]
    figure = Figure(figsize=(style.WIDTH, 0.8 + 1.7 * len(moving)))
    grid = figure.subplots(len(moving), 1, squeeze=False)
    panels: list[Axes] = [row[0] for row in grid]
    for axes, k in zip(panels, moving, strict=True):
        joint = validation.robot.joints[k]
        factor, unit = (180.0 / np.pi, "deg") if joint.unit == "rad" else (1e3, "mm")
        for way, label, number in WAYS if validation.poses.timed else ((None, "pose", 2),):
            came = (
                np.array([measurement.came for measurement in validation.poses.measurements])
                if way is not None
                else None
            )
            these = np.ones(len(joints), bool) if came is None else came[:, k] == way
            if these.any():
                look = style.series(number, label)
                axes.plot(
                    factor * joints[these, k], lengths[these], "osD"[number % 3], color=look.colour, markersize=2.6,
                    alpha=0.7, linewidth=0, label=label,
                )  # fmt: skip
        axes.set_xlabel(f"{joint.name} [{unit}]")
        axes.set_ylabel("error [mm]")
        axes.set_ylim(bottom=0.0)
    style.legend(figure, panels)
    names = ", ".join(validation.robot.joints[k].name for k in moving)
    return Drawn(
        "over_joints", f"Errors over the joints ({WORDS[validation.best.extent]})",
        "Each point a pose; by the way that the joint came where the order is known.", f"Errors over {names}.", figure,
    )  # fmt: skip


def _over_poses(validation: Validation) -> Drawn:
    """Components of the error in the order of the poses."""
    errors = 1e3 * validation.errors[-1]
    figure, panels = style.stacked([f"{axis} [mm]" for axis in style.AXES], height=1.0, across="pose")
    look = style.series(2, "")
    for column, axes in enumerate(panels):
        axes.plot(np.arange(1, len(errors) + 1), errors[:, column], ".", color=look.colour, markersize=3.0)
        axes.axhline(0.0, color=style.GREY, linewidth=0.7)
    rms = " / ".join(f"{value:.3f}" for value in np.sqrt(np.nanmean(errors**2, axis=0)))
    order = "in the order of their times" if validation.poses.timed else "in the order of the file"
    text = f"Measured minus model along x / y / z of the robot's frame, poses {order}: {rms} mm RMS."
    return Drawn("over_poses", "Errors pose by pose", text, text, figure)


def _places(validation: Validation) -> Drawn:
    """Where the points were, from two sides, with the errors longer than they are."""
    best, errors = validation.best, 1e3 * validation.errors[-1]
    there = 1e3 * best.frames.registration.apply(
        np.array([measurement.coil for measurement in validation.poses.measurements])
    )
    figure = Figure(figsize=(style.WIDTH, 3.4))
    for axes, (across, up) in zip(figure.subplots(1, 2), ((0, 2), (1, 2)), strict=True):
        axes.plot(there[:, across], there[:, up], ".", color=style.BLUE, markersize=3.0)
        axes.quiver(
            there[:, across], there[:, up], LONGER * errors[:, across], LONGER * errors[:, up], angles="xy",
            scale_units="xy", scale=1.0, width=0.003, color=style.VERMILLION,
        )  # fmt: skip
        ends = there + LONGER * errors
        axes.plot(ends[:, across], ends[:, up], linewidth=0)  # so that no arrow leaves the picture
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel(f"{style.AXES[across]} [mm]")
        axes.set_ylabel(f"{style.AXES[up]} [mm]")
    text = f"Measured points in the robot's frame; arrows: measured minus model, {LONGER:g} times as long."
    return Drawn("places", "Where the errors are", text, text, figure)
