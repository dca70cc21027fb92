"""Calibration of the tubes (stiffness, curvature, Poisson's ratio, straight lengths, zero angles) with the frames.

The calibration is a least-squares fit to the tracker's positions (`prediction`) over all measurements, unloaded and
loaded. Without load the shape depends only on ratios of stiffness. Measurements under a known or measured load set the
scale of the stiffness. The result lists the parameter combinations that only priors determine (`Fit.weak`).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from core.calibration.fit import Fit, UnobservableCombination, fit
from core.calibration.measurements import Measurement, Noise
from core.calibration.prediction import Frames, Prediction
from core.calibration.quantities import Quantity, quantities
from core.calibration.registration import closed_form
from core.robot.robot import Array, Robot

#: Largest accepted standard deviation of a combination of parameters, in tolerances. For a single frame parameter it is
#: 2 mm or 0.02 rad (1.15 deg).
MAX_OPEN_FRAME = 2.0
#: Reduced chi square of the fit above which the model itself is considered inaccurate.
MAX_REDUCED_CHI_SQUARE = 2.0
#: Prior of the coil's offset from the tip, measured with a caliper: standard deviation of each axis [m]. A fit with a
#: good model determines the offset more accurately. A fit with an inaccurate model would compensate other errors by
#: millimetres of offset along the tube.
COIL_OFFSET_STD_M = 0.3e-3
#: Smallest number of loaded measurements that determines the scale of the stiffness.
MIN_LOADED_MEASUREMENTS = 4


class TubeCalibration(NamedTuple):
    """Result of a tube calibration: the calibrated robot and the fit."""

    robot: Robot
    frames: Frames
    what: tuple[Quantity, ...]
    fit: Fit
    errors: Array  #: (m,) distance of each coil from the fitted model's prediction [m]
    rough: bool = False  #: whether the residuals of the first fit exceeded the noise


class HeldOutErrors(NamedTuple):
    """Distances (k,) [m] at held-out measurements."""

    before: Array  #: distances with the robot file's tubes and the best frames for them
    after: Array  #: distances with the calibrated tubes


def calibrate_tubes(
    robot: Robot,
    measurements: Sequence[Measurement],
    forces: Array,
    noise: Noise,
    sags: Array | None = None,
) -> TubeCalibration:
    """Fit tubes and frames to measurements under tip forces (m, 3) [N].

    `sags` (m, 3) are the tip forces equivalent to the tubes' own weight. The fit includes these forces if the residuals
    exceed the noise.

    Raises:
        UnobservableCombination: there are too few measurements or loads, or a frame is not determined.
        CtrError: the model has no shape at a measurement.

    """
    what = quantities(robot)
    loaded = int(np.count_nonzero(np.linalg.norm(forces, axis=1) > 0.05))
    if loaded < MIN_LOADED_MEASUREMENTS and any(q.kind == "bending_stiffness" for q in what):
        raise UnobservableCombination(
            f"{loaded} measurements under more than 0.05 N; without load the poses determine only ratios of"
            f" stiffness: hang a weight and measure at least {MIN_LOADED_MEASUREMENTS} poses"
        )
    if 3 * len(measurements) < len(what) + 9:
        raise UnobservableCombination(
            f"{len(measurements)} measurements for {len(what) + 9} unknowns; measure at least {len(what) + 9} poses"
        )
    problem = Prediction(robot, what, measurements, forces, noise, closed_form(robot, measurements, forces))
    found = fit(problem, problem.parameters)
    rough = found.variance_factor > MAX_REDUCED_CHI_SQUARE
    if rough:
        # Effects outside the model (friction, clearance, a distorted field) count as noise, so priors get more weight.
        problem = replace(problem, noise=noise.scaled(math.sqrt(found.variance_factor)), coil=COIL_OFFSET_STD_M)
        if sags is not None:
            problem = replace(problem, forces=forces + sags)
        found = fit(problem, problem.parameters, found.values)
    open_ = [c for c in found.weak if not c.fixed_by_prior and c.open > MAX_OPEN_FRAME]
    if open_:
        raise UnobservableCombination(
            f"the visited poses do not determine {open_[0]}; measure more of the travel of every joint"
        )
    errors = np.linalg.norm(problem.errors(found.values), axis=1)
    return TubeCalibration(problem.tubes(found.values), problem.frames(found.values), what, found, errors, rough)


def held_out_errors(
    described: Robot, calibration: TubeCalibration, fitted: tuple[Sequence[Measurement], Array],
    held_out: tuple[Sequence[Measurement], Array], noise: Noise,
) -> HeldOutErrors:  # fmt: skip
    """Return the errors at held-out measurements; `fitted` and `held_out` are measurements and forces (k, 3) [N]."""
    measurements, forces = fitted
    plain = Prediction(described, (), measurements, forces, noise, closed_form(described, measurements, forces))
    frames = plain.frames(fit(plain, plain.parameters).values)
    before = Prediction(described, (), *held_out, noise, frames)
    after = replace(before, robot=calibration.robot, start=calibration.frames)
    zero = np.zeros(len(before.parameters))
    return HeldOutErrors(*(np.linalg.norm(each.errors(zero), axis=1) for each in (before, after)))
