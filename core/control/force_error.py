"""Largest plausible error of the estimated force at the tip, with which monitors compare the force with its bound."""

import math

import numpy as np

from core.control.deflection_force import LARGEST_FORCE_N, DeflectionForce
from core.control.sensor_zeros import SensorZeros
from core.control.tip_force import COVARIANCE, VARIANCE
from core.robot.robot import Array

#: Number of standard deviations.
DEVIATIONS = 2.0
#: A force from the deflection counts as unknown along directions whose deviation exceeds this fraction of the prior's.
UNKNOWN = 0.5


def error_by_sensors(load: Array, zeros: SensorZeros | None) -> float:
    """Return the largest plausible error of the force by the base sensors, in any direction [N].

    Args:
        load: state (5, 3) of the force's estimator, whose variances contain noise, gain, lever, and the drift of zeros
            that are not tracked.
        zeros: tracked zeros; a force that they contain by assumption may be a load. None: they are not tracked.
    """
    variance = _eigenvalues(*load[VARIANCE], *load[COVARIANCE])[-1]
    if zeros is None:
        return DEVIATIONS * math.sqrt(variance)
    return DEVIATIONS * math.sqrt(variance + zeros.deviation**2) + math.hypot(*zeros.assumed.tolist())


def error_by_deflection(deflection: DeflectionForce) -> float:
    """Return the largest plausible error of the force by the deflection, in the directions in which it is known [N]."""
    xx, xy, xz, yy, yz, zz = deflection.covariance
    found = _eigenvalues(xx, yy, zz, xy, xz, yz)
    return DEVIATIONS * math.sqrt(max(found[found < (UNKNOWN * LARGEST_FORCE_N) ** 2], default=0.0))


def unknown_along(deflection: DeflectionForce, direction: Array) -> bool:
    """Return whether the tubes bend too little for the force along a unit vector (3,) to be known."""
    xx, xy, xz, yy, yz, zz = deflection.covariance
    variance = direction @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ direction
    return bool(variance >= (UNKNOWN * LARGEST_FORCE_N) ** 2)


def _eigenvalues(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float) -> Array:
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return np.maximum(np.linalg.eigvalsh(matrix), 0.0)
