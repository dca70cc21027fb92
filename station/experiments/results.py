"""Numbers of a run: tracking errors as the paper counts them, and against the plant's true tip."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from core.robot import Array
from station.experiments.runner import Recording


def summarise(recording: Recording) -> dict[str, Any]:
    """Errors after the settling time, in millimetres, and what else the figures need.

    `true_` is desired minus the plant's tip; without it desired minus the tracker's tip, each frame
    compared with the setpoint of the moment it was taken.
    """
    channels, rows, settling = recording.channels, recording.rows, recording.case.file.settling
    summary: dict[str, Any] = {
        "completed": recording.completed,
        "cause": recording.cause,
        "simulated_s": round(recording.simulated_s, 3),
        "wall_s": round(recording.wall_s, 3),
    }
    counted = rows[channels.of(rows, "time")[:, 0] >= settling - 1e-9]
    frames = counted[channels.of(counted, "tip_new")[:, 0] > 0.0]
    if len(counted) == 0 or len(frames) == 0:
        return summary
    times, frame_times = channels.of(rows, "time")[:, 0], channels.of(frames, "tip_time")[:, 0]

    def at_frames(group: str) -> Array:
        columns = channels.of(rows, group).T
        return np.stack([np.interp(frame_times, times, column) for column in columns], axis=1)

    measured = channels.of(frames, "tip_measured")
    sweeps = recording.case.file.trajectory.kind == "joint_sweep"
    if not sweeps:
        summary |= _errors("", at_frames("tip_desired") - measured)
    known = bool(channels.of(counted, "truth_known").all())
    if known:
        true = channels.of(counted, "tip_true")
        if not sweeps:
            summary |= _errors("true_", channels.of(counted, "tip_desired") - true)
        force_error = channels.of(counted, "force") - channels.of(counted, "force_true")
        summary["force_rms_error_N"] = _rounded(_rms(force_error), 4)
    summary["model_error_mm"] = {
        name: _rounded(1e3 * np.linalg.norm(at_frames(group) - measured, axis=1).mean())
        for name, group in (("loaded", "tip_estimated"), ("unloaded", "tip_unloaded"))
    }
    summary["deflection_max_mm"] = {
        group: _rounded(1e3 * np.abs(channels.of(counted, group)).max(axis=0))
        for group in ("deflection", "delta_1", "delta_2")
    }
    return summary


def _errors(prefix: str, error: Array) -> dict[str, Any]:
    millimetres = 1e3 * error
    return {
        f"{prefix}max_abs_error_mm": _rounded(np.abs(millimetres).max(axis=0)),
        f"{prefix}rms_error_mm": _rounded(_rms(millimetres)),
        f"{prefix}mean_error_mm": _rounded(np.linalg.norm(millimetres, axis=1).mean()),
    }


def _rms(error: Array) -> Array:
    return np.sqrt(np.mean(error * error, axis=0))


def _rounded(value: Any, digits: int = 4) -> float | Sequence[float]:
    return np.round(value, digits).tolist()
