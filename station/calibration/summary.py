"""Summarises a calibration as numbers and sentences, for report.json, the terminal and the report."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from core.calibration.fit import MAX_OPEN_SHARE, NORMAL_QUANTILE_95, Fit
from core.calibration.force import SensorCalibration, WeightCheck
from core.calibration.measurements import Measurement
from core.calibration.prediction import Frames
from core.calibration.quantities import QUANTITY_PRIORS
from core.calibration.rigid_transform import CoilAxis, vector_from_rotation
from core.calibration.tubes import TubeCalibration
from core.robot.robot import Array, Robot
from station.calibration.commission import AxesResult, LatencyResult
from station.calibration.plan import PlanSubject
from station.calibration.procedures import SUSPICIOUS_CHI_SQUARE, ForceResult, TrackerResult, TubesResult

Result = TrackerResult | ForceResult | TubesResult | AxesResult | LatencyResult
#: Ratio of the error after the calibration to the error before, at held-out poses; above this ratio the findings advise
#: against using the calibration.
MIN_IMPROVEMENT_RATIO = 0.7
MODEL_MISMATCH = (
    "tubes of this model do not describe the robot (friction between stiff tubes, or a wrong description); do not use"
    " robot.toml"
)


#: Column heads of the table of results.
FOUND_HEAD = ("", "before", "found", "+- (95 %)")


class Row(NamedTuple):
    """One result in human-readable form."""

    name: str
    before: str
    found: str
    interval: str  #: half width of the 95 % interval, with the unit


def rows(result: Result, subject: PlanSubject) -> list[Row]:
    """Return the results, one row per number."""
    if isinstance(result, AxesResult):
        names = [joint.name for joint in subject.robot.joints]
        found = [
            Row(f"{n} runs", "+", "?" if s == 0 else "+" if s > 0 else "-", "")
            for n, s in zip(names, result.signs.signs, strict=True)
        ]
        for quantity, angle, half in result.zeros:
            name = f"{subject.robot.tubes[quantity.tube].name} zero angle"
            found.append(Row(name, "0", f"{math.degrees(angle):.2f}", f"{math.degrees(half):.1f} deg"))
        return found
    if isinstance(result, LatencyResult):
        late = result.latency
        return [Row("tracker later than configured", "0", f"{1e3 * late.latency:.1f}", f"{1.96e3 * late.error:.1f} ms")]
    if isinstance(result, TrackerResult):
        return [*frame_rows(result.registration.fit, result.registration.frames), *_axis_rows(result.axis)]
    if isinstance(result, ForceResult):
        return _sensors(result.calibration, subject.robot)
    tubes = result.calibration
    return [
        *tube_rows(tubes, subject.robot),
        *frame_rows(tubes.fit, tubes.frames),
        *_axis_rows(result.axis),
        *([] if result.sensors is None else _sensors(result.sensors, subject.robot)),
    ]


def findings(result: Result) -> list[str]:
    """Return the findings of a result as sentences."""
    if isinstance(result, AxesResult):
        first, second = 1e3 * result.signs.rms, 1e3 * result.signs.next_rms
        sentences = [f"The signs fit with {first:.2f} mm RMS, the next best combination with {second:.2f} mm."]
        if (result.signs.signs == 0.0).any():
            sentences.append(
                "The tip does not show the directions of the axes marked ?, such as the rotation of a nearly straight"
                " tube: check them by eye."
            )
        open_ = NORMAL_QUANTILE_95 * MAX_OPEN_SHARE * QUANTITY_PRIORS["zero_angle"][1]
        if any(half > open_ for _, _, half in result.zeros):
            sentences.append(
                f"The moves do not determine zero angles whose interval exceeds {math.degrees(open_):.0f} deg, such as"
                " that of a nearly straight tube."
            )
        if (result.signs.signs < 0.0).any():
            sentences.append("Invert the axes marked - in the station's file, then repeat this for the zero angles.")
        return sentences
    if isinstance(result, LatencyResult):
        return [
            "The latency counts from the positions that the stages report, so it contains their delay.",
            f"The residual is {1e3 * result.latency.rms:.2f} mm RMS.",
        ]
    if isinstance(result, TrackerResult):
        found = result.registration
        sentences = [
            f"{1e3 * found.rms:.3f} mm RMS between coil and model; {1e3 * float(found.held_out.mean()):.3f} mm mean"
            " at measurements held out of the fit."
        ]
        if found.fit.variance_factor > SUSPICIOUS_CHI_SQUARE:
            sentences.append(
                "This is far more than the noise: the tubes differ from their description; calibrate them."
            )
        return [*sentences, *_axis_sentence(result.axis), *_weak(found.fit)]
    if isinstance(result, ForceResult):
        return [*_checks(result.checks), *_undetermined(result.calibration.fit)]
    loaded = result.held_out_loaded
    useless = float(loaded.after.mean()) > MIN_IMPROVEMENT_RATIO * float(result.held_out_believed.mean())
    return [
        f"Mean error at loaded measurements held out of the fits: {1e3 * float(result.held_out_believed.mean()):.2f} mm"
        f" with the previous parameters, {1e3 * float(loaded.before.mean()):.2f} mm with described tubes and the best"
        f" frames, {1e3 * float(loaded.after.mean()):.3f} mm calibrated.",
        *([f"This is almost no improvement: {MODEL_MISMATCH}."] if useless else []),
        f"{_rms_mm(result.calibration.errors):.3f} mm RMS at the measurements of the fit,"
        f" {result.calibration.fit.variance_factor:.2f} of the variance expected from the noise.",
        *_checks(result.checks),
        *_axis_sentence(result.axis),
        *_weak(result.calibration.fit),
        *([] if result.sensors is None else _undetermined(result.sensors.fit)),
    ]


def numbers(result: Result, subject: PlanSubject) -> dict[str, Any]:
    """Return the result as numbers for scripts; SI units."""
    summary: dict[str, Any] = {"found": [row._asdict() for row in rows(result, subject)], "findings": findings(result)}
    if isinstance(result, TrackerResult):
        summary |= {"rms_m": result.registration.rms, "held_out_mean_m": float(result.registration.held_out.mean())}
        summary["parameters"] = _parameters(result.registration.fit)
        summary |= _axis_numbers(result.axis)
    elif isinstance(result, ForceResult):
        summary["parameters"] = _parameters(result.calibration.fit)
        summary["weights"] = _weights(result.checks)
    elif isinstance(result, TubesResult):
        summary["parameters"] = _parameters(result.calibration.fit)
        if result.sensors is not None:
            summary["sensor_parameters"] = _parameters(result.sensors.fit)
        summary["weights"] = _weights(result.checks)
        summary["rms_m"] = math.sqrt(float(np.mean(result.calibration.errors**2)))
        summary["held_out_loaded_mean_m"] = {
            "believed": float(result.held_out_believed.mean()),
            "described_tubes_best_frames": float(result.held_out_loaded.before.mean()),
            "calibrated": float(result.held_out_loaded.after.mean()),
        }
        summary |= _axis_numbers(result.axis)
    elif isinstance(result, AxesResult):
        summary["signs"] = dict(zip([j.name for j in subject.robot.joints], result.signs.signs.tolist(), strict=True))
    else:
        summary |= {"latency_s": result.latency.latency, "standard_deviation_s": float(result.latency.error)}
    return summary


def recorded(measurements: Sequence[Measurement]) -> list[dict[str, Any]]:
    """Return the measurements as JSON values."""
    return [
        {
            "time": measurement.time,
            "joints": measurement.joints.tolist(),
            "coil": measurement.coil.tolist(),
            "wrenches": measurement.wrenches.tolist(),
            "weight": measurement.weight,
            **({} if measurement.axes is None else {"coil_axis": measurement.axes[-1].tolist()}),
        }
        for measurement in measurements
    ]


def tube_rows(calibration: TubeCalibration, described: Robot) -> list[Row]:
    """Return the rows of the tubes' parameters and of each joint's play."""
    found: list[Row] = []
    fit = calibration.fit
    for quantity in calibration.what:
        tube, name = described.tubes[quantity.tube], quantity.parameter(described).name
        value, half = fit.value(name), fit.interval(name)
        if quantity.kind == "bending_stiffness":
            ei = tube.bending_stiffness
            found.append(Row(f"{tube.name} EI", f"{ei:.4g}", f"{ei * (1.0 + value):.4g}", f"{ei * half:.2g} N m^2"))
        elif quantity.kind == "curvature":
            bent = max(math.hypot(*section.curvature) for section in tube.sections)
            text = f"{bent * (1.0 + value):.4g}"
            found.append(Row(f"{tube.name} curvature", f"{bent:.4g}", text, f"{bent * half:.2g} 1/m"))
        elif quantity.kind == "poisson_ratio":
            nu = tube.poisson_ratio
            found.append(Row(f"{tube.name} nu", f"{nu:.3g}", f"{nu + value:.3f}", f"{half:.2g}"))
        elif quantity.kind == "torsional_stiffness":
            gj = tube.bending_stiffness / tube.stiffness_ratio
            found.append(Row(f"{tube.name} GJ", f"{gj:.4g}", f"{gj * (1.0 + value):.4g}", f"{gj * half:.2g} N m^2"))
        elif quantity.kind in ("straight_length", "curve_start"):
            length, what = 1e3 * tube.sections[0].length, quantity.kind.replace("_", " ")
            text = f"{length + 1e3 * value:.2f}"
            found.append(Row(f"{tube.name} {what}", f"{length:g}", text, f"{1e3 * half:.2g} mm"))
        elif quantity.kind == "end":
            edge = 1e3 * tube.length
            text = f"{edge + 1e3 * value:.2f}"
            found.append(Row(f"{tube.name} length inside", f"{edge:g}", text, f"{1e3 * half:.2g} mm"))
        else:
            text = f"{math.degrees(value):.2f}"
            found.append(Row(f"{tube.name} zero angle", "0", text, f"{math.degrees(half):.2g} deg"))
    for parameter in fit.parameters:
        if parameter.name.endswith((" play", " half lag")):
            factor, unit = (1e6, "um") if parameter.unit == "m" else (180.0 / math.pi, "deg")
            value, half = factor * fit.value(parameter.name), factor * fit.interval(parameter.name)
            found.append(Row(parameter.name, "0", f"{value:.4g}", f"{half:.2g} {unit}"))
    return found


def frame_rows(fit: Fit, frames: Frames) -> list[Row]:
    """Return the rows of the tracker's frame, as a correction of its assumed pose."""
    turn, shift = np.degrees(vector_from_rotation(frames.registration.rotation)), 1e3 * frames.registration.position
    found: list[Row] = []
    for what, values, factor, unit in (
        ("frame rotation", turn, 180.0 / math.pi, "deg"),
        ("frame position", shift, 1e3, "mm"),
        ("coil", 1e3 * frames.coil, 1e3, "mm"),
    ):
        for axis, value in zip("xyz", values, strict=True):
            half = factor * fit.interval(f"{what} {axis}")
            found.append(Row(f"{what} {axis}", "0", f"{value:.3f}", f"{half:.2g} {unit}"))
    return found


def _axis_rows(axis: CoilAxis | None) -> list[Row]:
    """Return the rows of the coil's tilt towards x and y of the tip.

    The interval is the spread over poses: the model's error does not average out.
    """
    if axis is None or axis.refused:
        return []
    half = f"{math.degrees(1.96 * axis.spread):.2g} deg"
    lean = [math.degrees(math.atan2(part, axis.direction[2])) for part in axis.direction[:2]]
    return [Row(f"coil leans to {to}", "0", f"{angle:.2f}", half) for to, angle in zip("xy", lean, strict=True)]


def _axis_sentence(axis: CoilAxis | None) -> list[str]:
    if axis is None:
        return ["The tracker does not report the coil's direction; the tip's direction cannot be measured."]
    by = f"{math.degrees(axis.misalignment):.2f} deg from the tip's"
    if axis.refused:
        return [f"The coil's axis is {by}, but is not used: {axis.refused}."]
    return [f"The coil's axis is {by}; single poses agree within {math.degrees(axis.spread):.2f} deg."]


def _sensors(found: SensorCalibration, robot: Robot) -> list[Row]:
    listed: list[Row] = []
    for i, name in enumerate(robot.sensor_names):
        for axis, angle in zip("xyz", vector_from_rotation(found.sensors.mounting[i]), strict=True):
            half = math.degrees(found.fit.interval(f"{name} mounting {axis}"))
            listed.append(Row(f"{name} sensor about {axis}", "0", f"{math.degrees(angle):.2f}", f"{half:.2g} deg"))
    for i, tube in enumerate(robot.tubes):
        half = 1e3 * found.fit.interval(f"{tube.name} weight")
        listed.append(Row(f"{tube.name} sensor carries", "0", f"{1e3 * found.sensors.weight[i]:.1f}", f"{half:.2g} mN"))
    return listed


def _checks(checks: Sequence[tuple[float, WeightCheck]]) -> list[str]:
    return [
        f"The weight of {known:g} N was measured as {check.magnitude:.4f} N, {math.degrees(check.angle):.2f} deg from"
        " the direction of gravity."
        for known, check in checks
    ]


def _weak(fit: Fit) -> list[str]:
    return [f"The data do not determine: {combination}." for combination in fit.weak]


def _undetermined(fit: Fit) -> list[str]:
    """Return the sentence about combinations of sensor parameters that do not change the load."""
    if not fit.weak:
        return []
    return [
        f"{len(fit.weak)} combinations of the sensors' parameters are not determined; none of them changes the load."
    ]


def _parameters(fit: Fit) -> Mapping[str, Mapping[str, Any]]:
    return {
        p.name: {"value": float(value), "standard_deviation": float(error), "unit": p.unit}
        for p, value, error in zip(fit.parameters, fit.values, fit.errors, strict=True)
    }


def _axis_numbers(axis: CoilAxis | None) -> dict[str, Any]:
    if axis is None or axis.refused:
        return {}
    return {"coil_axis": axis.direction.tolist(), "coil_axis_spread_rad": axis.spread}


def _weights(checks: Sequence[tuple[float, WeightCheck]]) -> list[dict[str, float]]:
    return [{"known_N": known, "error_N": check.error, "angle_rad": check.angle} for known, check in checks]


def _rms_mm(errors: Array) -> float:
    return 1e3 * math.sqrt(float(np.mean(errors**2)))
