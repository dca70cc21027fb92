"""Writes the report of a calibration as one self-contained HTML file."""

from collections.abc import Iterator, Sequence

import numpy as np

from core.calibration.fit import Fit
from core.calibration.residual import PoseErrors, predicted_by_others
from core.robot.robot import Array
from station.calibration.plan import PlanSubject
from station.calibration.procedures import ForceResult, TrackerResult, TubesResult
from station.calibration.summary import FOUND_HEAD, Result, findings, rows
from station.report import document, style
from station.report.document import ReportFigure

TITLES = {
    "axes": "Axes: signs and zeros",
    "latency": "Latency of the tracker",
    "tracker": "Registration of the tracker",
    "force": "Base force sensors",
    "tubes": "Tubes, frames and sensors together",
    "residual": "Tubes, frames and sensors, and the residual of the model",
}


def page_parts(
    what: str, result: Result, subject: PlanSubject, facts: Sequence[tuple[str, str]], *, simulated: bool
) -> Iterator[str]:
    """Yield the HTML elements of the page of the procedure `what`; `facts` are names and values for its top.

    The page and every figure state whether robot and devices were `simulated`.
    """
    note = "Everything here comes from simulated devices of the virtual lab." if simulated else ""
    yield from document.page_head(TITLES[what], note=note)
    yield document.table(("", ""), facts, texts=2)
    yield document.heading("Findings")
    for sentence in findings(result):
        yield document.paragraph(sentence)
    yield document.heading("Results")
    yield document.table(FOUND_HEAD, rows(result, subject))
    for figure in _figures(result):
        yield document.picture(figure, "simulated bench" if simulated else f"bench of '{subject.robot.name}'")


def _figures(result: Result) -> Iterator[ReportFigure]:
    if isinstance(result, TubesResult):
        yield _held_out(result)
        yield _errors(result.calibration.errors, "after the calibration")
        yield intervals(result.calibration.fit, len(result.calibration.what))
        if result.poses is not None:
            yield explained(result.poses)
    elif isinstance(result, TrackerResult):
        yield _errors(result.registration.errors, "after the registration")
    elif isinstance(result, ForceResult):
        yield _errors(result.registration.errors, "of the registration that determined the tip's position")


def _held_out(result: TubesResult) -> ReportFigure:
    loaded = result.held_out_loaded
    groups = (
        ("assumed before", result.held_out_believed),
        ("described tubes, best frames", loaded.before),
        ("calibrated", loaded.after),
    )
    figure = style.blank(2.6)
    axes = figure.subplots()
    for number, (label, errors) in enumerate(groups):
        line = style.series(number, label)
        spread = np.linspace(-0.12, 0.12, len(errors))
        axes.plot(number + spread, 1e3 * errors, "osD"[number], color=line.colour, markersize=4.5)
        axes.plot([number - 0.2, number + 0.2], [1e3 * errors.mean()] * 2, color=style.BLACK, linewidth=1.6)
        axes.annotate(f"{1e3 * errors.mean():.3g} mm", (number + 0.22, 1e3 * errors.mean()), va="center")
    axes.set_yscale("log")
    axes.set_xticks(range(len(groups)), [label for label, _ in groups])
    axes.set_xlim(-0.5, len(groups) - 0.3)
    axes.set_ylabel("distance model - coil [mm]")
    means = ", ".join(f"{label} {1e3 * errors.mean():.3g} mm" for label, errors in groups)
    caption = "Each point is a measurement; the line is the mean."
    return ReportFigure("held_out", "Loaded measurements held out of the fits", caption, means, figure)


def _errors(errors: Array, when: str) -> ReportFigure:
    figure = style.blank(2.2)
    axes = figure.subplots()
    line = style.series(2, "")
    axes.bar(np.arange(1, len(errors) + 1), 1e3 * errors, color=line.colour, width=0.7)
    axes.set_xlabel("measurement")
    axes.set_ylabel("distance model - coil [mm]")
    rms = 1e3 * float(np.sqrt(np.mean(errors**2)))
    text = f"{len(errors)} measurements, {rms:.3g} mm RMS, {1e3 * errors.max():.3g} mm at most."
    return ReportFigure("errors", f"Residuals {when}", text, text, figure)


def explained(poses: PoseErrors) -> ReportFigure:
    """Return the figure of what a residual explains: each error plotted over its prediction from other trajectories."""
    poses = poses.usable
    guess = predicted_by_others(poses, poses.folds())
    figure = style.blank(2.6)
    for number, (axes, name) in enumerate(zip(figure.subplots(1, 3), style.AXES, strict=True)):
        axes.plot(1e3 * guess[:, number], 1e3 * poses.errors[:, number], ".", color=style.BLUE, markersize=3.0)
        axes.axline((0.0, 0.0), slope=1.0, color=style.GREY, linewidth=0.7)
        axes.set_xlabel(f"{name} predicted [mm]")
    figure.axes[0].set_ylabel("error of the model [mm]")
    before, after = (1e3 * float(np.linalg.norm(each, axis=1).mean()) for each in (poses.errors, poses.errors - guess))
    text = f"Mean error {before:.3g} mm without and {after:.3g} mm with the prediction from other trajectories."
    return ReportFigure("explained", "What the residual explains", text, text, figure)


def intervals(fit: Fit, count: int) -> ReportFigure:
    """Return the figure of the first `count` parameters, which are those of the tubes, in units of their priors."""
    figure = style.blank(0.8 + 0.27 * count)
    axes = figure.subplots()
    names = [parameter.name.replace("_", " ") for parameter in fit.parameters[:count]]
    sizes = np.array([parameter.prior for parameter in fit.parameters[:count]])
    values, halves = fit.values[:count] / sizes, 1.96 * fit.errors[:count] / sizes
    heights = np.arange(count)[::-1]
    axes.axvspan(-1.0, 1.0, color="#eef1f3", zorder=0)
    axes.errorbar(values, heights, xerr=halves, fmt="o", color=style.BLUE, markersize=4, capsize=3, linewidth=1.2)
    axes.set_yticks(heights, names)
    axes.set_xlabel("change from the description, in standard deviations of the prior")
    caption = "Bars: 95 %. Grey: one standard deviation of the prior. A bar as wide as the grey was not measured."
    alt = "; ".join(f"{n} {v:+.2f} +- {h:.2f}" for n, v, h in zip(names, values, halves, strict=True))
    return ReportFigure("intervals", "Fitted parameters of the tubes", caption, alt, figure)
