"""Any experiment: where the tip went, how far off, under which force, by which joints."""

from collections.abc import Iterator

import numpy as np

from station.report import style
from station.report.drawn import Drawn
from station.report.force import force
from station.report.run import Case, Run
from station.report.tracking import tracking_error


def draw(run: Run) -> Iterator[Drawn]:
    """Four figures for each case."""
    for case in run.cases:
        yield _path(case)
        if not case.sweeps:
            yield tracking_error(run, case, f"error_{case.name}", "Tracking error")
        yield force(case, f"force_{case.name}", "Estimated force at the tip")
        yield joints(case)


def _path(case: Case) -> Drawn:
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
    words = f"The tip travelled {' / '.join(f'{value:.1f}' for value in travel)} mm in x / y / z."
    return Drawn(
        f"path_{case.name}", f"Position of the tip{case.words}",
        f"In the frame of the front plate. {words}", f"Tip position in x, y and z over time. {words}", figure,
    )  # fmt: skip


def joints(case: Case) -> Drawn:
    """Positions of all joints, rotations in degrees and translations in millimetres."""
    names, positions = case.names("joints"), case.of("joints")
    units = [channel.unit for channel in case.channels if channel.name.startswith("joints.")]
    scales = [(180.0 / np.pi, "deg") if unit == "rad" else (1e3, "mm") for unit in units]
    labels = [f"{name.replace('_', chr(10))} [{unit}]" for name, (_, unit) in zip(names, scales, strict=True)]
    figure, axes = style.stacked(labels, height=1.1)
    look = style.Look("", style.BLUE)
    for column, (each, (scale, _)) in enumerate(zip(axes, scales, strict=True)):
        style.draw(each, case.time, scale * positions[:, column], look, label=False)
    return Drawn(
        f"joints_{case.name}", f"Joints{case.words}", "As the stages count them.",
        f"Positions of {', '.join(names)} over time.", figure,
    )  # fmt: skip
