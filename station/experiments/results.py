"""Summary numbers of a run: tracking errors as in the paper, and errors of the plant's true tip."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from core.robot.robot import Array
from station.config.controllers import PERIOD_S
from station.config.loads import Obstacle
from station.config.motions import PressMotion, StepMotion
from station.control.telemetry import Channels
from station.experiments.case_summary import load_windows, window_name
from station.experiments.runner import Recording
from station.recording.press_outcome import force_not_reached, press_outcome
from station.recording.run_outcome import (
    KNOWN_STD_N,
    desired,
    errors,
    largest_force,
    limited_parts,
    motion_errors,
    rms,
    rounded,
    saturation_warning,
)

#: Number of ticks over which the model's tip is averaged before it is compared with the tracker. Without averaging,
#: the noise of one force sample (0.02 N in each sensor) moves this tip by a millimetre, which is no model error.
AVERAGING_TICKS = 251
#: Number of ticks in the window, centred on the current tick, from which the reference rate of the deflection is
#: computed.
SMOOTHING_TICKS = 501


class StepFit(NamedTuple):
    """Parameters of the fitted response y(t) = 1 - exp(-rate (t - dead_time)), which is 0 before the dead time."""

    rate: float  #: rate of the first-order lag [1/s]
    dead_time: float  #: dead time before the response starts [s]


def fit_step(times: Array, response: Array) -> StepFit:
    """Return the least-squares fit of the response (m,) to a unit step at time 0, `times` (m,) [s].

    The response is a first-order lag with dead time, as in the paper's eq. (31). The control loop contains an
    integrator, so the final value equals the step; the fit finds the rate and the dead time.
    """

    def miss(parameters: Array) -> Array:
        rate, dead_time = parameters
        return -np.expm1(-rate * np.maximum(times - dead_time, 0.0)) - response

    # The time at which the response reaches 63 % gives an initial rate of the right order of magnitude.
    reached = float(times[np.argmax(response >= 1.0 - math.exp(-1.0))])
    found = least_squares(miss, (1.0 / max(reached, 0.02), 0.02), bounds=((1e-3, 0.0), (1e3, 1.0)))
    return StepFit(*map(float, found.x))


def fold(times: Array, response: Array, stay: float) -> tuple[Array, Array]:
    """Average the response to a square wave into one step response; a last, incomplete level is dropped.

    `stay` is the time at each level of the square wave [s].
    """
    each = int(np.searchsorted(times, times[0] + stay - 1e-9))
    stays = response[: len(response) // each * each].reshape(-1, each)
    back = np.arange(len(stays)) % 2 == 1
    return times[:each] - times[0], np.where(back[:, None], 1.0 - stays, stays).mean(axis=0)


def summarise(recording: Recording) -> dict[str, Any]:
    """Return the summary of a run: its tip errors from `counted_from_s` on [mm], and the other numbers of the figures.

    Errors with the prefix `true_` are the desired tip position minus that of the simulated real robot (plant). Errors
    without this prefix are the desired tip position minus that in a tracker frame. Each frame is compared with the
    setpoint at the time of its measurement.
    """
    channels, rows, first = recording.channels, recording.rows, recording.case.file.counted_from
    summary: dict[str, Any] = {
        "completed": recording.completed,
        "cause": recording.cause,
        "simulated_s": round(recording.simulated_s, 3),
        "wall_s": round(recording.wall_s, 3),
    }
    if recording.rates:
        # Rates of the velocity commands and position polls that each axis received over its serial line.
        summary["line_rates"] = {axis: dict(rates) for axis, rates in recording.rates.items()}
    summary["model"] = recording.case.controller.statics.discretisation
    if warnings := (*recording.case.notices, *recording.case.warnings):
        summary["warnings"] = list(warnings)

    def of(group: str) -> Array:
        return channels.of(rows, group)

    is_counted = of("time")[:, 0] >= first - 1e-9
    is_frame = is_counted & (of("tip_new")[:, 0] > 0.0)
    frames, counted = rows[is_frame], rows[is_counted]
    tracked = recording.case.controller.tracked
    if len(counted) == 0 or (tracked and len(frames) == 0):
        return summary
    if of("target_followed").any():
        joints = recording.case.robot.joints
        parts = limited_parts([joint.name for joint in joints], of("at_bound"), of("target_followed")[:, 0])
        summary["followed_at_limit"] = {joint: round(part, 3) for joint, part in parts.items()}
        if warning := saturation_warning(parts):
            summary["warnings"] = [*summary.get("warnings", ()), warning]
    summary["counted_from_s"] = first
    senses = recording.case.controller.senses
    motion, load = recording.case.file.trajectory, recording.case.file.load
    sweeps = motion.kind == "joint_sweep"
    if not sweeps:
        summary |= motion_errors(of, 0.0, first)
    else:
        summary |= largest_force(of, 0.0)
    if isinstance(motion, PressMotion) and (tracked or senses):
        summary |= press_outcome(of, motion, load if isinstance(load, Obstacle) else None, 0.0, first)
        if missed := force_not_reached(of, motion, 0.0):
            summary["warnings"] = [*summary.get("warnings", ()), missed]
    times, frame_times = of("time")[:, 0], channels.of(frames, "tip_time")[:, 0]

    def at_frames(group: str) -> Array:
        return np.stack([np.interp(frame_times, times, column) for column in averaged_model(of(group)).T], axis=1)

    measured = channels.of(frames, "tip_measured")
    known = bool(channels.of(counted, "truth_known").all())
    if known:
        if not sweeps:
            error = desired(of, "target_true") - of("tip_true")
            summary |= _errors_by_change(recording, error)
            if recording.case.orders.follow is not None:
                summary |= _settled_errors(recording, error)
            summary |= _direction(recording, is_counted)
            summary |= _edges(recording)
        summary |= _force_by_deflection(channels, frames) if tracked else {}
        for group in ("force", "force_filtered") if senses else ():
            force_error = channels.of(counted, group) - channels.of(counted, "force_true")
            summary[f"{group}_rms_error_N"] = rounded(rms(force_error), 4)
    if isinstance(motion, StepMotion):
        summary["step"] = _step(recording, of, "tip_true" if known else "tip_observed", motion)
    if tracked:
        summary["model_error_mm"] = {
            name: rounded(1e3 * np.linalg.norm(at_frames(group) - measured, axis=1).mean())
            for name, group in (("loaded", "tip_estimated"), ("unloaded", "tip_unloaded"))
        }
    summary["deflection_rate_rms_error_mm_s"] = _rate_errors(recording)
    summary["deflection_max_mm"] = {
        group: rounded(1e3 * np.abs(channels.of(counted, group)).max(axis=0))
        for group in ("deflection", "delta_1", "delta_2")
    }
    return summary


def _force_by_deflection(channels: Channels, frames: Array) -> dict[str, Any]:
    """Return RMS error and hit rate of the force from the deflection, in the directions in which the force is known.

    The directions are the eigenvectors of the covariance in each tracker frame. `force_by_deflection_rms_error_N` is
    the RMS error along them. `force_by_deflection_in_95` is the fraction whose 95 % interval contains the true force.
    `force_by_deflection_unknown` is the fraction of directions that are left out because the force along them is
    unknown. `frames` (f, channels) are the rows with a tracker frame.
    """
    xx, xy, xz, yy, yz, zz = channels.of(frames, "force_by_deflection_covariance").T
    variances, axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1))
    error = channels.of(frames, "force_by_deflection") - channels.of(frames, "force_true")
    along, spread = np.einsum("fik,fi->fk", axes, error), np.sqrt(np.maximum(variances, 0.0))
    known = (spread > 0.0) & (spread <= KNOWN_STD_N)
    if not known.any():
        return {}
    inside = np.abs(along[known]) <= 1.96 * spread[known]
    return {
        "force_by_deflection_rms_error_N": rounded(rms(along[known])),
        "force_by_deflection_in_95": rounded(inside.mean(), 3),
        "force_by_deflection_unknown": rounded(1.0 - known.mean(), 3),
    }


def _direction(recording: Recording, counted: NDArray[np.bool_]) -> dict[str, Any]:
    """Return the 95th percentile of the true tip's distance [mm], and the error of a controlled direction [deg].

    Empty for a robot with at most three joints, which cannot control the direction.
    """
    channels, rows = recording.channels, recording.rows[counted]
    if len(recording.case.robot.joints) <= 3:
        return {}
    error = np.linalg.norm(channels.of(rows, "tip_desired") - channels.of(rows, "tip_true"), axis=1)
    found: dict[str, Any] = {"true_p95_distance_mm": rounded(1e3 * np.percentile(error, 95.0))}
    true, desired_direction = channels.of(rows, "direction_true"), channels.of(rows, "direction_desired")
    if true.any() and desired_direction.any():
        off = angles(true, desired_direction)
        found["true_direction_error_deg"] = {"p95": rounded(np.percentile(off, 95.0)), "max": rounded(off.max())}
    return found


def angles(first: Array, second: Array) -> Array:
    """Return the angles between two sets of directions (k, 3) [deg]."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), (first * second).sum(axis=1)))


def _edges(recording: Recording) -> dict[str, Any]:
    """Return the smallest margins of a redundant robot during a run: stability, joint travel, order of the tubes."""
    limits, joints = recording.case.controller.limits, recording.channels.of(recording.rows, "joints")
    if len(limits.joints) <= 3:
        return {}
    lower, upper = limits.packed[:2]
    room = np.minimum(joints - lower, upper - joints) / (0.5 * (upper - lower))
    rows, bound = limits.order
    return {
        "smallest": {
            "stability": rounded(recording.channels.of(recording.rows, "stability").min()),
            "room_of_half_travel": rounded(room.min()),
            **({"tube_order_mm": rounded(1e3 * (bound - joints @ rows.T).min())} if bound.size else {}),
        }
    }


def _settled_errors(recording: Recording, error: Array) -> dict[str, Any]:
    """Return the tip errors of a run that follows a target, from the settling time on, regardless of the load.

    `error` (ticks, 3) is the desired minus the true tip position [m].
    """
    start = recording.case.file.settling
    time = recording.channels.of(recording.rows, "time")[:, 0]
    settled = time >= start - 1e-9
    return {"settled_from_s": start, **errors("settled_true_", error[settled], time[settled])} if settled.any() else {}


def _errors_by_change(recording: Recording, error: Array) -> dict[str, Any]:
    """Return the statistics of the true tip's error (ticks, 3) [m] for each part between two changes of the load."""
    file, time = recording.case.file, recording.channels.of(recording.rows, "time")[:, 0]
    found: dict[str, Any] = {}
    for start, end in load_windows(file.load, file.duration):
        within = (time >= start - 1e-9) & (time < end - 1e-9)
        if within.any():
            found[window_name(start)] = errors("true_", error[within], time[within])
    return {"by_change": found} if found else {}


def averaged_model(tips: Array, ticks: int = AVERAGING_TICKS) -> Array:
    """Return the moving average over `ticks` of a model's tips (ticks, 3) [m], for the comparison with a tracker."""
    from scipy.ndimage import uniform_filter1d  # imported late: SciPy takes half of a command's start time

    return uniform_filter1d(tips, ticks, axis=0, mode="nearest")


def step_response(of: Callable[[str], Array], group: str, motion: StepMotion) -> tuple[Array, Array]:
    """Return times (m,) [s] and mean response (m,) of a tip, the channels `group`, as fractions of the step."""
    offset = np.array(motion.offset)
    start = of("tip_desired")[0] - offset
    response = (of(group) - start) @ offset / float(offset @ offset)
    return fold(of("time")[:, 0], response, motion.stay) if motion.stay else (of("time")[:, 0], response)


def _step(recording: Recording, of: Callable[[str], Array], group: str, motion: StepMotion) -> dict[str, float]:
    """Return rate and dead time of the tip's fitted step response, and the rate that the paper's eq. (31) predicts."""
    fit = fit_step(*step_response(of, group, motion))
    return {
        "rate": round(fit.rate, 4),
        "dead_time_s": round(fit.dead_time, 4),
        "expected_rate": recording.case.file.controller.k1,
    }


def hindsight_rate(deflection: Array) -> Array | None:
    """Return the reference rate of a deflection (ticks, 3) [m]: slope of a cubic fit through one second [m/s].

    The fit uses samples before and after each tick. None for a recording shorter than one second.
    """
    if len(deflection) <= SMOOTHING_TICKS:
        return None
    from scipy.signal import savgol_filter

    smoothed = savgol_filter(deflection, SMOOTHING_TICKS, 3, deriv=1, delta=PERIOD_S, axis=0)
    return np.asarray(smoothed, dtype=np.float64)


def _rate_errors(recording: Recording) -> dict[str, Any]:
    """Return the RMS errors of the estimated rates of Delta_total [mm/s]."""
    channels, rows = recording.channels, recording.rows
    if len(rows) > 1 and rows[1, 0] - rows[0, 0] > 1.5 * PERIOD_S:
        return {}  # the rows are decimated, so a rate cannot be computed
    true = hindsight_rate(channels.of(rows, "deflection"))
    if true is None:
        return {}
    first = int(np.searchsorted(channels.of(rows, "time")[:, 0], recording.case.file.counted_from - 1e-9))
    groups = {"raw": "deflection_rate_raw", "filtered": "deflection_rate", "exact": "deflection_rate_exact"}
    return {name: rounded(1e3 * rms(channels.of(rows, group)[first:] - true[first:])) for name, group in groups.items()}
