"""Figures of the tip: position and error of the tip over time, like the paper's Figs. 3, 6, 7, 8 and 10."""

from collections.abc import Iterator

import numpy as np

from core.control.step import MAX_CLEARANCE_M
from core.robot.robot import Array
from station.config.controllers import PERIOD_S
from station.experiments.results import AVERAGING_TICKS, averaged_model
from station.report import style
from station.report.document import ReportFigure
from station.report.load_figures import force
from station.report.run import RecordedCase, RecordedRun

STRATEGY_TITLES = {
    "a": "(a) unloaded Jacobian",
    "b": "(b) loaded Jacobian",
    "c": "(c) inner loop: J(q, 0) and deflection rate, eq. (24)",
    "d": "(d) dual layer",
    "d_feedforward": "(d) with feed-forward",
}
TRACKING_TITLES = {
    "fig7": "Fig. 7: regulation with the unloaded inverse Jacobian",
    "fig8": "Fig. 8: regulation with the dual-layer controller",
    "fig10": "Fig. 10: tracking error with the dual-layer controller",
}
MODELS = (("loaded", "tip_estimated", style.LOADED), ("unloaded", "tip_unloaded", style.UNLOADED))
#: Time over which the drawn distance between tip and model is averaged [s].
AVERAGING_TIME_S = 0.5
TARGET_STYLE = style.LineStyle("target and offset, true", style.GREEN, (0.0, (5.0, 2.0)), 1.3)
SETPOINT_STYLE = style.LineStyle("setpoint", style.BLUE, (0.0, (1.0, 1.2)), 1.1)
FORCE_STYLES = (
    style.LineStyle("estimated $F_x$", style.VERMILLION, "-", 1.2),
    style.LineStyle("estimated $F_y$", style.GREEN, (0.0, (5.0, 1.5)), 1.2),
    style.LineStyle("estimated $F_z$", style.BLUE, (0.0, (1.0, 1.2)), 1.2),
)
POSITION_LABELS = [f"$X_{axis}$ [mm]" for axis in style.AXES]
ERROR_LABELS = [f"$E_{axis}$ [mm]" for axis in style.AXES]


#: Resolution of a recorded clearance, rounded up [mm].
RESOLUTION_MM = 0.01


def tracking(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield a figure like the paper's Figs. 7, 8 and 10 for each case: tip error per axis, and force.

    The case of the paper comes first.
    """
    for number, case in enumerate(run.cases):
        if number == 0:
            yield tracking_error(run, case, run.experiment, TRACKING_TITLES[run.experiment])
        else:
            yield tracking_error(run, case, f"{run.experiment}_{case.name}", "Tracking error")


def tracking_error(run: RecordedRun, case: RecordedCase, name: str, title: str) -> ReportFigure:
    """Return the figure with tip error and force of one case."""
    figure, axes = style.stacked([*ERROR_LABELS, "$F$ [N]"], height=1.2)
    paper = run.paper(case.name, "max_abs_error_mm")
    at, measured = case.measured_error()
    style.draw_components(axes, at, measured, style.MEASURED)
    if case.truth_known:
        style.draw_components(axes, case.time, case.true_error(), style.TRUE)
    for axis, each in zip(style.AXES, axes[:3], strict=True):
        if axis in paper:
            style.bound(each, paper[axis])
        if case.counted_from > 0.0:
            each.axvspan(0.0, case.counted_from, color=style.GREY, alpha=0.10, linewidth=0.0)
    unknown = case.force_unknown
    for axis, component, line in zip(style.AXES, case.of("force_filtered").T, FORCE_STYLES, strict=True):
        if axis not in unknown:
            style.draw(axes[3], case.time, component, line)
    # The scale ignores a short large error in the first seconds, which would compress the rest.
    keys = {"measured": "max_abs_error_mm", "true": "true_max_abs_error_mm"}
    counted = {kind: case.errors[key] for kind, key in keys.items() if key in case.errors}
    for column, (axis, each) in enumerate(zip(style.AXES, axes[:3], strict=True)):
        reach = max([part[column] for part in counted.values()] + [paper.get(axis, 0.0)])
        if reach > 0.0:
            each.set_ylim(-1.15 * reach, 1.15 * reach)
    style.legend(figure, axes, columns=3)
    parts = [f"{kind} {style.slashed(error)} mm" for kind, error in counted.items()]
    largest = f"Largest error in x / y / z: {', '.join(parts)}." if parts else "The run ended before errors counted."
    notes = (
        f" Grey: the first {case.counted_from:g} s, in which errors do not count." if case.counted_from > 0.0 else ""
    )
    notes += " Dotted: the largest error in the paper, if it has one." if paper else ""
    notes += f" The force along {', '.join(unknown)} is unknown and not drawn." if unknown else ""
    true = " and, for a simulated bench, minus true" if case.truth_known else ""
    return ReportFigure(
        name, f"{title}{case.title_suffix}",
        f"Desired minus measured{true} position of the tip; below, the estimated force.{notes} {largest}",
        f"Error in x, y and z over time, and force. {largest}",
        figure,
    )  # fmt: skip


def strategies(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield tip positions as in the paper's Fig. 3, and tip errors, where strategies (c) and (d) differ visibly."""
    if not run.cases:
        return
    lines = [style.series(number, STRATEGY_TITLES.get(case.name, case.name)) for number, case in enumerate(run.cases)]
    figure, axes = style.stacked(POSITION_LABELS)
    first = run.cases[0]
    start = first.of("tip_desired")[0]
    for case, line in zip(run.cases, lines, strict=True):
        style.draw_components(axes, case.time, 1e3 * (case.of("tip_true") - start), line)
    style.draw_components(axes, first.time, 1e3 * (first.of("tip_desired") - start), style.DESIRED)
    style.legend(figure, axes[:1], columns=3)
    largest = "; ".join(
        f"{case.name}: {x:.2f}, {y:.2f}, {z:.2f} mm"
        for case in run.cases
        for x, y, z in [np.abs(case.true_error()).max(axis=0)]
    )
    yield ReportFigure(
        "fig3", "Fig. 3: tip position under four strategies",
        "Position of the simulated rod's tip from its start, per axis, as in the paper's Fig. 3. (d) is also shown"
        " with the velocity of the path fed forward.",
        f"Tip position in x, y and z over time for each strategy. Largest errors in x, y, z: {largest}.",
        figure,
    )  # fmt: skip

    figure, axes = style.stacked(ERROR_LABELS)
    for case, line in zip(run.cases, lines, strict=True):
        style.draw_components(axes, case.time, case.true_error(), line)
    for each in axes:
        # A symmetric logarithmic axis shows both drifts of millimetres and errors of hundredths of a millimetre.
        each.set_yscale("symlog", linthresh=0.05, linscale=0.6)
        each.set_yticks([-10, -1, -0.1, 0, 0.1, 1, 10], ["-10", "-1", "-0.1", "0", "0.1", "1", "10"])
    style.legend(figure, axes[:1], columns=3)
    yield ReportFigure(
        "fig3_errors", "Errors of the four strategies",
        "Desired minus true position of the tip. Linear within 0.05 mm, logarithmic beyond.",
        f"Tip error in x, y and z over time for each strategy. Largest errors in x, y, z: {largest}.",
        figure,
    )  # fmt: skip


def models(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield figures like the paper's Fig. 6: measured tip, tips of both models per axis, and distance of each model.

    In the experiment of this figure the outer tube rotates.
    """
    for case in run.cases:
        at, measured = case.measured_tip()
        tips = {name: _model_tip(case, group, at) for name, group, _ in MODELS}
        counted = case.time[case.of("tip_new")[:, 0] > 0.0] >= case.counted_from - 1e-9
        if not counted.any():
            continue  # the run ended before the time from which errors count
        figure, axes = style.stacked([*POSITION_LABELS, "distance [mm]"], height=1.3)
        style.draw_components(axes, at, measured, style.MEASURED._replace(width=2.4, alpha=0.6))
        errors = {}
        for name, _, line in MODELS:
            style.draw_components(axes, at, tips[name], line)
            distance = np.linalg.norm(tips[name] - measured, axis=1)
            style.draw(axes[3], *style.averaged(at, distance, AVERAGING_TIME_S), line)
            errors[name] = float(distance[counted].mean())
        axes[3].set_ylim(bottom=0.0)
        style.legend(figure, axes[:1])
        text = f"mean distance: loaded model {errors['loaded']:.2f} mm, unloaded model {errors['unloaded']:.2f} mm"
        yield ReportFigure(
            "fig6" if len(run.cases) == 1 else f"fig6_{case.name}", "Fig. 6: model against measurement",
            "Measured tip and the tips of both models at the measured joints, per axis, and their distances."
            f" The models are means over {AVERAGING_TICKS * PERIOD_S:.1f} s, because the noise of one force sample"
            f" moves the loaded model by a millimetre. From {case.counted_from:g} s on, {text}."
            " The paper gives mean squared errors in mm; here it is the mean distance.",
            f"Tip position in x, y and z over time, measured and by both models; {text}.",
            figure,
        )  # fmt: skip


def _model_tip(case: RecordedCase, group: str, at: Array) -> Array:
    """Return the averaged tip of a model (f, 3) [mm] at times (f,) [s]."""
    model = averaged_model(case.of(group), max(1, AVERAGING_TICKS // case.stride))
    return 1e3 * np.stack([np.interp(at, case.time, column) for column in model.T], axis=1)


def follow(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield a figure for each case with a target, and a figure that compares the errors of these cases."""
    cases = [case for case in run.cases if case.follows and case.truth_known]
    for case in cases:
        yield _target(case)
    if len(cases) > 1:
        yield _target_errors(cases)


def _target(case: RecordedCase) -> ReportFigure:
    """Return a figure with tip and target by axis, relative to the target's mean, and the error as a distance."""
    figure, axes = style.stacked([*POSITION_LABELS, "error [mm]"], height=1.2)
    desired, tip, setpoint = 1e3 * case.desired_tip(), 1e3 * case.of("tip_true"), 1e3 * case.of("tip_desired")
    middle = desired.mean(axis=0)
    for positions, line in ((tip, style.TRUE), (desired, TARGET_STYLE), (setpoint, SETPOINT_STYLE)):
        style.draw_components(axes, case.time, positions - middle, line)
    error = np.linalg.norm(desired - tip, axis=1)
    style.draw(axes[3], case.time, error, style.TRUE, label=False)
    before, after = _largest(case, error)
    axes[3].set_ylim(0.0, 1.15 * max(after, 0.1))
    for each in axes:
        each.axvspan(0.0, case.settled_from, color=style.GREY, alpha=0.10, linewidth=0.0)
    style.legend(figure, axes[:1])
    errors = (
        f"Largest true error: {before:.2f} mm in the first {case.settled_from:g} s (grey), while the frequencies are"
        f" estimated and the load is applied; {after:.2f} mm after that."
    )
    return ReportFigure(
        f"follow_{case.name}", f"Following a target (case '{case.name}')",
        f"Tip of the simulated plant, simulated target with the offset at the start, and setpoint, each relative to the"
        f" target's mean. Below: distance between tip and target with offset. {errors}",
        f"Tip and target in x, y and z over time, and the error. {errors}", figure,
    )  # fmt: skip


def _target_errors(cases: list[RecordedCase]) -> ReportFigure:
    figure, (axes,) = style.stacked(["error [mm]"], height=2.4)
    errors: list[str] = []
    for number, case in enumerate(cases):
        error = 1e3 * np.linalg.norm(case.desired_tip() - case.of("tip_true"), axis=1)
        style.draw(axes, case.time, error, style.series(number, case.name.replace("_", " ")))
        errors.append(f"{case.name} {_largest(case, error)[1]:.2f} mm")
    axes.set_yscale("log")
    axes.set_ylim(bottom=0.02)
    style.legend(figure, [axes], columns=2)
    caption = f"Largest true error after the settling time: {', '.join(errors)}."
    return ReportFigure(
        "follow_errors", "Errors with and without prediction", caption, f"Errors over time. {caption}", figure
    )


def _largest(case: RecordedCase, error: Array) -> tuple[float, float]:
    """Return the largest tip error of a case before and after the settling time [mm]."""
    settled = case.time >= case.settled_from - 1e-9
    before, after = error[~settled], error[settled]
    return float(before.max(initial=0.0)), float(after.max(initial=0.0))


def overview(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield four figures for each case of any experiment: tip position, tip error, force and joint positions."""
    for case in run.cases:
        yield _path(case)
        if not case.sweeps:
            yield tracking_error(run, case, f"error_{case.name}", "Tracking error")
        yield force(case, f"force_{case.name}", "Estimated force at the tip")
        yield _joints(case)
        yield from _clearance(case)


def _clearance(case: RecordedCase) -> Iterator[ReportFigure]:
    """Yield the clearance of the tubes from the nearest region; nothing if no region was nearer than 100 mm."""
    clearance = 1e3 * case.of("clearance")[:, 0]
    if clearance.min() >= 1e3 * MAX_CLEARANCE_M - RESOLUTION_MM:
        return
    figure, axes = style.stacked(["clearance [mm]"], height=1.8)
    style.draw_components(axes, case.time, clearance[:, None], style.LOADED)
    axes[0].axhline(0.0, color="black", linewidth=0.8)
    smallest = f"Smallest {clearance.min():.2f} mm at {case.time[clearance.argmin()]:.2f} s."
    yield ReportFigure(
        f"clearance_{case.name}", f"Clearance from regions{case.title_suffix}",
        f"Distance of the tubes from the nearest region minus its margin, by the loaded model that is bent to the"
        f" observed tip. {smallest}", f"Clearance over time. {smallest}", figure,
    )  # fmt: skip


def _path(case: RecordedCase) -> ReportFigure:
    figure, axes = style.stacked(POSITION_LABELS)
    at, measured = case.measured_tip()
    style.draw_components(axes, at, measured, style.MEASURED._replace(width=2.0, alpha=0.7))
    if case.truth_known:
        style.draw_components(axes, case.time, 1e3 * case.of("tip_true"), style.TRUE)
    if not case.sweeps:
        style.draw_components(axes, case.time, 1e3 * case.of("tip_desired"), style.DESIRED)
    style.legend(figure, axes[:1])
    travel = np.ptp(measured, axis=0) if len(measured) else np.zeros(3)
    travelled = f"The tip travelled {style.slashed(travel, '.1f')} mm in x / y / z."
    return ReportFigure(
        f"path_{case.name}", f"Position of the tip{case.title_suffix}",
        f"In the frame of the front plate. {travelled}", f"Tip position in x, y and z over time. {travelled}", figure,
    )  # fmt: skip


def _joints(case: RecordedCase) -> ReportFigure:
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
