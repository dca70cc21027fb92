"""Outcome of a run: label, tip errors as in the paper (per axis, after the settling time), force, joints at a limit.

If the load starts within the settling time, errors count from the load's start, because its effect is no settling.
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

#: Fraction of time at a limit above which the warning names a joint; a smaller fraction has no visible effect.
NAMED_PART = 0.02
#: Largest standard deviation of a known force [N]. A force along stiff tubes causes no measurable deflection, so its
#: standard deviation stays at the initial value of 0.25 N.
KNOWN_STD_N = 0.05


class RunOutcome(StrEnum):
    """Outcome of a run's recording; the reason is stored separately as its `cause`."""

    COMPLETE = "complete"  #: the run ended as planned
    STOPPED = "stopped"  #: an operator, HOLD or a fault ended the run early
    INTERRUPTED = "interrupted"  #: the process that carried out or recorded the run ended early
    INCOMPLETE = "incomplete"  #: the disk was full, so the last rows are missing


class RecordingError(CtrError):
    """A recording cannot be written or read."""


def counted_from(settling: float, onset: float) -> float:
    """Return the time from which errors count: the settling time, or the load's onset if that is earlier [s]."""
    return min(settling, onset)


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
    """Return the tip errors of a motion from `first` [s] after its `start` [s] on, and the largest force since `start`.

    The result is empty if the tracker has sent no frame since `first`. Without a tracker only true errors are returned.
    `of` returns the columns of a channel group (ticks, k). The prefix `true_` marks errors of the virtual lab's tip.
    """
    counted = of("time")[:, 0] - start >= first - 1e-9
    frames = counted & (of("tip_new")[:, 0] > 0.0)
    tracked = bool((of("trouble")[counted, 1] != ABSENT).any())
    if not (frames.any() if tracked else counted.any()):
        return {}
    found = errors("", frame_errors(of, frames, start), of("tip_time")[frames, 0] - start) if tracked else {}
    if of("truth_known")[counted].all():
        found |= errors("true_", (desired(of, "target_true") - of("tip_true"))[counted], of("time")[counted, 0] - start)
    return found | largest_force(of, start)


def unknown_axes(of: Callable[[str], Array], start: float = 0.0) -> str:
    """Return the axes in which the force after `start` [s] is unknown: "", "z", "xz" ...

    In these axes the median standard deviation exceeds `KNOWN_STD_N`. Without tracker and force sensors the whole force
    is unknown. `of` as in `motion_errors`.
    """
    if (of("trouble")[:, 1:] == ABSENT).all():
        return "xyz"
    variance = np.median(of("force_variance")[of("time")[:, 0] >= start - 1e-9], axis=0)
    return "".join(axis for axis, one in zip("xyz", variance, strict=True) if one > KNOWN_STD_N**2)


def known_force(of: Callable[[str], Array], unknown: str) -> Array:
    """Return the magnitude of the estimated force (ticks,) [N] without its components along the `unknown` axes."""
    return np.linalg.norm(of("force_filtered")[:, [axis not in unknown for axis in "xyz"]], axis=1)


def largest_force(of: Callable[[str], Array], start: float) -> dict[str, Any]:
    """Return the summary entries of the largest force [N] since `start` [s], and of the axes in which it is unknown.

    It counts from the motion's start on, because the force of a contact is largest at first.
    """
    unknown, moving = unknown_axes(of, start), of("time")[:, 0] >= start - 1e-9
    found = {"force_unknown": unknown} if unknown else {}
    return found if unknown == "xyz" else {"force_max_N": rounded(known_force(of, unknown)[moving].max()), **found}


def rms(error: Array) -> Array:
    """Return the root mean square of each column of an array."""
    return np.sqrt(np.mean(error * error, axis=0))


def rounded(value: Any, digits: int = 4) -> float | Sequence[float]:
    """Return rounded numbers for JSON."""
    return np.round(value, digits).tolist()


class CaseOutcome(Strict):
    """Tip errors of one case from the time `counted_from` on, and its largest force."""

    against: Literal["true", "measured"]
    """tip that is compared with the desired one: the virtual lab's true tip, or on a bench the measured tip"""
    largest: Vector
    """largest error in x, y, z [mm]"""
    largest_distance: float
    """largest distance from the desired tip [mm]"""
    largest_at: float | None = None
    """time of the largest distance, after the motion's start [s]"""
    rms: Vector
    """root mean square of the error in x, y, z [mm]"""
    rms_distance: float
    """root mean square of the distance [mm]"""
    measured_largest: float | None = None
    """largest distance by the tracker [mm] if `against` is "true"; null if it is "measured", or without a tracker"""
    measured_rms: float | None = None
    """root mean square of the distance by the tracker [mm]; null if `measured_largest` is null"""
    force: float | None = None
    """largest force at the tip, filtered, from the motion's start on [N]; null if it is unknown"""
    force_unknown: str = ""
    """axes in which the force is unknown, which `force` does not include: "", "z", "xz" ..."""
    stiffness: Sequence[Sequence[float | None]] | None = None
    """estimated stiffness of each palpated place, row by row [N/m]; null for an unknown place, and without palpation"""
    duration: float | None = None
    """duration of the motion [s]"""
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
            force_unknown=numbers.get("force_unknown", ""),
            stiffness=numbers.get("palpation", {}).get("stiffness_N_per_m"),
            duration=numbers.get("motion_s", numbers.get("simulated_s")),
            counted_from=numbers.get("counted_from_s", 0.0),
        )
    except (AttributeError, KeyError, TypeError, ValidationError):
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
        f"the target's path exceeds the speed or travel of the stages (at a limit: {', '.join(named)} of the time),"
        " so the tip falls behind; start from a pose with more room, or use faster stages"
    )
