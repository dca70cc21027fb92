"""Outcome of each case of a run: tip errors and force, read from the run's summary."""

import math
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import ValidationError

from station.config.strict import Strict, Vector


class CaseOutcome(Strict):
    """Tip errors and force of one case, counted from `counted_from` on."""

    against: Literal["true", "measured"]
    """tip that is compared with the desired one: the virtual lab's, or the tracker's without a ground truth"""
    largest: Vector
    """largest error in x, y, z [mm]"""
    largest_distance: float
    """largest distance from the desired tip [mm]"""
    rms: Vector
    """root mean square of the error in x, y, z [mm]"""
    rms_distance: float
    """root mean square of the distance [mm]"""
    force: float | None = None
    """largest filtered force at the tip [N]; null in runs of older versions"""
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
        return CaseOutcome(
            against=against,
            largest=numbers[f"{prefix}max_abs_error_mm"],
            largest_distance=numbers[f"{prefix}max_distance_mm"],
            rms=rms,
            rms_distance=round(math.hypot(*rms), 4),
            force=numbers.get("force_max_N"),
            counted_from=numbers.get("counted_from_s", 0.0),
        )
    except (KeyError, TypeError, ValidationError):
        return None
