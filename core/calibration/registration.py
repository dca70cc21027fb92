"""Tracker to robot, and coil to tip: from poses where the robot rested (`Measurement`).

Start: the closed form of Kabsch between the coil's places and the model's tips. Then least squares over rotation,
translation, the coil's place in the tip's frame and, when it tells directions, its tilt. The model's tubes are taken
as they are: with tubes that differ from their description the residuals are millimetres and the
covariance says so; `tubes` then fits both together.

The rotation about z is counted from the zero angle of the outermost tube that turns: a zero error of that stage and a
turn of the whole tracker about z are one and the same to every measurement.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from core.calibration.fit import Fit, Unobservable, fit, weak_combinations
from core.calibration.measurements import Measurement, Noise
from core.calibration.prediction import Frames, Prediction, predicted
from core.calibration.rigid import kabsch
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array, Robot

#: Every so many-th measurement is held out of the check's fit.
HOLD_OUT = 4
#: Fewer cannot be checked against each other.
LEAST_MEASUREMENTS = 6
#: The motion must be enough to determine the frames even if the model is no better than this [m]: what small moves
#: and small noise seem to tell, the model's own error would spoil.
MODEL_ERROR = 0.3e-3
#: What is named must be enough: as if it told this part of what it does.
SPARE = 0.7
#: Turns and slides that are tried, one joint at a time, to say which motion is missing.
AMOUNTS = {"rad": tuple(math.radians(a) for a in (10, 20, 30, 45, 60, 90, 120, 180)), "m": (0.005, 0.010, 0.020, 0.040)}


class Registration(NamedTuple):
    """The frames, and how good they are."""

    frames: Frames
    fit: Fit
    errors: Array  #: (m,) distance of each coil from where the model puts it [m]
    held_out: Array  #: (k,) the same for measurements that the fit had not seen [m]
    middle: Array  #: (3,) about which the rotation was turned [m]

    @property
    def rms(self) -> float:
        """Root mean square of the errors [m]."""
        return float(np.sqrt(np.mean(self.errors**2)))

    def error_at(self, points: Array) -> Array:
        """Standard deviation (m,) with which points (m, 3) of the robot's frame are registered [m].

        The covariance of rotation and translation, carried to the place where it is asked for.
        """
        names = [p.name for p in self.fit.parameters]
        first = names.index("frame rotation x")
        covariance = self.fit.covariance[first : first + 6, first : first + 6]
        return np.array([math.sqrt(float(np.trace(j @ covariance @ j.T))) for j in map(self._carry, points)])

    def _carry(self, point: Array) -> Array:
        x, y, z = point - self.middle
        return np.hstack((np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]), np.eye(3)))


def closed_form(robot: Robot, measurements: Sequence[Measurement], forces: Array) -> Frames:
    """Frames with the coil at the tip."""
    tips = predicted(robot, measurements, forces).complete().tip
    return Frames(kabsch(np.array([measurement.coil for measurement in measurements]), tips), np.zeros(3), np.zeros(3))


def register(
    robot: Robot, measurements: Sequence[Measurement], forces: Array, noise: Noise, limits: Limits | None = None
) -> Registration:
    """Fit the frames to measurements under known tip forces (m, 3) [N].

    Raises:
        Unobservable: too few measurements, or the robot has not moved enough to tell; with the missing motion.
        CtrError: the model has no shape at a measurement.

    """
    if len(measurements) < LEAST_MEASUREMENTS:
        raise Unobservable(
            f"{len(measurements)} measurements; a registration that can be checked needs at least {LEAST_MEASUREMENTS}"
        )
    start = closed_form(robot, measurements, forces)
    problem = Prediction(robot, (), measurements, forces, noise, start)
    found = fit(problem, problem.parameters)
    rows = found.jacobian * min(noise.coil / MODEL_ERROR, 1.0)
    if open_ := [c for c in weak_combinations(rows, problem.parameters) if not c.held]:
        raise Unobservable(f"the visited poses cannot tell {open_[0]}: {missing_motion(problem, found, limits)}")
    held = held_out_errors(robot, measurements, forces, noise, start)
    errors = np.linalg.norm(problem.errors(found.values), axis=1)
    return Registration(problem.frames(found.values), found, errors, held, problem.middle)


def held_out_errors(
    robot: Robot, measurements: Sequence[Measurement], forces: Array, noise: Noise, start: Frames
) -> Array:
    """Distances [m] at every `HOLD_OUT`-th measurement after a fit to the others."""
    out = np.arange(len(measurements)) % HOLD_OUT == HOLD_OUT - 1
    kept = Prediction(
        robot, (), [v for v, o in zip(measurements, out, strict=True) if not o], forces[~out], noise, start
    )
    found = fit(kept, kept.parameters)
    rest = Prediction(
        robot,
        (),
        [v for v, o in zip(measurements, out, strict=True) if o],
        forces[out],
        noise,
        kept.frames(found.values),
    )
    return np.linalg.norm(rest.errors(np.zeros(len(rest.parameters))), axis=1)


def missing_motion(problem: Prediction, found: Fit, limits: Limits | None) -> str:
    """Which joint has to move, and by how much, for every frame to be determined."""
    joints, frames = (
        np.array([measurement.joints for measurement in problem.measurements]),
        problem.frames(found.values),
    )
    assumed = problem.noise._replace(coil=max(problem.noise.coil, MODEL_ERROR))
    moved: list[float] = np.ptp(joints, axis=0).tolist()
    best = (math.inf, "")
    for k, joint in enumerate(problem.robot.joints):
        for amount in AMOUNTS[joint.unit]:
            # The same poses again, with this joint moved one way or the other.
            extra = joints.copy()
            extra[:, k] += amount * np.where(np.arange(len(extra)) % 2 == 0, 1.0, -1.0)
            if limits is not None:
                extra = np.clip(extra, [j.lower for j in limits.joints], [j.upper for j in limits.joints])
            if not all(problem.robot.stands(pose) for pose in extra):
                continue
            added = [Measurement(0.0, e, np.zeros(3), np.zeros((len(problem.robot.tubes), 6)), 0.0) for e in extra]
            measurements = [*problem.measurements, *_seen(problem, added, frames)]
            forces = np.vstack((problem.forces, np.zeros((len(extra), 3))))
            more = Prediction(problem.robot, (), measurements, forces, assumed, frames)
            weak = weak_combinations(SPARE * more.jacobian(np.zeros(len(more.parameters))), more.parameters)
            left = max((c.open for c in weak if not c.held), default=0.0)
            text = _moved(joint.name, joint.unit, amount, moved[k])
            if left == 0.0:
                return text
            best = min(best, (left, text))
    return f"{best[1]}, and then the other joints"


def _moved(name: str, unit: str, amount: float, so_far: float) -> str:
    if unit == "rad":
        by, turned = math.degrees(amount), math.degrees(so_far)
        return f"turn {name} by {by:.0f} deg either way (it turned {turned:.1f} deg so far)"
    return f"slide {name} by {1e3 * amount:g} mm either way (it slid {1e3 * so_far:.1f} mm so far)"


def _seen(problem: Prediction, measurements: Sequence[Measurement], frames: Frames) -> list[Measurement]:
    """Measurements with what the tracker would see there."""
    model, back = Statics(problem.robot, integrator="fourth_order"), frames.registration.inverse()
    seen: list[Measurement] = []
    for measurement in measurements:
        pose = model.solve(measurement.joints, np.zeros(6))
        axes = None
        if problem.measurements[0].axes is not None:
            axes = pose.rotation.T[-problem.measurements[0].axes.shape[0] :] @ back.rotation.T
        seen.append(measurement._replace(coil=back.apply(pose.tip + pose.rotation @ frames.coil), axes=axes))
    return seen
