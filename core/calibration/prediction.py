"""Predicted tracker measurements as a function of frames and tubes; the fits of frames and tubes use their residuals.

    e_k = R p_k + t - (x(q_k, F_k; tubes) + A(q_k, F_k; tubes) c)

is the residual of measurement k with joints q_k and tip force F_k. p_k is the coil in the tracker's frame, (R, t) the
registration, x the model's tip, A the frame of the innermost tube at the tip, and c the coil in that frame. R rotates
about the middle of the visited points, which decouples rotation and translation. A coil that measures directions a_k
adds the residual R a_k - A d for each direction d in the tip's frame.

A joint whose drive has play (backlash) lags by half of the play: q_k is the stage's position minus half the play times
the direction of the joint's last motion (`Measurement.came`). If `came` is known, a fit of tubes also fits the plays of
all joints, or of those in `lags`. A play that is not fitted adds to the noise. Tubes with friction lag by their wind-up
(`residual.wind_ups`), which is computed from `Measurement.path`.

An error of the measured load moves the model's tip through the compliance C. With the standard deviations sigma_p of
the coil's position and sigma_F of the force, the covariance of a residual is sigma_p^2 1 + sigma_F^2 C C^T.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from core.calibration.fit import Parameter
from core.calibration.measurements import Measurement, Noise
from core.calibration.quantities import Quantity, with_changes
from core.calibration.residual import EXPECTED_HALF_LAG_RAD, Windup, turned_tubes, wind_ups
from core.calibration.rigid_transform import RigidTransform, rotation_from_vector
from core.errors import CtrError, NoSolution
from core.model.batch import Solutions, solve_many
from core.model.statics import Statics
from core.robot.robot import Array, Robot

#: Largest turn of a joint between two measurements over which the shape is followed [rad]; the direction of a longer
#: turn, and the shapes in between, are unknown.
MAX_FOLLOWED_TURN_RAD = 1.0
#: Tolerances of the registration's rotation [rad] and position [m], and standard deviation of the prior of the coil's
#: offset from the tip in each axis [m].
FRAME_TOLERANCE_RAD, FRAME_TOLERANCE_M, COIL_OFFSET_PRIOR_M = 1e-2, 1e-3, 3e-3
#: Standard deviation of the prior of a drive's play, by the joint's unit [rad, m].
BACKLASH_PRIOR = {"rad": 3e-3, "m": 50e-6}
#: Standard deviation of the prior of the coil's tilt [rad].
COIL_TILT_PRIOR_RAD = 0.2


class NoEquilibrium(NoSolution):
    """The model has no shape at a measurement."""

    def __init__(self, measurement: int, text: str) -> None:
        super().__init__(text)
        self.measurement = measurement  #: index of the measurement


def predict(
    robot: Robot, measurements: Sequence[Measurement], forces: Array, plays: Array | None = None,
    near: Solutions | None = None, half_lags: Array | None = None,
) -> Solutions:  # fmt: skip
    """Solve the model at measurements under tip forces (m, 3) [N].

    Every joint lags behind its last motion by half of its play in `plays` (n,). Every tube lags by its wind-up for its
    half lag in `half_lags` (q,). `near` contains nearby solutions from which the solves start. Without `near`, ordered
    measurements (those with a path) follow the shape of the measurement before, if no tube turns far between both. All
    other measurements are solved from rest.
    """
    joints = np.array([measurement.joints for measurement in measurements])
    if plays is not None:
        came = [np.zeros(plays.size) if measurement.came is None else measurement.came for measurement in measurements]
        joints = joints - 0.5 * plays * np.array(came)
    if half_lags is not None and half_lags.any():
        wound = wind_ups(robot, np.array([measurement.path for measurement in measurements]), half_lags)
        for tube, joint in turned_tubes(robot):
            joints[:, joint] -= wound[:, tube]
    wrenches = np.column_stack((forces, np.zeros((len(joints), 3))))
    statics = Statics(robot, integrator="fourth_order")
    if near is not None or any(measurement.path is None for measurement in measurements):
        return solve_many(statics, joints, wrenches, near)
    turns = [joint.motion == "rotation" for joint in robot.joints]
    far = (np.abs(np.diff(joints[:, turns], axis=0)) > MAX_FOLLOWED_TURN_RAD).any(axis=1)
    runs = np.split(np.arange(len(joints)), np.flatnonzero(far) + 1)
    alone = np.array([run[0] for run in runs if run.size == 1], dtype=np.int64)
    parts = [(run, solve_many(statics, joints[run], wrenches[run], along=True)) for run in runs if run.size > 1]
    parts += [(alone, solve_many(statics, joints[alone], wrenches[alone]))] if alone.size else []
    numbers = np.empty((len(joints), parts[0][1].numbers.shape[1]))
    failures: dict[int, CtrError] = {}
    for rows, solved in parts:
        numbers[rows] = solved.numbers
        failures |= {int(rows[k]): error for k, error in solved.failures.items()}
    return Solutions(numbers, failures, len(robot.tubes), len(robot.joints))


class Lag(NamedTuple):
    """Expected lag of a joint behind its last motion."""

    joint: int  #: index of the joint
    play: float  #: standard deviation of the prior of the joint's play [rad or m]


class Frames(NamedTuple):
    """Poses of the tracker in the robot's frame and of the coil in the tip's frame."""

    registration: RigidTransform  #: transform from the tracker's frame to the robot's frame
    coil: Array  #: (3,) position of the coil in the frame of the innermost tube's tip [m]
    tilt: Array  #: (3,) rotation vector of the coil's axes in the tip's frame [rad]


@dataclass(frozen=True)
class Prediction:
    """Fit problem that compares tracker measurements with the model.

    The parameters are, in this order: the tubes' quantities, the joints' plays, the tubes' half lags (each only if
    there are any), 3 + 3 of the registration, 3 of the coil's position, and the coil's tilt if the coil measures
    directions.
    """

    robot: Robot
    what: tuple[Quantity, ...]
    measurements: Sequence[Measurement]
    forces: Array  #: (m, 3) forces at the tip, world frame [N]
    noise: Noise
    start: Frames
    coil: float = COIL_OFFSET_PRIOR_M  #: prior of the coil's deviation from `start`, one standard deviation [m]
    lags: tuple[Lag, ...] | None = None  #: joints with a fitted play; None: all joints, if tubes are fitted
    windups: tuple[Windup, ...] = ()  #: tubes with a fitted half lag

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the fit, in the order of its values."""
        frames = [Parameter(f"frame rotation {axis}", "rad", FRAME_TOLERANCE_RAD) for axis in "xyz"]
        frames += [Parameter(f"frame position {axis}", "m", FRAME_TOLERANCE_M) for axis in "xyz"]
        frames += [Parameter(f"coil {axis}", "m", COIL_OFFSET_PRIOR_M, self.coil) for axis in "xyz"]
        frames += [
            Parameter(f"coil tilt {axis}", "rad", COIL_TILT_PRIOR_RAD, COIL_TILT_PRIOR_RAD)
            for axis in "xyz"[: self._tilts]
        ]
        joints = self.robot.joints
        plays = [Parameter(f"{joints[k].name} play", joints[k].unit, play, play) for k, play in self._plays]
        expected, upper = EXPECTED_HALF_LAG_RAD, math.inf
        wound = [
            Parameter(f"{self.robot.tubes[each.tube].name} half lag", "rad", expected, expected, (0.0, upper))
            for each in self.windups
        ]
        return (*(quantity.parameter(self.robot) for quantity in self.what), *plays, *wound, *frames)

    def residuals(self, values: Array) -> Array:
        """Return residuals (3 m,) in standard deviations; each measured direction adds 3 residuals."""
        return self._weighted(*self._errors(values, self.solutions(values)))

    def jacobian(self, values: Array) -> Array:
        """Return the residuals' derivatives: by tube parameters with central differences, by frames in closed form."""
        columns: list[Array] = []
        solved = self.solutions(values)
        for k, parameter in enumerate(self.parameters[: self._first]):
            ends = np.stack((values, values))
            ends[:, k] = np.clip(values[k] + 1e-3 * parameter.size * np.array([1.0, -1.0]), *parameter.bounds)
            up, down = (self._errors(v, self.solutions(v)) for v in ends)
            difference = tuple((a - b) / (ends[0, k] - ends[1, k]) for a, b in zip(up, down, strict=True))
            columns.append(self._weighted(difference[0], difference[1]))
        frames, turned = self.frames(values), self._turned(values)
        turning = rotation_from_vector(values[self._first : self._first + 3])
        for k in range(6):
            position, direction = np.zeros((len(solved), 3)), np.zeros_like(self._directions)
            if k < 3:
                # Derivative of the rotation by its vector v: exp(v + dv) = exp(J dv) exp(v), by a difference quotient.
                step = np.zeros(3)
                step[k] = 1e-6
                rate = (
                    rotation_from_vector(values[self._first : self._first + 3] + step) @ turning.T
                    - rotation_from_vector(values[self._first : self._first + 3] - step) @ turning.T
                ) / 2e-6
                position = turned @ rate.T
                direction = (self._directions @ frames.registration.rotation.T) @ rate.T
            else:
                position[:, k - 3] = 1.0
            columns.append(self._weighted(position, direction))
        tips = solved.rotation
        columns += [self._weighted(-tips[:, :, k], np.zeros_like(self._directions)) for k in range(3)]
        for k in range(self._tilts):
            step = np.zeros(3)
            step[k] = 1e-6
            rate = (rotation_from_vector(frames.tilt + step) - rotation_from_vector(frames.tilt - step))[
                :, self._columns
            ] / 2e-6
            columns.append(self._weighted(np.zeros((len(solved), 3)), -np.einsum("mij,jc->mci", tips, rate)))
        return np.column_stack(columns)

    def frames(self, values: Array) -> Frames:
        """Return registration and coil at parameters (p,)."""
        own = values[self._first :]
        rotation = rotation_from_vector(own[:3])
        base = self.start.registration
        position = rotation @ (base.position - self.middle) + self.middle + own[3:6]
        tilt = np.zeros(3)
        tilt[: self._tilts] = own[9:]
        return Frames(
            RigidTransform(rotation @ base.rotation, position), self.start.coil + own[6:9], self.start.tilt + tilt
        )

    def tubes(self, values: Array) -> Robot:
        """Return the robot at parameters (p,)."""
        return with_changes(self.robot, self.what, values)

    def solutions(self, values: Array) -> Solutions:
        """Solve the model at every measurement; the frames do not change the solutions.

        Raises:
            NoEquilibrium: the model has no shape at a measurement.

        """
        key = values[: self._first].tobytes()
        if key in self._latest:
            return self._latest[key]
        half_lags = self.half_lags(values)
        tubes, plays = self.tubes(values), self.plays(values)
        found = predict(tubes, self.measurements, self.forces, plays, self._nominal, half_lags)
        if found.failures:
            first = min(found.failures)
            raise NoEquilibrium(first, str(found.failures[first]))
        self._latest.clear()
        self._latest[key] = found
        return found

    def errors(self, values: Array) -> Array:
        """Return measured minus predicted coil position (m, 3), robot's frame [m]."""
        return self._errors(values, self.solutions(values))[0]

    def plays(self, values: Array) -> Array:
        """Return the play of every joint (n,) at parameters (p,) [rad or m]; 0 where it is not fitted."""
        found = np.zeros(len(self.robot.joints))
        for lag, play in zip(self._plays, values[len(self.what) :], strict=False):
            found[lag.joint] = play
        return found

    def half_lags(self, values: Array) -> Array:
        """Return the half lag of every tube (q,) at parameters (p,) [rad]; 0 where it is not fitted."""
        found, first = np.zeros(len(self.robot.tubes)), len(self.what) + len(self._plays)
        for each, half_lag in zip(self.windups, values[first:], strict=False):
            found[each.tube] = half_lag
        return found

    @cached_property
    def _plays(self) -> tuple[Lag, ...]:
        """Joints whose play is fitted, with their priors."""
        if self.lags is not None:
            return self.lags
        if not self.what or all(measurement.came is None for measurement in self.measurements):
            return ()
        return tuple(Lag(k, BACKLASH_PRIOR[joint.unit]) for k, joint in enumerate(self.robot.joints))

    @property
    def _first(self) -> int:
        """Index of the first frame parameter."""
        return len(self.what) + len(self._plays) + len(self.windups)

    @cached_property
    def _latest(self) -> dict[bytes, Solutions]:
        """The latest solutions, by the parameters of tubes, plays and half lags."""
        return {}

    @cached_property
    def _nominal(self) -> Solutions:
        """Solutions of the robot with the robot file's values."""
        return predict(self.robot, self.measurements, self.forces).complete()

    @cached_property
    def _coils(self) -> Array:
        return np.array([measurement.coil for measurement in self.measurements])

    @cached_property
    def _directions(self) -> Array:
        """Measured coil directions (m, c, 3) in the tracker's frame; c = 0 if the coil measures no direction."""
        axes = [measurement.axes for measurement in self.measurements]
        if any(a is None for a in axes):
            return np.zeros((len(self.measurements), 0, 3))
        return np.array(axes)

    @property
    def _columns(self) -> slice:
        """Measured axes of the coil as a slice of x, y, z: z alone, or all."""
        return slice(2, 3) if self._directions.shape[1] == 1 else slice(0, self._directions.shape[1])

    @property
    def _tilts(self) -> int:
        """Number of fitted tilt angles: a coil without roll does not measure the rotation about its axis."""
        return {0: 0, 1: 2, 3: 3}[self._directions.shape[1]]

    @cached_property
    def middle(self) -> Array:
        """Mean of the measured coil positions in the robot's frame (3,) [m]: centre of the fitted rotation."""
        return self.start.registration.apply(self._coils).mean(axis=0)

    @cached_property
    def _weights(self) -> Array:
        """Inverse Cholesky factors of the measurements' covariances (m, 3, 3)."""
        c = self._nominal.compliance[:, :3, :3]
        force = np.array([0.0 if m.weight == 0.0 else self.noise.force for m in self.measurements])[:, None, None]
        covariance = self.noise.coil**2 * np.eye(3) + force**2 * c @ c.transpose(0, 2, 1)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)

    def _turned(self, values: Array) -> Array:
        """Return measured coils (m, 3) in the robot's frame, relative to the centre of rotation of R."""
        own = values[self._first :]
        return (self.start.registration.apply(self._coils) - self.middle) @ rotation_from_vector(own[:3]).T

    def _errors(self, values: Array, solved: Solutions) -> tuple[Array, Array]:
        """Return errors of the positions (m, 3) [m] and of the directions (m, c, 3)."""
        frames = self.frames(values)
        turns = solved.rotation
        position = frames.registration.apply(self._coils) - solved.tip - turns @ frames.coil
        measured = self._directions @ frames.registration.rotation.T
        axes = rotation_from_vector(frames.tilt)[:, self._columns]
        return position, measured - np.einsum("mij,jc->mci", turns, axes)

    def _weighted(self, position: Array, direction: Array) -> Array:
        weighted = np.einsum("mij,mj->mi", self._weights, position).ravel()
        return np.concatenate((weighted, direction.ravel() / self.noise.axes))
