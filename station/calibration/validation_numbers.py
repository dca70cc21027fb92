"""A validation for scripts."""

import math
from typing import Any

from core.calibration.measured import Match, Spread
from core.calibration.rigid import vector_of
from station.calibration.findings import cannot_tell, findings
from station.calibration.validation import Bin, Validation, by_direction, by_joint


def numbers(validation: Validation) -> dict[str, Any]:
    """For scripts; errors in mm, all else SI."""
    best = validation.best
    return {
        "robot": validation.robot.name,
        "poses": str(validation.poses.path),
        "test": None if validation.test is None else str(validation.test.path),
        "used": len(validation.poses.measurements),
        "left_out": [each._asdict() for each in validation.poses.left_out],
        "test_left_out": [] if validation.test is None else [each._asdict() for each in validation.test.left_out],
        "fit": best.extent,
        "failed": validation.failed or None,
        "errors_mm": {
            found.extent: _mm(Spread.of(errors))
            for found, errors in zip(validation.matches, validation.errors, strict=True)
        },
        "unseen_mm": {
            unseen.extent: {
                "how": "every second pose fitted, the others tested" if validation.test is None else "the other file",
                "fitted": _mm(unseen.fitted),
                "tested": _mm(unseen.tested),
            }
            for unseen in validation.unseen
        },
        "noise_mm": 1e3 * best.noise,
        "neighbours_alike": best.alike,
        "frames": {
            "rotation_vector": vector_of(best.frames.registration.rotation).tolist(),
            "position": best.frames.registration.position.tolist(),
            "offset": best.frames.coil.tolist(),
            "position_standard_deviation": best.position_errors.tolist(),
        },
        "parameters": _parameters(best),
        "cannot_tell": cannot_tell(best),
        "not_asked_for": list(best.asked.left),
        "by_joint": [_bin_numbers(each) for each in by_joint(validation)],
        "by_direction": [_bin_numbers(each) for each in by_direction(validation)],
        "findings": findings(validation),
    }


def _parameters(best: Match) -> dict[str, dict[str, Any]]:
    if best.fit is None:
        return {}
    values, errors = best.fit.values.tolist(), best.fit.errors.tolist()
    return {
        p.name: {
            "value": value,
            "standard_deviation": None if p.name in best.lost else error,
            "unit": p.unit,
            "known_beforehand": p.prior if math.isfinite(p.prior) else None,
            "told": p.name not in best.held and p.name not in best.lost,
        }
        for p, value, error in zip(best.fit.parameters, values, errors, strict=True)
    }


def _mm(spread: Spread) -> dict[str, float | int | None]:
    """Lengths that do not exist are null: JSON knows no NaN."""
    lengths = {key: 1e3 * value for key, value in spread._asdict().items() if key != "poses"}
    return {"poses": spread.poses, **{key: value if math.isfinite(value) else None for key, value in lengths.items()}}


def _bin_numbers(each: Bin) -> dict[str, Any]:
    return {
        "joint": each.joint,
        "where": each.where,
        **_mm(each.spread),
        "along_mm": [1e3 * a if math.isfinite(a) else None for a in each.along],
    }
