"""Registration of the tracker to the robot and of the coil to the tip, from poses at rest (`Measurement`).

The fit starts from Kabsch's closed form between coil positions and the model's tips. A least-squares fit then finds
rotation, translation, the coil's position in the tip's frame and, if the coil measures directions, its tilt. The tubes
keep the robot file's values. If the real tubes differ from these values, the residuals are millimetres and the
covariance grows accordingly. The module `tubes` fits frames and tubes together.

The rotation about z is relative to the zero angle of the outermost rotating tube. A zero error of that stage and a
rotation of the whole tracker about z have the same effect on every measurement.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from core.calibration.fit import Fit, UnobservableCombination, fit, weak_combinations
from core.calibration.measurements import Measurement, Noise
from core.calibration.prediction import Frames, Prediction, predict
from core.calibration.quantities import quantities
from core.calibration.rigid_transform import kabsch
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array, Robot

#: Number n: every n-th measurement is held out, which means that the fit excludes it and its error checks the result.
HOLD_OUT_EVERY = 4
#: Smallest number of measurements for a registration with held-out checks.
MIN_MEASUREMENTS = 6
#: Assumed error of the model [m]. The motion must determine the frames in spite of this error; otherwise small moves
#: with small noise would appear sufficient.
MODEL_ERROR_M = 0.3e-3
#: Largest accepted standard deviation of a combination of frame parameters, in tolerances. A robot whose outer tube is
#: nearly straight turns about z on a small circle, which determines the frame's rotation less accurately.
MAX_OPEN_FRAME = 1.0
#: Factor on the expected Jacobian of a suggested motion; below 1, so that the motion is sufficient in practice.
INFORMATION_RESERVE = 0.7
#: Amplitudes of single-joint motions that are tested to find the missing motion, by unit of the joint [rad, m].
MOTION_AMPLITUDES = {
    "rad": tuple(math.radians(a) for a in (10, 20, 30, 45, 60, 90, 120, 180)),
    "m": (0.005, 0.010, 0.020, 0.040),
}


class Registration(NamedTuple):
    """Result of a registration: the estimated frames and their errors."""

    frames: Frames
    fit: Fit
    errors: Array  #: (m,) distance of each coil from the model's prediction [m]
    held_out: Array  #: (k,) distance of each held-out coil from the model's prediction [m]

    @property
    def rms(self) -> float:
        """Root mean square of the errors [m]."""
        return float(np.sqrt(np.mean(self.errors**2)))


def closed_form(robot: Robot, measurements: Sequence[Measurement], forces: Array) -> Frames:
    """Return the frames from Kabsch's closed form, with the assumption that the coil is at the tip."""
    tips = predict(robot, measurements, forces).complete().tip
    return Frames(kabsch(np.array([measurement.coil for measurement in measurements]), tips), np.zeros(3), np.zeros(3))


def register(
    robot: Robot, measurements: Sequence[Measurement], forces: Array, noise: Noise, limits: Limits | None = None
) -> Registration:
    """Fit the frames to measurements under known tip forces (m, 3) [N].

    Raises:
        UnobservableCombination: too few measurements, or too little motion; the text names the missing motion.
        CtrError: the model has no shape at a measurement.

    """
    if len(measurements) < MIN_MEASUREMENTS:
        raise UnobservableCombination(
            f"{len(measurements)} measurements; a registration that can be checked needs at least {MIN_MEASUREMENTS}"
        )
    start = closed_form(robot, measurements, forces)
    problem = Prediction(robot, (), measurements, forces, noise, start)
    found = fit(problem, problem.parameters)
    rows = found.jacobian * min(noise.coil / MODEL_ERROR_M, 1.0)
    weak = weak_combinations(rows, problem.parameters)
    if open_ := [c for c in weak if not c.fixed_by_prior and c.open > MAX_OPEN_FRAME]:
        raise UnobservableCombination(
            f"the visited poses do not determine {open_[0]}: {missing_motion(problem, found, limits)}"
        )
    held_out = held_out_errors(robot, measurements, forces, noise, start)
    found = _with_tube_errors(problem, found)
    errors = np.linalg.norm(problem.errors(found.values), axis=1)
    return Registration(problem.frames(found.values), found, errors, held_out)


def _with_tube_errors(problem: Prediction, found: Fit) -> Fit:
    """Return the fit with wider intervals for errors of the tubes, which shift frames and coil alike at all poses."""
    what = quantities(problem.robot, [measurement.joints for measurement in problem.measurements])
    wide = replace(problem, what=what, lags=())
    parameters = wide.parameters[: len(what)]
    sensitivity = wide.jacobian(np.concatenate((np.zeros(len(what)), found.values)))[:, : len(what)]
    return found.with_model_errors(sensitivity, np.array([parameter.prior for parameter in parameters]))


def held_out_errors(
    robot: Robot, measurements: Sequence[Measurement], forces: Array, noise: Noise, start: Frames
) -> Array:
    """Return the distances [m] at every `HOLD_OUT_EVERY`-th measurement after a fit to the other measurements."""
    out = np.arange(len(measurements)) % HOLD_OUT_EVERY == HOLD_OUT_EVERY - 1
    used = Prediction(
        robot, (), [v for v, o in zip(measurements, out, strict=True) if not o], forces[~out], noise, start
    )
    found = fit(used, used.parameters)
    rest = Prediction(
        robot,
        (),
        [v for v, o in zip(measurements, out, strict=True) if o],
        forces[out],
        noise,
        used.frames(found.values),
    )
    return np.linalg.norm(rest.errors(np.zeros(len(rest.parameters))), axis=1)


def missing_motion(problem: Prediction, found: Fit, limits: Limits | None) -> str:
    """Return a text that names the joint that has to move, and by how much, to determine all frame parameters."""
    joints, frames = (
        np.array([measurement.joints for measurement in problem.measurements]),
        problem.frames(found.values),
    )
    assumed = problem.noise._replace(coil=max(problem.noise.coil, MODEL_ERROR_M))
    moved: list[float] = np.ptp(joints, axis=0).tolist()
    best = (math.inf, "")
    for k, joint in enumerate(problem.robot.joints):
        for amount in MOTION_AMPLITUDES[joint.unit]:
            # Simulate the same poses again, with this joint moved alternately in both directions.
            extra = joints.copy()
            extra[:, k] += amount * np.where(np.arange(len(extra)) % 2 == 0, 1.0, -1.0)
            if limits is not None:
                extra = np.clip(extra, [j.lower for j in limits.joints], [j.upper for j in limits.joints])
            if not all(problem.robot.is_valid_pose(pose) for pose in extra):
                continue
            added = [Measurement(0.0, pose, np.zeros(3), np.empty((0, 6)), 0.0) for pose in extra]
            measurements = [*problem.measurements, *_tracked(problem, added, frames)]
            forces = np.vstack((problem.forces, np.zeros((len(extra), 3))))
            more = Prediction(problem.robot, (), measurements, forces, assumed, frames)
            weak = weak_combinations(
                INFORMATION_RESERVE * more.jacobian(np.zeros(len(more.parameters))), more.parameters
            )
            left = max((c.open for c in weak if not c.fixed_by_prior), default=0.0)
            text = _moved(joint.name, joint.unit, amount, moved[k])
            if left == 0.0:
                return text
            best = min(best, (left, text))
    return f"{best[1]}, then the other joints"


def _moved(name: str, unit: str, amount: float, so_far: float) -> str:
    if unit == "rad":
        by, turned = math.degrees(amount), math.degrees(so_far)
        return f"turn {name} by {by:.0f} deg in both directions (it turned {turned:.1f} deg so far)"
    return f"slide {name} by {1e3 * amount:g} mm in both directions (it slid {1e3 * so_far:.1f} mm so far)"


def _tracked(problem: Prediction, measurements: Sequence[Measurement], frames: Frames) -> list[Measurement]:
    """Return the measurements with the tracker data that the model predicts."""
    model, back = Statics(problem.robot, integrator="fourth_order"), frames.registration.inverse()
    simulated: list[Measurement] = []
    for measurement in measurements:
        pose = model.solve(measurement.joints, np.zeros(6))
        axes = None
        if problem.measurements[0].axes is not None:
            axes = pose.rotation.T[-problem.measurements[0].axes.shape[0] :] @ back.rotation.T
        simulated.append(measurement._replace(coil=back.apply(pose.tip + pose.rotation @ frames.coil), axes=axes))
    return simulated
