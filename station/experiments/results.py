"""Numbers of a run: tracking errors as the paper counts them, and against the plant's true tip."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.robot.limits import TubeOrder
from core.robot.robot import Array
from station.config.controllers import PERIOD
from station.config.motions import StepMotion
from station.experiments.changes import window_name, windows
from station.experiments.runner import Recording
from station.experiments.step_fit import fit_step, fold
from station.recording.tracking_errors import desired, errors, frame_errors, largest_force, rms, rounded

#: Ticks over which the model's tip is averaged before it is compared: the noise of one force sample, 0.02 N in each
#: sensor, moves it by a millimetre, and that says nothing about the model.
AVERAGED = 251
#: Ticks that the reference of the deflection's rate looks at, before and after together.
HINDSIGHT = 501


def summarise(recording: Recording) -> dict[str, Any]:
    """Errors from `counted_from_s` on, in millimetres, and what else the figures need.

    `true_` is desired minus the plant's tip; without it desired minus the tracker's tip, each frame
    compared with the setpoint of the moment it was taken.
    """
    channels, rows, first = recording.channels, recording.rows, recording.case.file.counted_from
    summary: dict[str, Any] = {
        "completed": recording.completed,
        "cause": recording.cause,
        "simulated_s": round(recording.simulated_s, 3),
        "wall_s": round(recording.wall_s, 3),
    }
    if recording.rates:
        # What each axis really got over its line.
        summary["line_rates"] = {axis: dict(rates) for axis, rates in recording.rates.items()}
    if recording.case.warnings:
        summary["warnings"] = list(recording.case.warnings)

    def of(group: str) -> Array:
        return channels.of(rows, group)

    is_counted = of("time")[:, 0] >= first - 1e-9
    is_frame = is_counted & (of("tip_new")[:, 0] > 0.0)
    frames = rows[is_frame]
    if len(frames) == 0:
        return summary
    counted = rows[is_counted]
    summary["counted_from_s"] = first
    summary |= largest_force(channels.of(counted, "force_filtered"))
    times, frame_times = of("time")[:, 0], channels.of(frames, "tip_time")[:, 0]

    def at_frames(group: str, *, averaged: bool = False) -> Array:
        values = of(group)
        columns = (averaged_model(values) if averaged else values).T
        return np.stack([np.interp(frame_times, times, column) for column in columns], axis=1)

    measured = channels.of(frames, "tip_measured")
    sweeps = recording.case.file.trajectory.kind == "joint_sweep"
    if not sweeps:
        summary |= errors("", frame_errors(of, is_frame, 0.0))
    known = bool(channels.of(counted, "truth_known").all())
    if known:
        if not sweeps:
            error = desired(of, "target_true") - of("tip_true")
            summary |= errors("true_", error[is_counted])
            summary |= _by_change(recording, error)
            if recording.case.orders.follow is not None:
                summary |= _settled(recording, error)
            summary |= _direction(recording, is_counted)
            summary |= _edges(recording)
        for group in ("force", "force_filtered"):
            force_error = channels.of(counted, group) - channels.of(counted, "force_true")
            summary[f"{group}_rms_error_N"] = rounded(rms(force_error), 4)
    if isinstance(recording.case.file.trajectory, StepMotion):
        summary["step"] = _step(recording, "tip_true" if known else "tip_observed", recording.case.file.trajectory)
    summary["model_error_mm"] = {
        name: rounded(1e3 * np.linalg.norm(at_frames(group, averaged=True) - measured, axis=1).mean())
        for name, group in (("loaded", "tip_estimated"), ("unloaded", "tip_unloaded"))
    }
    summary["deflection_rate_rms_error_mm_s"] = _rate_errors(recording)
    summary["deflection_max_mm"] = {
        group: rounded(1e3 * np.abs(channels.of(counted, group)).max(axis=0))
        for group in ("deflection", "delta_1", "delta_2")
    }
    return summary


def _direction(recording: Recording, counted: NDArray[np.bool_]) -> dict[str, Any]:
    """How far the true tip pointed elsewhere than it should, or than at the start where nobody asked [deg].

    Only of more joints than a place takes, and in a lab that looks at it.
    """
    channels, rows = recording.channels, recording.rows
    true, wanted = channels.of(rows, "direction_true"), channels.of(rows, "direction_desired")
    if len(recording.case.robot.joints) <= 3 or not true.any():
        return {}
    off = angles(true, wanted if wanted.any() else np.broadcast_to(true[0], true.shape))[counted]
    error = np.linalg.norm(channels.of(rows, "tip_desired") - channels.of(rows, "tip_true"), axis=1)[counted]
    return {
        "true_p95_distance_mm": rounded(1e3 * np.percentile(error, 95.0)),
        "true_direction_error_deg": {"p95": rounded(np.percentile(off, 95.0)), "max": rounded(off.max())},
    }


def angles(first: Array, second: Array) -> Array:
    """Between directions (k, 3) [deg]."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), (first * second).sum(axis=1)))


def _edges(recording: Recording) -> dict[str, Any]:
    """How near the joints came to edges, where there are more of them than a place takes."""
    limits, joints = recording.case.controller.limits, recording.channels.of(recording.rows, "joints")
    if len(limits.joints) <= 3:
        return {}
    lower, upper = limits.packed[:2]
    room = np.minimum(joints - lower, upper - joints) / (0.5 * (upper - lower))
    order = [(limit.bound - joints @ limit.matrix.T).min() for limit in limits.others if isinstance(limit, TubeOrder)]
    return {
        "smallest": {
            "stability": rounded(recording.channels.of(recording.rows, "stability").min()),
            "room_of_half_travel": rounded(room.min()),
            **({"tube_order_mm": rounded(1e3 * min(order))} if order else {}),
        }
    }


def _settled(recording: Recording, error: Array) -> dict[str, Any]:
    """True errors (ticks, 3) [m] beside a target once its rhythms are known, whatever the load does."""
    begin = recording.case.file.settling
    settled = error[recording.channels.of(recording.rows, "time")[:, 0] >= begin - 1e-9]
    return {"settled_from_s": begin, **errors("settled_true_", settled)} if len(settled) else {}


def _by_change(recording: Recording, error: Array) -> dict[str, Any]:
    """True errors (ticks, 3) [m] from each change of the load to the next."""
    file, time = recording.case.file, recording.channels.of(recording.rows, "time")[:, 0]
    found: dict[str, Any] = {}
    for begin, end in windows(file.load, file.duration):
        within = error[(time >= begin - 1e-9) & (time < end - 1e-9)]
        if len(within):
            found[window_name(begin)] = errors("true_", within)
    return {"by_change": found} if found else {}


def averaged_model(tips: Array, ticks: int = AVERAGED) -> Array:
    """Tips of a model (ticks, 3) [m] as they are compared with a tracker: means over `ticks` around each tick."""
    from scipy.ndimage import uniform_filter1d  # here and below: half of what a command takes to start

    return uniform_filter1d(tips, ticks, axis=0, mode="nearest")


def _step(recording: Recording, group: str, motion: StepMotion) -> dict[str, float]:
    """How the tip got along the step, beside the rate that eq. (31) promises."""
    channels, rows, offset = recording.channels, recording.rows, np.array(motion.offset)
    start = channels.of(rows, "tip_desired")[0] - offset
    response = (channels.of(rows, group) - start) @ offset / float(offset @ offset)
    times = channels.of(rows, "time")[:, 0]
    fit = fit_step(*(fold(times, response, motion.stay) if motion.stay else (times, response)))
    return {
        "rate": round(fit.rate, 4),
        "dead_time_s": round(fit.dead_time, 4),
        "expected_rate": recording.case.file.controller.k1,
    }


def hindsight_rate(deflection: Array) -> Array | None:
    """Rate of a deflection (ticks, 3) [m] as only hindsight knows it: a cubic through a second of it [m/s].

    None when there is no second.
    """
    if len(deflection) <= HINDSIGHT:
        return None
    from scipy.signal import savgol_filter

    smoothed = savgol_filter(deflection, HINDSIGHT, 3, deriv=1, delta=PERIOD, axis=0)
    return np.asarray(smoothed, dtype=np.float64)


def _rate_errors(recording: Recording) -> dict[str, Any]:
    """How far the rates of Delta_total are from what it does."""
    channels, rows = recording.channels, recording.rows
    if len(rows) > 1 and rows[1, 0] - rows[0, 0] > 1.5 * PERIOD:
        return {}  # not every tick is here
    true = hindsight_rate(channels.of(rows, "deflection"))
    if true is None:
        return {}
    first = int(np.searchsorted(channels.of(rows, "time")[:, 0], recording.case.file.counted_from - 1e-9))
    groups = {"raw": "deflection_rate_raw", "filtered": "deflection_rate", "exact": "deflection_rate_exact"}
    return {name: rounded(1e3 * rms(channels.of(rows, group)[first:] - true[first:])) for name, group in groups.items()}
