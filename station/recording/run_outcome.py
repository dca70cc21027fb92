"""Outcome of a run: label, tip errors as in the paper (per axis, after the settling time), force, joints at a limit.

If the load starts within the settling time, errors count from this onset: the load's effect is not part of settling.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from core.errors import CtrError
from core.robot.robot import Array
from station.config.strict import Strict, Vector
from station.devices.interfaces import ABSENT

#: Settling time of a free motion [s]; a short motion has half of its duration instead.
SETTLING_S = 20.0
#: Smallest fraction of time at a limit for which a joint is named in the warning; rarer limits have no visible effect.
NAMED_PART = 0.02


class RunOutcome(StrEnum):
    """Outcome of a run's recording; the reason is stored separately as its `cause`."""

    COMPLETE = "complete"  #: the run ended as planned
    STOPPED = "stopped"  #: an operator, HOLD or a fault ended the run early
    INTERRUPTED = "interrupted"  #: the process that carried out or recorded the run ended early
    INCOMPLETE = "incomplete"  #: the disk was full, so the last rows are missing


class RecordingError(CtrError):
    """A recording cannot be written or read."""


def settling_time(duration: float) -> float:
    """Return the settling time of a motion for which none is configured [s]."""
    return min(SETTLING_S, 0.5 * duration)


def counted_from(settling: float, onset: float) -> float:
    """Return the time from which errors count: the settling time, or the load's onset if that is earlier [s]."""
    return min(settling, onset)


def evaluation_note(cases: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a sentence about the time from which errors count in each of the `cases` of a summary."""
    starts = {name: numbers["counted_from_s"] for name, numbers in cases.items() if "counted_from_s" in numbers}
    if not starts:
        return "Errors count after the settling time."
    if len(set(starts.values())) == 1:
        return f"Errors count from {next(iter(starts.values())):g} s after the motion's start on."
    each = ", ".join(f"{name} {start:g} s" for name, start in starts.items())
    return f"Errors count from these times after the motion's start on: {each}."


def errors(prefix: str, error: Array, time: Array) -> dict[str, Any]:
    """Return statistics of tip errors (samples, 3) [m]: largest and RMS by axis, largest and mean distance [mm].

    `time` (samples,) is the time of each sample since the motion's start [s].
    """
    millimetres = 1e3 * error
    distance = np.linalg.norm(millimetres, axis=1)
    return {
        f"{prefix}max_abs_error_mm": rounded(np.abs(millimetres).max(axis=0)),
        f"{prefix}max_distance_mm": rounded(distance.max()),
        f"{prefix}max_distance_at_s": rounded(time[distance.argmax()], 3),
        f"{prefix}rms_error_mm": rounded(rms(millimetres)),
        f"{prefix}mean_error_mm": rounded(distance.mean()),
    }


def desired(of: Callable[[str], Array], target: str) -> Array:
    """Return the desired tip position (ticks, 3) [m]: the setpoint, or a followed target plus its offset.

    `of` returns the columns of a group of channels (ticks, k); `target` is the group with the target's position.
    """
    return np.where(of("target_followed") > 0.0, of(target) + of("target_offset"), of("tip_desired"))


def frame_errors(of: Callable[[str], Array], frames: NDArray[np.bool_], start: float) -> Array:
    """Return desired minus measured tip (f, 3) [m] at `frames` (ticks,) of a motion that started at `start` [s].

    Each frame is compared with the setpoint at the time of its measurement. A followed target needs no such shift,
    because it was measured in the same frame.
    """
    time, taken = of("time")[:, 0] - start, of("tip_time")[frames, 0] - start
    setpoints = np.stack([np.interp(taken, time, column) for column in of("tip_desired").T], axis=1)
    followed = desired(of, "target_measured")[frames]
    return np.where(of("target_followed")[frames] > 0.0, followed, setpoints) - of("tip_measured")[frames]


def motion_errors(of: Callable[[str], Array], start: float, first: float) -> Mapping[str, Any]:
    """Return the tip errors of a motion from `first` [s] after its `start` [s] on, and the largest force since then.

    Empty if the tracker has sent no frame since then. A bench without a tracker has true errors only. `of` returns the
    columns of a channel group (ticks, k). Errors with the prefix `true_` are those of the virtual lab's true tip.
    """
    counted = of("time")[:, 0] - start >= first
    frames = counted & (of("tip_new")[:, 0] > 0.0)
    tracked = bool((of("trouble")[counted, 1] != ABSENT).any())
    if not (frames.any() if tracked else counted.any()):
        return {}
    found = errors("", frame_errors(of, frames, start), of("tip_time")[frames, 0] - start) if tracked else {}
    if of("truth_known")[counted].all():
        found |= errors("true_", (desired(of, "target_true") - of("tip_true"))[counted], of("time")[counted, 0] - start)
    known = tracked or bool((of("trouble")[counted, 2] != ABSENT).any())
    return found | (largest_force(of("force_filtered")[counted]) if known else {})


def largest_force(force: Array) -> dict[str, Any]:
    """Return the summary entry with the magnitude of the largest of several forces (samples, 3) [N]."""
    return {"force_max_N": rounded(np.linalg.norm(force, axis=1).max())}


def rms(error: Array) -> Array:
    """Return the root mean square of each column of an array."""
    return np.sqrt(np.mean(error * error, axis=0))


def rounded(value: Any, digits: int = 4) -> float | Sequence[float]:
    """Return rounded numbers for JSON."""
    return np.round(value, digits).tolist()


class CaseOutcome(Strict):
    """Tip errors and force of one case, counted from `counted_from` on."""

    against: Literal["true", "measured"]
    """tip that is compared with the desired one: the virtual lab's, or the tracker's without a ground truth"""
    largest: Vector
    """largest error in x, y, z [mm]"""
    largest_distance: float
    """largest distance from the desired tip [mm]"""
    largest_at: float | None = None
    """time of the largest distance, after the motion's start [s]; null in runs of older versions"""
    rms: Vector
    """root mean square of the error in x, y, z [mm]"""
    rms_distance: float
    """root mean square of the distance [mm]"""
    measured_largest: float | None = None
    """largest distance by the tracker [mm] beside the true one; null if `against` is "measured" or without a tracker"""
    measured_rms: float | None = None
    """root mean square of the distance by the tracker [mm], beside the true one; null as `measured_largest`"""
    force: float | None = None
    """largest filtered force at the tip [N]; null in runs of older versions"""
    duration: float | None = None
    """duration of the motion [s]; null in runs of older versions"""
    counted_from: float = 0.0
    """time after the motion's start from which errors count [s]"""


def case_outcomes(summary: Mapping[str, Any]) -> dict[str, CaseOutcome]:
    """Return the outcome of every case for which a summary has errors; an invalid summary gives none."""
    cases = summary.get("cases")
    if not isinstance(cases, Mapping):
        return {}
    found = {str(name): _outcome(numbers) for name, numbers in cases.items() if isinstance(numbers, Mapping)}
    return {name: outcome for name, outcome in found.items() if outcome is not None}


def _outcome(numbers: Mapping[str, Any]) -> CaseOutcome | None:
    against = "true" if "true_max_abs_error_mm" in numbers else "measured"
    prefix = "true_" if against == "true" else ""
    try:
        rms = numbers[f"{prefix}rms_error_mm"]
        measured = numbers.get("rms_error_mm") if against == "true" else None
        return CaseOutcome(
            against=against,
            largest=numbers[f"{prefix}max_abs_error_mm"],
            largest_distance=numbers[f"{prefix}max_distance_mm"],
            largest_at=numbers.get(f"{prefix}max_distance_at_s"),
            rms=rms,
            rms_distance=round(math.hypot(*rms), 4),
            measured_largest=None if measured is None else numbers["max_distance_mm"],
            measured_rms=None if measured is None else round(math.hypot(*measured), 4),
            force=numbers.get("force_max_N"),
            duration=numbers.get("motion_s", numbers.get("simulated_s")),
            counted_from=numbers.get("counted_from_s", 0.0),
        )
    except (KeyError, TypeError, ValidationError):
        return None


def limited_parts(names: Sequence[str], at_bound: Array, followed: Array) -> dict[str, float]:
    """Return the fraction of time that each joint is at a limit while the tip follows a target.

    `at_bound` (m, n) and `followed` (m,) are positive at ticks at which a joint is at a limit or the tip follows.
    """
    ticks = at_bound[followed > 0.0] != 0.0
    parts = ticks.mean(axis=0) if len(ticks) else np.zeros(len(names))
    return dict(zip(names, parts.tolist(), strict=True))


def saturation_warning(parts: Mapping[str, float]) -> str:
    """Return a warning about joints that are often at their limits, or an empty text."""
    named = [f"{joint} {100.0 * part:.0f} %" for joint, part in parts.items() if part > NAMED_PART]
    if not named:
        return ""
    return (
        f"the target's path needs more than the stages have: at a limit of speed or travel {', '.join(named)} of the"
        " time, and the tip falls behind; start from a pose with more room, or use quicker stages"
    )
