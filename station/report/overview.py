"""Figures for an experiment without special figures: tip position, tip error, force and joint positions."""

from collections.abc import Iterator

import numpy as np

from station.report import style
from station.report.figure import ReportFigure
from station.report.force import force
from station.report.run import RecordedCase, RecordedRun
from station.report.tracking import tracking_error


def draw(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield four figures for each case: tip position, tip error, force and joint positions."""
    for case in run.cases:
        yield _path(case)
        if not case.sweeps:
            yield tracking_error(run, case, f"error_{case.name}", "Tracking error")
        yield force(case, f"force_{case.name}", "Estimated force at the tip")
        yield joints(case)


def _path(case: RecordedCase) -> ReportFigure:
    figure, axes = style.stacked([f"$X_{axis}$ [mm]" for axis in style.AXES])
    new = case.of("tip_new")[:, 0] > 0.0
    at, measured = case.of("tip_time")[new, 0], 1e3 * case.of("tip_measured")[new]
    for column, each in enumerate(axes):
        style.draw(each, at, measured[:, column], style.MEASURED._replace(width=2.0, alpha=0.7))
        if case.truth_known:
            style.draw(each, case.time, 1e3 * case.of("tip_true")[:, column], style.TRUE)
        if not case.sweeps:
            style.draw(each, case.time, 1e3 * case.of("tip_desired")[:, column], style.DESIRED)
    style.legend(figure, axes[:1])
    travel = np.ptp(measured, axis=0) if len(measured) else np.zeros(3)
    travelled = f"The tip travelled {' / '.join(f'{value:.1f}' for value in travel)} mm in x / y / z."
    return ReportFigure(
        f"path_{case.name}", f"Position of the tip{case.title_suffix}",
        f"In the frame of the front plate. {travelled}", f"Tip position in x, y and z over time. {travelled}", figure,
    )  # fmt: skip


def joints(case: RecordedCase) -> ReportFigure:
    """Return a figure of all joint positions, rotations in degrees and translations in millimetres."""
    names, positions = case.names("joints"), case.of("joints")
    units = [channel.unit for channel in case.channels if channel.name.startswith("joints.")]
    scales = [(180.0 / np.pi, "deg") if unit == "rad" else (1e3, "mm") for unit in units]
    labels = [f"{name.replace('_', chr(10))} [{unit}]" for name, (_, unit) in zip(names, scales, strict=True)]
    figure, axes = style.stacked(labels, height=1.1)
    line = style.LineStyle("", style.BLUE)
    for column, (each, (scale, _)) in enumerate(zip(axes, scales, strict=True)):
        style.draw(each, case.time, scale * positions[:, column], line, label=False)
    return ReportFigure(
        f"joints_{case.name}", f"Joints{case.title_suffix}", "Positions as counted by the stages.",
        f"Positions of {', '.join(names)} over time.", figure,
    )  # fmt: skip
