"""Tracking errors of the tip as in the paper: per axis, after the settling time.

If the load starts within the settling time, errors count from this onset: the load's effect is not part of settling.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array

#: Settling time of a free motion [s]; a short motion has half of its duration instead.
SETTLING_S = 20.0


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


def errors(prefix: str, error: Array) -> dict[str, Any]:
    """Return statistics of tip errors (samples, 3) [m]: largest and RMS by axis, largest and mean distance [mm]."""
    millimetres = 1e3 * error
    return {
        f"{prefix}max_abs_error_mm": rounded(np.abs(millimetres).max(axis=0)),
        f"{prefix}max_distance_mm": rounded(np.linalg.norm(millimetres, axis=1).max()),
        f"{prefix}rms_error_mm": rounded(rms(millimetres)),
        f"{prefix}mean_error_mm": rounded(np.linalg.norm(millimetres, axis=1).mean()),
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

    Empty if the tracker has sent no frame since then. `of` returns the columns of a channel group (ticks, k). Errors
    with the prefix `true_` are those of the virtual lab's true tip.
    """
    counted = of("time")[:, 0] - start >= first
    frames = counted & (of("tip_new")[:, 0] > 0.0)
    if not frames.any():
        return {}
    found = errors("", frame_errors(of, frames, start))
    if of("truth_known")[counted].all():
        found |= errors("true_", (desired(of, "target_true") - of("tip_true"))[counted])
    return found | largest_force(of("force_filtered")[counted])


def largest_force(force: Array) -> dict[str, Any]:
    """Return the summary entry with the magnitude of the largest of several forces (samples, 3) [N]."""
    return {"force_max_N": rounded(np.linalg.norm(force, axis=1).max())}


def rms(error: Array) -> Array:
    """Return the root mean square of each column of an array."""
    return np.sqrt(np.mean(error * error, axis=0))


def rounded(value: Any, digits: int = 4) -> float | Sequence[float]:
    """Return rounded numbers for JSON."""
    return np.round(value, digits).tolist()
