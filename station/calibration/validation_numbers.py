"""Converts a validation to numbers for scripts, which report.json contains."""

import math
from typing import Any

from core.calibration.external_poses import ErrorStatistics, PoseFit
from core.calibration.rigid_transform import vector_from_rotation
from station.calibration.findings import findings, undetermined_parameters
from station.calibration.validation import ErrorBin, Validation, by_direction, by_joint


def numbers(validation: Validation) -> dict[str, Any]:
    """Return the numbers of a validation: errors in mm, all others in SI units."""
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
            found.extent: _mm(ErrorStatistics.of(errors))
            for found, errors in zip(validation.matches, validation.errors, strict=True)
        },
        "unseen_mm": {
            held_out.extent: {
                "how": "every second pose fitted, the others tested" if validation.test is None else "the other file",
                "fitted": _mm(held_out.fitted),
                "tested": _mm(held_out.tested),
            }
            for held_out in validation.held_out
        },
        "noise_mm": 1e3 * best.noise,
        "neighbours_alike": best.neighbour_correlation,
        "frames": {
            "rotation_vector": vector_from_rotation(best.frames.registration.rotation).tolist(),
            "position": best.frames.registration.position.tolist(),
            "offset": best.frames.coil.tolist(),
            "position_standard_deviation": best.position_errors.tolist(),
        },
        "residual": _residual(validation),
        "parameters": _parameters(best),
        "cannot_tell": undetermined_parameters(best),
        "not_asked_for": list(best.requested.omitted),
        "by_joint": [_bin_numbers(each) for each in by_joint(validation)],
        "by_direction": [_bin_numbers(each) for each in by_direction(validation)],
        "findings": findings(validation),
    }


def _parameters(best: PoseFit) -> dict[str, dict[str, Any]]:
    if best.fit is None:
        return {}
    values, errors = best.fit.values.tolist(), best.fit.errors.tolist()
    return {
        p.name: {
            "value": value,
            "standard_deviation": None if p.name in best.undetermined else error,
            "unit": p.unit,
            "known_beforehand": p.prior if math.isfinite(p.prior) else None,
            "identified": p.name not in best.fixed_by_prior and p.name not in best.undetermined,
        }
        for p, value, error in zip(best.fit.parameters, values, errors, strict=True)
    }


def _residual(validation: Validation) -> dict[str, Any]:
    """Return cross-validated shares of the squared error; null where they do not exist."""
    left = validation.residual
    parts = {"last_pose_correlation": left.last_pose, "joints_predict": left.smooth, "joints_and_motion": left.motion}
    lengths = {"mean_mm": 1e3 * left.mean, "learned_mean_mm": 1e3 * left.learned}
    return {"kind": left.kind} | {
        key: value if math.isfinite(value) else None for key, value in (parts | lengths).items()
    }


def _mm(spread: ErrorStatistics) -> dict[str, float | int | None]:
    """Return lengths [mm]; null for NaN, which JSON does not have."""
    lengths = {key: 1e3 * value for key, value in spread._asdict().items() if key != "poses"}
    return {"poses": spread.poses, **{key: value if math.isfinite(value) else None for key, value in lengths.items()}}


def _bin_numbers(each: ErrorBin) -> dict[str, Any]:
    return {
        "joint": each.joint,
        "where": each.where,
        **_mm(each.spread),
        "along_mm": [1e3 * a if math.isfinite(a) else None for a in each.along],
    }
