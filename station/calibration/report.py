"""The report of a calibration: one HTML file with everything in it."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from core.calibration.fit import Fit
from core.robot.robot import Array
from station.calibration.folder import REPORT
from station.calibration.plan import Subject
from station.calibration.procedures import ForceResult, TrackerResult, TubesResult
from station.calibration.summary import Result, findings, rows
from station.report import document, rendered, style
from station.report.drawn import Drawn

TITLES = {
    "axes": "Axes: signs and zeros",
    "latency": "Latency of the tracker",
    "tracker": "Registration of the tracker",
    "force": "Base force sensors",
    "tubes": "Tubes, frames and sensors together",
}


def write_report(
    folder: Path, what: str, result: Result, subject: Subject, facts: Sequence[tuple[str, str]], *, simulated: bool
) -> Path:
    """report.html in `folder`.

    Args:
        folder: there already.
        what: procedure.
        result: of it.
        subject: as it was believed to be.
        facts: name and value of what belongs at the top.
        simulated: robot and devices were a virtual lab's; the page and every figure say so.

    Raises:
        OSError: the folder does not take it.
    """
    with matplotlib.rc_context(style.SETTINGS):
        page = document.document(f"{TITLES[what]}: calibration", _parts(what, result, subject, facts, simulated))
    path = folder / REPORT
    path.write_text(page, encoding="utf-8")
    return path


def _parts(
    what: str, result: Result, subject: Subject, facts: Sequence[tuple[str, str]], simulated: bool
) -> Iterator[str]:
    yield f"<h1>{TITLES[what]}</h1>"
    if simulated:
        yield document.paragraph("Everything here comes from simulated devices of the virtual lab.", "note")
    yield document.table(("", ""), facts, texts=2)
    yield document.heading("What to know")
    for sentence in findings(result):
        yield document.paragraph(sentence)
    yield document.heading("What was found")
    listed = [
        (row.name, row.before, row.found, f"+- {row.interval}" if row.interval else "") for row in rows(result, subject)
    ]
    yield document.table(("", "before", "found", "95 %"), listed)
    for drawn in _figures(result):
        style.finish(drawn.figure, "simulated bench" if simulated else f"bench of '{subject.robot.name}'")
        yield document.picture(rendered.data_uri(drawn), drawn.alt, drawn.title, drawn.caption)


def _figures(result: Result) -> Iterator[Drawn]:
    if isinstance(result, TubesResult):
        yield _held_out(result)
        yield _errors(result.calibration.errors, "after the calibration")
        yield intervals(result.calibration.fit, len(result.calibration.what))
    elif isinstance(result, TrackerResult):
        yield _errors(result.registration.errors, "after the registration")
    elif isinstance(result, ForceResult):
        yield _errors(result.registration.errors, "of the registration that the tip's place came from")


def _held_out(result: TubesResult) -> Drawn:
    loaded = result.held_out_loaded
    groups = (
        ("as believed before", result.held_out_believed),
        ("described tubes, best frames", loaded.before),
        ("calibrated", loaded.after),
    )
    figure = Figure(figsize=(style.WIDTH, 2.6))
    axes = figure.subplots()
    for number, (label, errors) in enumerate(groups):
        look = style.series(number, label)
        spread = np.linspace(-0.12, 0.12, len(errors))
        axes.plot(number + spread, 1e3 * errors, "osD"[number], color=look.colour, markersize=4.5)
        axes.plot([number - 0.2, number + 0.2], [1e3 * errors.mean()] * 2, color=style.BLACK, linewidth=1.6)
        axes.annotate(f"{1e3 * errors.mean():.3g} mm", (number + 0.22, 1e3 * errors.mean()), va="center")
    axes.set_yscale("log")
    axes.set_xticks(range(len(groups)), [label for label, _ in groups])
    axes.set_xlim(-0.5, len(groups) - 0.3)
    axes.set_ylabel("distance model - coil [mm]")
    means = ", ".join(f"{label} {1e3 * errors.mean():.3g} mm" for label, errors in groups)
    return Drawn(
        "held_out",
        "Loaded measurements that no fit has seen",
        "Each point a measurement; the line is the mean.",
        means,
        figure,
    )


def _errors(errors: Array, when: str) -> Drawn:
    figure = Figure(figsize=(style.WIDTH, 2.2))
    axes = figure.subplots()
    look = style.series(2, "")
    axes.bar(np.arange(1, len(errors) + 1), 1e3 * errors, color=look.colour, width=0.7)
    axes.set_xlabel("measurement")
    axes.set_ylabel("distance model - coil [mm]")
    rms = 1e3 * float(np.sqrt(np.mean(errors**2)))
    text = f"{len(errors)} measurements, {rms:.3g} mm RMS, {1e3 * errors.max():.3g} mm at most."
    return Drawn("errors", f"Residuals {when}", text, text, figure)


def intervals(fit: Fit, count: int) -> Drawn:
    """The first `count` parameters, those of the tubes, in units of what was known of them beforehand."""
    figure = Figure(figsize=(style.WIDTH, 0.8 + 0.27 * count))
    axes = figure.subplots()
    names = [parameter.name.replace("_", " ") for parameter in fit.parameters[:count]]
    sizes = np.array([parameter.prior for parameter in fit.parameters[:count]])
    values, halves = fit.values[:count] / sizes, 1.96 * fit.errors[:count] / sizes
    places = np.arange(count)[::-1]
    axes.axvspan(-1.0, 1.0, color="#eef1f3", zorder=0)
    axes.errorbar(values, places, xerr=halves, fmt="o", color=style.BLUE, markersize=4, capsize=3, linewidth=1.2)
    axes.set_yticks(places, names)
    axes.set_xlabel("change from the description, in standard deviations of what was known beforehand")
    caption = "Bars: 95 %. Grey: one standard deviation beforehand. A bar as wide as the grey was not measured."
    alt = "; ".join(f"{n} {v:+.2f} +- {h:.2f}" for n, v, h in zip(names, values, halves, strict=True))
    return Drawn("intervals", "What was found about the tubes", caption, alt, figure)
