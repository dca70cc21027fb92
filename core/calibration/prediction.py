"""What the tracker should see at every measurement, as a function of frames and tubes: the residuals of all fits.

    e_k = R (p_k) + t - (x(q_k, F_k; tubes) + A(q_k, F_k; tubes) c)

p is the coil in the tracker's frame, (R, t) the registration, x and A tip and frame of the innermost
tube by the model, c the coil in that frame. R is turned about the middle of the visited points, so that rotation
and translation do not get in each other's way. A coil that tells directions adds R a_k - A d for each.

A drive with play stays behind by half of it: q_k is the stage's position less half the play, times the way the joint
came (`Measurement.came`). With tubes to be found the plays are found, too, unless `lags` says otherwise; else they add
to the noise.

The load is measured, too: its error reaches the residual through the compliance, so that a measurement counts with
sigma_p^2 1 + sigma_F^2 C C^T.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from core.calibration.fit import Parameter
from core.calibration.measurements import Measurement, Noise
from core.calibration.quantities import Quantity, changed
from core.calibration.rigid import Rigid, rotation_of
from core.errors import NoSolution
from core.model.many import Solutions, solve_many
from core.model.statics import Statics
from core.robot.robot import Array, Robot

#: How far frames may be off before it matters [rad, m]; the coil sits within a few millimetres of the tip.
FRAME_ANGLE, FRAME_PLACE, COIL = 1e-2, 1e-3, 3e-3
#: Play of a drive that is expected beforehand [rad, m].
PLAY = {"rad": 3e-3, "m": 50e-6}
#: What is known of the coil's direction beforehand [rad].
COIL_TILT = 0.2


class NoShape(NoSolution):
    """The model has no shape at a measurement."""

    def __init__(self, measurement: int, text: str) -> None:
        super().__init__(text)
        self.measurement = measurement  #: its number


def predicted(
    robot: Robot, measurements: Sequence[Measurement], forces: Array, plays: Array | None = None,
    near: Solutions | None = None,
) -> Solutions:  # fmt: skip
    """The model at measurements under tip forces (m, 3) [N].

    Every joint is behind the way that it came by half of its play (n,). `near` are solutions nearby.
    """
    joints = np.array([measurement.joints for measurement in measurements])
    if plays is not None:
        came = [np.zeros(plays.size) if measurement.came is None else measurement.came for measurement in measurements]
        joints = joints - 0.5 * plays * np.array(came)
    wrenches = np.column_stack((forces, np.zeros((len(joints), 3))))
    return solve_many(Statics(robot, integrator="fourth_order"), joints, wrenches, near)


class Lag(NamedTuple):
    """How far a joint is expected to stay behind the way that it came."""

    joint: int
    play: float  #: expected beforehand, one standard deviation [rad or m]


class Frames(NamedTuple):
    """Where tracker and coil are."""

    registration: Rigid  #: tracker's frame -> robot's frame
    coil: Array  #: (3,) in the frame of the innermost tube's tip [m]
    tilt: Array  #: (3,) rotation vector of the coil's axes in that frame [rad]


@dataclass(frozen=True)
class Prediction:
    """The fit's problem.

    Parameters are the tubes' quantities and, if there are any, the joints' plays; then 3 + 3 of the registration, 3
    of the coil, and its tilt if it tells directions.
    """

    robot: Robot
    what: tuple[Quantity, ...]
    measurements: Sequence[Measurement]
    forces: Array  #: (m, 3) at the tip, world frame [N]
    noise: Noise
    start: Frames
    coil: float = COIL  #: how far from `start` the coil may be, one standard deviation [m]
    lags: tuple[Lag, ...] | None = None  #: whose plays are found; None: all with the tubes, as a drive's

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """What the fit finds about the frames, in the order of its numbers."""
        frames = [Parameter(f"frame rotation {axis}", "rad", FRAME_ANGLE) for axis in "xyz"]
        frames += [Parameter(f"frame position {axis}", "m", FRAME_PLACE) for axis in "xyz"]
        frames += [Parameter(f"coil {axis}", "m", COIL, self.coil) for axis in "xyz"]
        frames += [Parameter(f"coil tilt {axis}", "rad", COIL_TILT, COIL_TILT) for axis in "xyz"[: self._tilts]]
        joints = self.robot.joints
        plays = [Parameter(f"{joints[k].name} play", joints[k].unit, play, play) for k, play in self._plays]
        return (*(quantity.parameter(self.robot) for quantity in self.what), *plays, *frames)

    def residuals(self, values: Array) -> Array:
        """(3 m,) in standard deviations; with directions, 3 more for each."""
        return self._weighted(*self._errors(values, self.solutions(values)))

    def jacobian(self, values: Array) -> Array:
        """By the quantities: central differences of the solved model; by the frames: in closed form."""
        columns: list[Array] = []
        for k, parameter in enumerate(self.parameters[: self._first]):
            ends = np.stack((values, values))
            ends[:, k] = np.clip(values[k] + 1e-3 * parameter.size * np.array([1.0, -1.0]), *parameter.bounds)
            up, down = (self._errors(v, self.solutions(v)) for v in ends)
            difference = tuple((a - b) / (ends[0, k] - ends[1, k]) for a, b in zip(up, down, strict=True))
            columns.append(self._weighted(difference[0], difference[1]))
        frames = self.frames(values)
        solved = self.solutions(values)
        turned = self._turned(values)
        turning = rotation_of(values[self._first : self._first + 3])
        for k in range(6):
            place, direction = np.zeros((len(solved), 3)), np.zeros_like(self._directions)
            if k < 3:
                # exp(v + dv) = exp(J dv) exp(v) with the left Jacobian, by a difference: v is small
                step = np.zeros(3)
                step[k] = 1e-6
                rate = (
                    rotation_of(values[self._first : self._first + 3] + step) @ turning.T
                    - rotation_of(values[self._first : self._first + 3] - step) @ turning.T
                ) / 2e-6
                place = turned @ rate.T
                direction = (self._directions @ frames.registration.rotation.T) @ rate.T
            else:
                place[:, k - 3] = 1.0
            columns.append(self._weighted(place, direction))
        tips = solved.rotation
        columns += [self._weighted(-tips[:, :, k], np.zeros_like(self._directions)) for k in range(3)]
        for k in range(self._tilts):
            step = np.zeros(3)
            step[k] = 1e-6
            rate = (rotation_of(frames.tilt + step) - rotation_of(frames.tilt - step))[:, self._columns] / 2e-6
            columns.append(self._weighted(np.zeros((len(solved), 3)), -np.einsum("mij,jc->mci", tips, rate)))
        return np.column_stack(columns)

    def frames(self, values: Array) -> Frames:
        """Registration and coil at parameters (p,)."""
        own = values[self._first :]
        rotation = rotation_of(own[:3])
        base = self.start.registration
        position = rotation @ (base.position - self.middle) + self.middle + own[3:6]
        tilt = np.zeros(3)
        tilt[: self._tilts] = own[9:]
        return Frames(Rigid(rotation @ base.rotation, position), self.start.coil + own[6:9], self.start.tilt + tilt)

    def tubes(self, values: Array) -> Robot:
        """The robot at parameters (p,)."""
        return changed(self.robot, self.what, values)

    def solutions(self, values: Array) -> Solutions:
        """The model at every measurement.

        Raises:
            NoShape: it has none at one of them.

        """
        found = predicted(self.tubes(values), self.measurements, self.forces, self.plays(values), self._nominal)
        if found.failures:
            first = min(found.failures)
            raise NoShape(first, str(found.failures[first]))
        return found

    def errors(self, values: Array) -> Array:
        """Measured minus predicted coil (m, 3), robot's frame [m]."""
        return self._errors(values, self.solutions(values))[0]

    def plays(self, values: Array) -> Array:
        """Of every joint (n,) at parameters (p,) [rad or m]; 0 where none is asked for."""
        found = np.zeros(len(self.robot.joints))
        for lag, play in zip(self._plays, values[len(self.what) :], strict=False):
            found[lag.joint] = play
        return found

    @cached_property
    def _plays(self) -> tuple[Lag, ...]:
        """The plays that are asked for."""
        if self.lags is not None:
            return self.lags
        if not self.what or all(measurement.came is None for measurement in self.measurements):
            return ()
        return tuple(Lag(k, PLAY[joint.unit]) for k, joint in enumerate(self.robot.joints))

    @property
    def _first(self) -> int:
        """Where the frames' parameters begin."""
        return len(self.what) + len(self._plays)

    @cached_property
    def _nominal(self) -> Solutions:
        """Of the robot as it was believed to be."""
        return predicted(self.robot, self.measurements, self.forces).complete()

    @cached_property
    def _coils(self) -> Array:
        return np.array([measurement.coil for measurement in self.measurements])

    @cached_property
    def _directions(self) -> Array:
        """(m, c, 3) in the tracker's frame; c = 0 without any."""
        axes = [measurement.axes for measurement in self.measurements]
        if any(a is None for a in axes):
            return np.zeros((len(self.measurements), 0, 3))
        return np.array(axes)

    @property
    def _columns(self) -> slice:
        """Which axes of the coil are seen: z alone, or all."""
        return slice(2, 3) if self._directions.shape[1] == 1 else slice(0, self._directions.shape[1])

    @property
    def _tilts(self) -> int:
        """A coil without roll does not tell a turn about its own axis."""
        return {0: 0, 1: 2, 3: 3}[self._directions.shape[1]]

    @cached_property
    def middle(self) -> Array:
        """Mean of the visited points in the robot's frame (3,) [m]: the registration turns about it."""
        return self.start.registration.apply(self._coils).mean(axis=0)

    @cached_property
    def _weights(self) -> Array:
        """(m, 3, 3): inverse Cholesky factors of the measurements' covariances."""
        c = self._nominal.compliance[:, :3, :3]
        force = np.array([0.0 if m.weight == 0.0 else self.noise.force for m in self.measurements])[:, None, None]
        covariance = self.noise.coil**2 * np.eye(3) + force**2 * c @ c.transpose(0, 2, 1)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)

    def _turned(self, values: Array) -> Array:
        """Measured coils (m, 3) in the robot's frame, from the middle about which R turns."""
        own = values[self._first :]
        return (self.start.registration.apply(self._coils) - self.middle) @ rotation_of(own[:3]).T

    def _errors(self, values: Array, solved: Solutions) -> tuple[Array, Array]:
        """Of the positions (m, 3) [m] and of the directions (m, c, 3)."""
        frames = self.frames(values)
        turns = solved.rotation
        place = frames.registration.apply(self._coils) - solved.tip - turns @ frames.coil
        seen = self._directions @ frames.registration.rotation.T
        axes = rotation_of(frames.tilt)[:, self._columns]
        return place, seen - np.einsum("mij,jc->mci", turns, axes)

    def _weighted(self, place: Array, direction: Array) -> Array:
        whole = np.einsum("mij,mj->mi", self._weights, place).ravel()
        return np.concatenate((whole, direction.ravel() / self.noise.axes))
