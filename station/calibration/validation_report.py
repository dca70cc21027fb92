"""Writes the report of a validation as one self-contained HTML file: errors, distribution, fitted parameters."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes

from core.calibration.external_poses import ErrorStatistics
from core.robot.robot import Array
from station.calibration.findings import findings, undetermined_parameters
from station.calibration.poses import RejectedPose
from station.calibration.report import explained, intervals
from station.calibration.summary import FOUND_HEAD
from station.calibration.validation import EXTENT_LABELS, ErrorBin, Validation, by_direction, by_joint, found_rows
from station.report import document, style
from station.report.document import ReportFigure

#: Magnification of the errors in the figure of the positions.
ERROR_SCALE = 10.0
#: Largest number of left-out rows that the report lists.
MAX_LISTED_ROWS = 200
#: Heads of the table of errors, after the first column.
ERROR_HEAD = ("at", "poses", "mean", "median", "95 %", "largest")
MOTION_DIRECTIONS = ((1.0, "rising", 0), (-1.0, "falling", 2), (0.0, "not moved before", 3))


def page_parts(title: str, validation: Validation, facts: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Yield the HTML elements of the page; `facts` are names and values for its top."""
    best = validation.best
    yield from document.page_head(title)
    yield document.table(("", ""), facts, texts=2)
    yield document.heading("Errors")
    yield document.paragraph(
        "Distance of the measured point from the model's point [mm]. Frames: a rigid motion and a constant offset of"
        " the point in the frame of the tip. Tubes: the same and the uncertain parameters of the tubes. Friction: the"
        " same and the lag of each tube's rotation, which depends on the order of the motions. Residual: tubes, and a"
        " learned function of joints, last motions and load."
    )
    yield document.table(("", *ERROR_HEAD), error_rows(validation), texts=2)
    yield document.heading("Findings")
    for sentence in findings(validation):
        yield document.paragraph(sentence)
    if best.fit is not None:
        yield document.heading("Results")
        yield document.table(FOUND_HEAD, found_rows(validation))
        undetermined = [(text,) for text in undetermined_parameters(best)]
        yield from document.section("Parameters that the data do not determine", "", ("",), undetermined, texts=1)
    for figure in _figures(validation):
        yield document.picture(figure, f"measured poses of '{validation.robot.name}'")
    for heading, bins in (
        ("Errors by joint", by_joint(validation)),
        ("Errors by direction of travel", by_direction(validation)),
    ):
        note = "In millimetres; the last columns are the mean error along x, y, z of the robot's frame."
        head = ("joint", "where", "poses", "mean", "95 %", "largest", "x", "y", "z")
        yield from document.section(heading, note, head, [_bin_row(each) for each in bins])
        if not bins:
            yield document.heading(heading)
            yield document.paragraph(
                "No joint moved." if validation.poses.timed else "The order of the poses is unknown."
            )
    for poses in (validation.poses, validation.test):
        if poses is not None:
            heading = f"Rows of {poses.path.name} that were left out"
            yield from document.section(heading, "", ("line", "why"), _left_rows(poses.left_out))


def error_rows(validation: Validation) -> list[tuple[str, ...]]:
    """Return rows of fitted parameters, poses, number of poses, mean, median, 95 %, largest error [mm]."""
    found: list[tuple[str, ...]] = []
    for each, errors in zip(validation.matches, validation.errors, strict=True):
        found.append((EXTENT_LABELS[each.extent], "these poses", *_cells(ErrorStatistics.of(errors))))
        for held_out in validation.held_out:
            if held_out.extent == each.extent and validation.test is None:
                found.append((EXTENT_LABELS[each.extent], validation.parts[0], *_cells(held_out.fitted)))
                found.append((EXTENT_LABELS[each.extent], validation.parts[1], *_cells(held_out.tested)))
            elif held_out.extent == each.extent and validation.test is not None:
                found.append((EXTENT_LABELS[each.extent], validation.test.path.name, *_cells(held_out.tested)))
    return found


def _cells(spread: ErrorStatistics) -> tuple[str, ...]:
    return (str(spread.poses), *(f"{1e3 * value:.3f}" for value in spread[1:]))


def _bin_row(each: ErrorBin) -> tuple[str, ...]:
    lengths = (each.spread.mean, each.spread.p95, each.spread.largest, *each.along)
    return (each.joint, each.where, str(each.spread.poses), *(f"{1e3 * value:.3f}" for value in lengths))


def _left_rows(left: Sequence[RejectedPose]) -> list[tuple[str, str]]:
    rows = [(str(each.line), each.reason) for each in left[:MAX_LISTED_ROWS]]
    return [*rows, ("...", f"and {len(left) - MAX_LISTED_ROWS} more")] if len(left) > MAX_LISTED_ROWS else rows


def _figures(validation: Validation) -> Iterator[ReportFigure]:
    yield _shares(validation)
    if moving := [k for k, travel in enumerate(np.ptp(_joints(validation), axis=0)) if travel > 0.0]:
        yield _over_joints(validation, moving)
    yield _over_poses(validation)
    yield _positions(validation)
    if validation.known is not None and validation.best.learned is not None:
        yield explained(validation.known)
    best = validation.best
    if best.extent in ("tubes", "friction", "residual") and best.fit is not None and best.requested.quantities:
        yield intervals(best.fit, len(best.requested.quantities))


def _joints(validation: Validation) -> Array:
    """Return the joint positions of all poses (k, n)."""
    return np.array([measurement.joints for measurement in validation.poses.measurements])


def _lengths(errors: Array) -> Array:
    lengths = 1e3 * np.linalg.norm(errors, axis=1)
    return lengths[np.isfinite(lengths)]


def _shares(validation: Validation) -> ReportFigure:
    """Return the figure of the cumulative distribution of the errors."""
    figure = style.blank(2.8)
    axes = figure.subplots()
    medians: list[str] = []
    for number, (each, errors) in enumerate(zip(validation.matches, validation.errors, strict=True)):
        lengths = np.sort(_lengths(errors))
        if not lengths.size:
            continue
        line = style.series(number, EXTENT_LABELS[each.extent])
        part = 100.0 * np.arange(1, len(lengths) + 1) / len(lengths)
        axes.plot(lengths, part, color=line.colour, linestyle=line.dash, linewidth=line.width, label=line.label)
        medians.append(f"{line.label}: half of the poses within {np.median(lengths):.3g} mm")
    axes.set_xscale("log")
    axes.set_xlabel("distance of the measured point from the model's [mm]")
    axes.set_ylabel("poses [%]")
    style.legend(figure, [axes])
    text = "; ".join(medians)
    return ReportFigure("shares", "Distribution of the errors", f"{text}.", text, figure)


def _over_joints(validation: Validation, moving: Sequence[int]) -> ReportFigure:
    """Return the figure of the error of every pose, with a panel for each of the `moving` joints."""
    joints, lengths = _joints(validation), 1e3 * np.linalg.norm(validation.errors[-1], axis=1)
    figure = style.blank(0.8 + 1.7 * len(moving))
    grid = figure.subplots(len(moving), 1, squeeze=False)
    panels: list[Axes] = [row[0] for row in grid]
    for axes, k in zip(panels, moving, strict=True):
        joint = validation.robot.joints[k]
        factor, unit = (180.0 / np.pi, "deg") if joint.unit == "rad" else (1e3, "mm")
        for direction, label, number in MOTION_DIRECTIONS if validation.poses.timed else ((None, "pose", 2),):
            these = np.ones(len(joints), bool)
            if direction is not None:
                these = np.array([measurement.came for measurement in validation.poses.measurements])[:, k] == direction
            if these.any():
                line = style.series(number, label)
                axes.plot(
                    factor * joints[these, k], lengths[these], "osD"[number % 3], color=line.colour, markersize=2.6,
                    alpha=0.7, linewidth=0, label=label,
                )  # fmt: skip
        axes.set_xlabel(f"{joint.name} [{unit}]")
        axes.set_ylabel("error [mm]")
        axes.set_ylim(bottom=0.0)
    style.legend(figure, panels)
    names = ", ".join(validation.robot.joints[k].name for k in moving)
    return ReportFigure(
        "over_joints", f"Errors over the joints ({EXTENT_LABELS[validation.best.extent]})",
        "Each point is a pose; its marker is the joint's direction of arrival.", f"Errors over {names}.", figure,
    )  # fmt: skip


def _over_poses(validation: Validation) -> ReportFigure:
    """Return the figure of the error's components in the order of the poses."""
    errors = 1e3 * validation.errors[-1]
    figure, panels = style.stacked([f"{axis} [mm]" for axis in style.AXES], height=1.0, across="pose")
    line = style.series(2, "")
    for column, axes in enumerate(panels):
        axes.plot(np.arange(1, len(errors) + 1), errors[:, column], ".", color=line.colour, markersize=3.0)
        axes.axhline(0.0, color=style.GREY, linewidth=0.7)
    rms = style.slashed(np.sqrt(np.nanmean(errors**2, axis=0)), ".3f")
    order = "in the order of their times" if validation.poses.timed else "in the order of the file"
    text = f"Measured minus model along x / y / z of the robot's frame, poses {order}: {rms} mm RMS."
    return ReportFigure("over_poses", "Errors pose by pose", text, text, figure)


def _positions(validation: Validation) -> ReportFigure:
    """Return the figure of the measured points from two sides, with magnified errors."""
    best, errors = validation.best, 1e3 * validation.errors[-1]
    points = 1e3 * best.frames.registration.apply(
        np.array([measurement.coil for measurement in validation.poses.measurements])
    )
    figure = style.blank(3.4)
    for axes, (across, up) in zip(figure.subplots(1, 2), ((0, 2), (1, 2)), strict=True):
        axes.plot(points[:, across], points[:, up], ".", color=style.BLUE, markersize=3.0)
        axes.quiver(
            points[:, across], points[:, up], ERROR_SCALE * errors[:, across], ERROR_SCALE * errors[:, up], angles="xy",
            scale_units="xy", scale=1.0, width=0.003, color=style.VERMILLION,
        )  # fmt: skip
        ends = points + ERROR_SCALE * errors
        axes.plot(ends[:, across], ends[:, up], linewidth=0)  # keeps the arrows inside the axes
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel(f"{style.AXES[across]} [mm]")
        axes.set_ylabel(f"{style.AXES[up]} [mm]")
    text = f"Measured points in the robot's frame; arrows: measured minus model, {ERROR_SCALE:g} times as long."
    return ReportFigure("places", "Errors at their positions", text, text, figure)
