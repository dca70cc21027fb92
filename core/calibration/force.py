"""Base force sensors: offset, drift, mounting angles and the weight that hangs on them, from a set of poses.

Sensor i, mounted a little askew (R_i), with the weight W_i of what is fixed to it at c_i, reads

    (1 - S_i) (y_i - b_i - d_i (t - t_0)) = R_i^T (w_i + g_i),    g_i = (W_i Rz(alpha)^T e, c_i x W_i Rz(alpha)^T e),

w_i being what the tube exerts on it, S_i (6, 6) its errors of gain and cross-talk and e the direction of gravity.
What the tubes do to each other is in every w_i and unknown, so one sensor alone cannot be calibrated on a robot; in
the sum over the sensors it cancels, and the sum must be the load: nothing, or a known weight W e at the tip r with
the moment r x W e, or an unknown force F of which only the moment equation M = r x F is known. What the sum does not
see (how an axial offset is shared out between the sensors, say) does not matter to the load, and the account says so.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from core.calibration.fit import Fit, Parameter, Unobservable, fit
from core.calibration.measurements import Measurement, Noise
from core.calibration.rigid import rotation_of
from core.compiled import compiled
from core.control.force_fusion import Fused, fuse_at, fused_at
from core.control.sensors import Sensors, exerted
from core.robot.robot import Array, Layout, Robot, tube_poses

#: What is known beforehand, one standard deviation, and how far each may be off before it matters.
OFFSET, OFFSET_SIZE = (2.0, 30e-3), (5e-3, 0.2e-3)  # [N], [N m]
DRIFT, DRIFT_SIZE = (10e-3 / 60.0, 1e-3 / 60.0), (5e-3 / 60.0, 0.2e-3 / 60.0)  # [N/s], [N m/s]
MOUNTING, MOUNTING_SIZE = 0.05, 0.01  # [rad]
WEIGHT, WEIGHT_SIZE = 0.5, 5e-3  # [N]
FIRST_MOMENT, FIRST_MOMENT_SIZE = 20e-3, 0.2e-3  # weight times its distance [N m]
#: Gain and cross-talk: parts of an axis's range by another's, as a maker's accuracy is told (ATI: 1 %).
SKEW, SKEW_SIZE = 0.006, 2e-3
RANGES = (18.0, 18.0, 18.0, 0.25, 0.25, 0.25)  # of the axes, a Nano43 SI-18-0.25 [N, N m]
#: Of a load that nobody has weighed [N].
TYPICAL_FORCE = 0.5
#: Fewer cannot tell an offset that turns with its sensor from a weight that does not.
LEAST_MEASUREMENTS = 8


class SensorCalibration(NamedTuple):
    """Sensors as they were found to be."""

    sensors: Sensors
    offset: Array  #: (q, 6) at `time` [N, N m]
    drift: Array  #: (q, 6) [N/s, N m/s]
    time: float  #: [s]
    fit: Fit

    def load(self, robot: Robot, measurement: Measurement) -> Fused:
        """Load of the whole robot at a measurement, world frame."""
        readings = measurement.wrenches - self.offset - (measurement.time - self.time) * self.drift
        alpha, _ = robot.tube_poses(measurement.joints)
        return fuse_at(robot, measurement.joints, self.sensors.exerted(readings, alpha))


class WeightCheck(NamedTuple):
    """A known weight as it was measured."""

    force: Array  #: (3,) mean [N]
    magnitude: float  #: of it [N]
    error: float  #: magnitude - known [N]
    angle: float  #: between it and gravity [rad]


def calibrate_sensors(
    robot: Robot,
    measurements: Sequence[Measurement],
    tips: Array,
    noise: Noise,
    tip_error: float,
    gravity: Array | None = None,
) -> SensorCalibration:
    """Fit the sensors to measurements with the tip at `tips` (m, 3), world frame [m].

    Args:
        robot: for the poses of the tubes.
        measurements: untared; some without load, and best some under a known weight.
        tips: as measured.
        noise: of the fused loads.
        tip_error: standard deviation of each component of `tips` [m].
        gravity: its direction (3,), world frame; +x when left out.

    Raises:
        Unobservable: too few measurements without load, or all at the same rotations.

    """
    free = [measurement for measurement in measurements if measurement.weight == 0.0]
    if len(free) < LEAST_MEASUREMENTS:
        raise Unobservable(
            f"{len(free)} measurements without load; the sensors' offsets need at least {LEAST_MEASUREMENTS}"
        )
    for j, joint in enumerate(robot.joints):
        turned = float(np.ptp([measurement.joints[j] for measurement in free]))
        if joint.motion == "rotation" and turned < 1.0:
            raise Unobservable(
                f"an offset that turns with the sensor of tube '{robot.tubes[joint.tube].name}' cannot be told from a"
                f" weight: turn {joint.name} by more than 60 deg without load (it turned {np.degrees(turned):.1f} deg)"
            )
    down = np.array([1.0, 0.0, 0.0]) if gravity is None else gravity / np.linalg.norm(gravity)
    problem = _Sum(robot, measurements, tips, tip_error, noise, down)
    found = fit(problem, problem.parameters)
    return SensorCalibration(*problem.unpacked(found.values), problem.middle, found)


def check_weight(loads: Array, known: float, gravity: Array) -> WeightCheck:
    """Measured forces (m, 3) against a known weight [N] that hangs along `gravity` (3,)."""
    force = loads.mean(axis=0)
    magnitude = float(np.linalg.norm(force))
    cosine = float(force @ gravity) / (magnitude * float(np.linalg.norm(gravity)))
    return WeightCheck(force, magnitude, magnitude - known, float(np.arccos(np.clip(cosine, -1.0, 1.0))))


@dataclass(frozen=True)
class _Sum:
    """The fit's problem: the sum of all sensors is the load."""

    robot: Robot
    measurements: Sequence[Measurement]
    tips: Array
    tip_error: float
    noise: Noise
    down: Array

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        found: list[Parameter] = []
        for tube in self.robot.tubes:
            for what, sizes, priors, per in (("offset", OFFSET_SIZE, OFFSET, ""), ("drift", DRIFT_SIZE, DRIFT, "/s")):
                for name, unit, size, prior in zip(("force", "moment"), ("N", "N m"), sizes, priors, strict=True):
                    found += [Parameter(f"{tube.name} {name} {what} {a}", unit + per, size, prior) for a in "xyz"]
            found += [Parameter(f"{tube.name} mounting {a}", "rad", MOUNTING_SIZE, MOUNTING) for a in "xyz"]
            found.append(Parameter(f"{tube.name} weight", "N", WEIGHT_SIZE, WEIGHT))
            found += [Parameter(f"{tube.name} first moment {a}", "N m", FIRST_MOMENT_SIZE, FIRST_MOMENT) for a in "xyz"]
            found += [
                Parameter(f"{tube.name} {to} of {by}", per, SKEW_SIZE * scale, SKEW * scale)
                for to, by, per, scale in _axes()
            ]
        return tuple(found)

    @cached_property
    def middle(self) -> float:
        """Time from which the drift counts [s]."""
        return float(np.mean([measurement.time for measurement in self.measurements]))

    def unpacked(self, values: Array) -> tuple[Sensors, Array, Array]:
        """Sensors, offset (q, 6) and drift (q, 6)."""
        rows = values.reshape(len(self.robot.tubes), -1)
        mounting = np.array([rotation_of(row[12:15]) for row in rows])
        gravity = self.robot.base.rotation.T @ self.down
        skew = rows[:, 19:].reshape(-1, 6, 6)
        sensors = Sensors(mounting, rows[:, 15].copy(), rows[:, 16:19].copy(), gravity, skew)
        return sensors, rows[:, :6], rows[:, 6:12]

    def residuals(self, values: Array) -> Array:
        """(6 m,): force and moment of every measurement; of an unknown force only the moment equation."""
        sensors, offset, drift = self.unpacked(values)
        since, joints, readings = self._measured
        left = readings - offset - since[:, None, None] * drift
        loads = _loads(
            self.robot.layout, joints, left, sensors.matrix, sensors.weight, sensors.first_moment, sensors.gravity
        )
        forces, moments = loads[:, :3], loads[:, 3:]
        expected, known, force_noise, moment_noise = self._expected
        acting = np.where(known, expected, forces)
        closure = np.stack([
            moments[:, 0] - (self.tips[:, 1] * acting[:, 2] - self.tips[:, 2] * acting[:, 1]),
            moments[:, 1] - (self.tips[:, 2] * acting[:, 0] - self.tips[:, 0] * acting[:, 2]),
            moments[:, 2] - (self.tips[:, 0] * acting[:, 1] - self.tips[:, 1] * acting[:, 0]),
        ], axis=1)  # fmt: skip
        return np.concatenate((((forces - acting) / force_noise).ravel(), (closure / moment_noise).ravel()))

    def jacobian(self, values: Array) -> Array:
        """Central differences: the residuals are linear in all but the mounting angles."""
        columns: list[Array] = []
        for k, parameter in enumerate(self.parameters):
            half = np.zeros_like(values)
            half[k] = 1e-2 * parameter.size
            columns.append((self.residuals(values + half) - self.residuals(values - half)) / (2.0 * half[k]))
        return np.column_stack(columns)

    @cached_property
    def _measured(self) -> tuple[Array, Array, Array]:
        """Times from the middle (m,), joints (m, n), readings (m, q, 6)."""
        return (
            np.array([measurement.time for measurement in self.measurements]) - self.middle,
            np.array([measurement.joints for measurement in self.measurements]),
            np.array([measurement.wrenches for measurement in self.measurements]),
        )

    @cached_property
    def _expected(self) -> tuple[Array, Array, float, Array]:
        """Forces (m, 3), whether they are known (m, 1), standard deviations of forces and of moments (m, 1).

        The place of the tip is not known exactly, nor is an unknown force: both add to the moment's.
        """
        known = np.array([[measurement.weight is not None] for measurement in self.measurements])
        weights = np.array(
            [0.0 if measurement.weight is None else measurement.weight for measurement in self.measurements]
        )
        lever = np.linalg.norm(self.tips, axis=1) * self.noise.force
        pull = np.where(known[:, 0], weights, TYPICAL_FORCE)
        noise = np.sqrt(self.noise.moment**2 + (self.tip_error * pull) ** 2 + np.where(known[:, 0], 0.0, lever) ** 2)
        return weights[:, None] * self.down, known, self.noise.force, noise[:, None]


def _axes() -> Iterator[tuple[str, str, str, float]]:
    """Of each axis and each it may read in error: names, unit of one by the other, and the ratio of their ranges."""
    names = [f"{kind}{axis}" for kind in "FM" for axis in "xyz"]
    units = ["N"] * 3 + ["N m"] * 3
    for to, unit, most in zip(names, units, RANGES, strict=True):
        for by, per, whole in zip(names, units, RANGES, strict=True):
            yield to, by, f"{unit}/({per})", most / whole


@compiled
def _loads(
    layout: Layout, joints: Array, readings: Array, matrix: Array, weight: Array, first_moment: Array, gravity: Array
) -> Array:
    """Force and moment (m, 6) of the whole robot, world frame, of readings (m, q, 6) without offset."""
    result = np.empty((joints.shape[0], 6))
    for k in range(joints.shape[0]):
        alpha, _, _ = tube_poses(layout, joints[k])
        result[k] = fused_at(layout, joints[k], exerted(readings[k], alpha, matrix, weight, first_moment, gravity))
    return result
