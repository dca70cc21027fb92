"""The tubes as they are: EI, curvature, nu, straight lengths and zero angles, together with the frames.

Least squares over all measurements, unloaded and loaded, on the tracker's positions (`prediction`). Without load the
shape depends on stiffness only through ratios: measurements under a known or measured load set its scale. Which
combinations the data leave to what was known beforehand is part of the answer (`fit.weak`).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from core.calibration.fit import Fit, Unobservable, fit
from core.calibration.measurements import Measurement, Noise
from core.calibration.prediction import Frames, Prediction
from core.calibration.quantities import Quantity, quantities
from core.calibration.registration import closed_form
from core.robot.robot import Array, Robot

#: A frame that is left open by more than this is not calibrated, in the sizes of its parameters: 2 mm, 1 deg.
LOST = 2.0
#: Chi square over degrees of freedom from which a model that is not quite right shows.
ROUGH = 2.0
#: How well a caliper says that the coil is at the tip, one standard deviation of each axis [m]. A good model finds it
#: better; a rough one puts it millimetres along the tube in place of something else, and the tip with it.
COIL_KNOWN = 0.3e-3
#: Fewer loaded measurements than this cannot set the scale of the stiffness.
LEAST_LOADED = 4


class TubeCalibration(NamedTuple):
    """The robot as it was found to be."""

    robot: Robot
    frames: Frames
    what: tuple[Quantity, ...]
    fit: Fit
    errors: Array  #: (m,) distance of each coil from where the fitted model puts it [m]
    rough: bool = False  #: the model alone left more than noise


class HeldOut(NamedTuple):
    """Distances at measurements that no fit has seen (k,) [m]."""

    before: Array  #: the described tubes with the best frames for them
    after: Array


def calibrate_tubes(
    robot: Robot,
    measurements: Sequence[Measurement],
    forces: Array,
    noise: Noise,
    what: tuple[Quantity, ...] | None = None,
    sags: Array | None = None,
) -> TubeCalibration:
    """Fit tubes and frames to measurements under tip forces (m, 3) [N].

    `sags` (m, 3) are the forces in place of the tubes' own weight; they count where the model alone leaves
    more than noise.

    Raises:
        Unobservable: too few measurements or loads, or a frame is left open.
        CtrError: the model has no shape at a measurement.

    """
    what = quantities(robot) if what is None else what
    loaded = int(np.count_nonzero(np.linalg.norm(forces, axis=1) > 0.05))
    if loaded < LEAST_LOADED and any(q.kind == "bending_stiffness" for q in what):
        raise Unobservable(
            f"{loaded} measurements under more than 0.05 N; without load only ratios of stiffness show:"
            f" hang a weight and measurement at least {LEAST_LOADED} poses"
        )
    if 3 * len(measurements) < len(what) + 9:
        raise Unobservable(
            f"{len(measurements)} measurements for {len(what) + 9} unknowns; measurement at least {len(what) + 9}"
        )
    problem = Prediction(robot, what, measurements, forces, noise, closed_form(robot, measurements, forces))
    found = fit(problem, problem.parameters)
    rough = found.variance_factor > ROUGH
    if rough:
        # What no tube of this model can tell (friction, clearance, a bent field) is as good as noise: what is known
        # beforehand weighs against that.
        problem = replace(problem, noise=noise.scaled(math.sqrt(found.variance_factor)), coil=COIL_KNOWN)
        if sags is not None:
            problem = replace(problem, forces=forces + sags)
        found = fit(problem, problem.parameters, found.values)
    open_ = [combination for combination in found.weak if not combination.held and combination.open > LOST]
    if open_:
        raise Unobservable(f"the visited poses cannot tell {open_[0]}; measurement more of the travel of every joint")
    errors = np.linalg.norm(problem.errors(found.values), axis=1)
    return TubeCalibration(problem.tubes(found.values), problem.frames(found.values), what, found, errors, rough)


def held_out(
    described: Robot, calibration: TubeCalibration, seen: tuple[Sequence[Measurement], Array],
    unseen: tuple[Sequence[Measurement], Array], noise: Noise,
) -> HeldOut:  # fmt: skip
    """What the calibration is worth where it was not made: measurements and their forces (k, 3) [N]."""
    measurements, forces = seen
    plain = Prediction(described, (), measurements, forces, noise, closed_form(described, measurements, forces))
    frames = plain.frames(fit(plain, plain.parameters).values)
    before = Prediction(described, (), *unseen, noise, frames)
    after = replace(before, robot=calibration.robot, start=calibration.frames)
    zero = np.zeros(len(before.parameters))
    return HeldOut(*(np.linalg.norm(each.errors(zero), axis=1) for each in (before, after)))
