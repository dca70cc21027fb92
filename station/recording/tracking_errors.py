"""How far the tip was from where it should have been, as the paper counts it: per axis, after the settling time.

A load is never part of the settling: errors count from its onset at the latest.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array

#: Errors of a free motion count from here on [s], or from half of it if it is shorter than twice that.
SETTLING = 20.0


def settling_time(duration: float) -> float:
    """Of a motion that does not say when it has settled [s]."""
    return min(SETTLING, 0.5 * duration)


def counted_from(settling: float, onset: float) -> float:
    """When errors begin to count: after the settling time, or from the load's onset if that is earlier [s]."""
    return min(settling, onset)


def which_count(cases: Mapping[str, Mapping[str, Any]]) -> str:
    """Which moments errors are taken from, in a sentence; `cases` are those of a summary."""
    begins = {name: numbers["counted_from_s"] for name, numbers in cases.items() if "counted_from_s" in numbers}
    if not begins:
        return "Errors count after the settling time."
    if len(set(begins.values())) == 1:
        return f"Errors count from {next(iter(begins.values())):g} s after the motion's start on."
    each = ", ".join(f"{name} {begin:g} s" for name, begin in begins.items())
    return f"Errors count from these times after the motion's start on: {each}."


def errors(prefix: str, error: Array) -> dict[str, Any]:
    """Largest by axis and as a distance, root mean square and mean of tip errors (samples, 3) [m], in millimetres."""
    millimetres = 1e3 * error
    return {
        f"{prefix}max_abs_error_mm": rounded(np.abs(millimetres).max(axis=0)),
        f"{prefix}max_distance_mm": rounded(np.linalg.norm(millimetres, axis=1).max()),
        f"{prefix}rms_error_mm": rounded(rms(millimetres)),
        f"{prefix}mean_error_mm": rounded(np.linalg.norm(millimetres, axis=1).mean()),
    }


def desired(of: Callable[[str], Array], target: str) -> Array:
    """Where the tip should be (ticks, 3) [m]: at the setpoint; beside a target while one is followed.

    `of` gives the columns of a group of channels (ticks, k); `target` is the group that says where the target is.
    """
    return np.where(of("target_followed") > 0.0, of(target) + of("target_offset"), of("tip_desired"))


def frame_errors(of: Callable[[str], Array], frames: NDArray[np.bool_], start: float) -> Array:
    """Desired minus measured (f, 3) [m] at `frames` (ticks,), of a motion that began at `start` [s].

    A setpoint is that of the moment at which the frame was taken; a target was measured in the frame itself.
    """
    time, taken = of("time")[:, 0] - start, of("tip_time")[frames, 0] - start
    wanted = np.stack([np.interp(taken, time, column) for column in of("tip_desired").T], axis=1)
    beside = desired(of, "target_measured")[frames]
    return np.where(of("target_followed")[frames] > 0.0, beside, wanted) - of("tip_measured")[frames]


def motion_errors(of: Callable[[str], Array], start: float, first: float) -> Mapping[str, Any]:
    """Errors of a motion that began at `start` [s] of its rows, from `first` [s] on; empty when there are none.

    `of` gives the columns of a group of channels (ticks, k). `true_` errors are those of the virtual lab's tip.
    """
    counted = of("time")[:, 0] - start >= first
    frames = counted & (of("tip_new")[:, 0] > 0.0)
    if not frames.any():
        return {}
    found = errors("", frame_errors(of, frames, start))
    if of("truth_known")[counted].all():
        found |= errors("true_", (desired(of, "target_true") - of("tip_true"))[counted])
    return found


def rms(error: Array) -> Array:
    """Root mean square of each column."""
    return np.sqrt(np.mean(error * error, axis=0))


def rounded(value: Any, digits: int = 4) -> float | Sequence[float]:
    """For JSON."""
    return np.round(value, digits).tolist()
