"""Calibration of the base force sensors: offset, drift, mounting angles, gain errors and weight of mounted parts.

Sensor i is slightly misaligned (R_i) and carries parts of weight W_i with centre of gravity c_i. Its reading is y_i:

    (1 - S_i) (y_i - b_i - d_i (t - t_0)) = R_i^T (w_i + g_i),    g_i = (W_i Rz(alpha)^T e, c_i x W_i Rz(alpha)^T e),

where b_i and d_i are the sensor's offset and drift, w_i the wrench of the tube, S_i (6, 6) the gain and cross-talk
errors, and e the direction of gravity. Every w_i contains unknown wrenches between the tubes, so a single sensor cannot
be calibrated on a robot. These wrenches cancel in the sum over the sensors. The sum must equal the load. The load is
zero, or a known weight W at the tip r with the moment r x W e, or an unknown force F at the tip, for which only the
moment equation M = r x F is used. Parameter combinations that do not change the sum (for example axial offsets of
opposite sign in two sensors) do not affect the load. `Fit.weak` lists these combinations.

A single sensor under the whole robot measures the sum itself. Its reading contains the weights g_i of all tubes, whose
centres turn and slide with the tubes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from core.calibration.fit import Fit, Parameter, UnobservableCombination, fit
from core.calibration.measurements import Measurement, Noise
from core.calibration.rigid_transform import rotation_from_vector
from core.compiled import compiled
from core.control.sensors import FusedLoad, Sensors, exerted, fuse_at, fused_at
from core.robot.robot import Array, Layout, Robot

#: Priors (one standard deviation) and tolerances (largest error that does not matter) of each parameter.
OFFSET_PRIOR, OFFSET_TOLERANCE = (2.0, 30e-3), (5e-3, 0.2e-3)  # [N], [N m]
DRIFT_PRIOR, DRIFT_TOLERANCE = (10e-3 / 60.0, 1e-3 / 60.0), (5e-3 / 60.0, 0.2e-3 / 60.0)  # [N/s], [N m/s]
MOUNTING_PRIOR_RAD, MOUNTING_TOLERANCE_RAD = 0.05, 0.01  # [rad]
WEIGHT_PRIOR_N, WEIGHT_TOLERANCE_N = 0.5, 5e-3  # [N]
FIRST_MOMENT_PRIOR_NM, FIRST_MOMENT_TOLERANCE_NM = 20e-3, 0.2e-3  # weight times its distance [N m]
#: Prior and tolerance of gain and cross-talk: error of an axis as a fraction of its range, with another axis at full
#: range. Manufacturers specify accuracy in this form (ATI: 1 %).
GAIN_PRIOR, GAIN_TOLERANCE = 0.006, 2e-3
AXIS_RANGES = (18.0, 18.0, 18.0, 0.25, 0.25, 0.25)  # ranges of the axes of a Nano43 SI-18-0.25 [N, N m]
#: Assumed size of an unknown load [N]; it sets the statistical weight of measurements under this load.
TYPICAL_FORCE_N = 0.5
#: Smallest number of measurements without load. A sensor's offset turns with the sensor, a weight that hangs on it does
#: not, so measurements at different rotations separate both.
MIN_MEASUREMENTS = 8


class SensorCalibration(NamedTuple):
    """Estimated parameters of the sensors."""

    sensors: Sensors
    offset: Array  #: (s, 6) offset of the readings at `time` [N, N m]
    drift: Array  #: (s, 6) rate of the offset [N/s, N m/s]
    time: float  #: time at which the offset is valid [s]
    fit: Fit

    def load(self, robot: Robot, measurement: Measurement) -> FusedLoad:
        """Return the load of the whole robot at a measurement, world frame."""
        readings = measurement.wrenches - self.offset - (measurement.time - self.time) * self.drift
        return fuse_at(robot, measurement.joints, self.sensors.exerted(robot, measurement.joints, readings))


class WeightCheck(NamedTuple):
    """Comparison of the measured force with a known weight."""

    force: Array  #: (3,) mean measured force [N]
    magnitude: float  #: size of the mean force [N]
    error: float  #: size of the mean force minus the known weight [N]
    angle: float  #: angle between the mean force and gravity [rad]


def calibrate_sensors(
    robot: Robot,
    measurements: Sequence[Measurement],
    tips: Array,
    noise: Noise,
    tip_error: float,
) -> SensorCalibration:
    """Fit the sensors to measurements with the tip at `tips` (m, 3), world frame [m].

    Args:
        robot: description of the robot, from which the tubes' poses follow.
        measurements: untared measurements; some must be without load, and some should be under a known weight.
        tips: measured tip positions.
        noise: standard deviations of the summed loads.
        tip_error: standard deviation of each component of `tips` [m].

    Raises:
        UnobservableCombination: there are too few measurements without load, or all have the same rotations.

    """
    free = [measurement for measurement in measurements if measurement.weight == 0.0]
    if len(free) < MIN_MEASUREMENTS:
        raise UnobservableCombination(
            f"{len(free)} measurements without load; the sensors' offsets need at least {MIN_MEASUREMENTS}"
        )
    for j, joint in enumerate(robot.joints):
        turned = float(np.ptp([measurement.joints[j] for measurement in free]))
        if joint.motion == "rotation" and turned < 1.0:
            raise UnobservableCombination(
                f"an offset that turns with the sensor of tube '{robot.tubes[joint.tube].name}' cannot be separated"
                f" from a weight: turn {joint.name} by more than 60 deg without load"
                f" (it turned {np.degrees(turned):.1f} deg)"
            )
    problem = _Sum(robot, measurements, tips, tip_error, noise, np.array([1.0, 0.0, 0.0]))  # gravity is along +x
    found = fit(problem, problem.parameters)
    return SensorCalibration(*problem.unpacked(found.values), problem.middle, found)


def check_weight(loads: Array, known: float, gravity: Array) -> WeightCheck:
    """Compare measured forces (m, 3) with a known weight [N] that acts along `gravity` (3,)."""
    force = loads.mean(axis=0)
    magnitude = float(np.linalg.norm(force))
    cosine = float(force @ gravity) / (magnitude * float(np.linalg.norm(gravity)))
    return WeightCheck(force, magnitude, magnitude - known, float(np.arccos(np.clip(cosine, -1.0, 1.0))))


@dataclass(frozen=True)
class _Sum:
    """Fit problem of the sensor calibration: the sum of all sensors must equal the load."""

    robot: Robot
    measurements: Sequence[Measurement]
    tips: Array
    tip_error: float
    noise: Noise
    down: Array

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        found: list[Parameter] = []
        for name in self.robot.sensor_names:
            for what, sizes, priors, per in (
                ("offset", OFFSET_TOLERANCE, OFFSET_PRIOR, ""),
                ("drift", DRIFT_TOLERANCE, DRIFT_PRIOR, "/s"),
            ):
                for load, unit, size, prior in zip(("force", "moment"), ("N", "N m"), sizes, priors, strict=True):
                    found += [Parameter(f"{name} {load} {what} {a}", unit + per, size, prior) for a in "xyz"]
            found += [
                Parameter(f"{name} mounting {a}", "rad", MOUNTING_TOLERANCE_RAD, MOUNTING_PRIOR_RAD) for a in "xyz"
            ]
            for tube in (name,) if name != "robot" else [tube.name for tube in self.robot.tubes]:
                found.append(Parameter(f"{tube} weight", "N", WEIGHT_TOLERANCE_N, WEIGHT_PRIOR_N))
                found += [
                    Parameter(f"{tube} first moment {a}", "N m", FIRST_MOMENT_TOLERANCE_NM, FIRST_MOMENT_PRIOR_NM)
                    for a in "xyz"
                ]
            found += [
                Parameter(f"{name} {to} of {by}", per, GAIN_TOLERANCE * scale, GAIN_PRIOR * scale)
                for to, by, per, scale in _axes()
            ]
        return tuple(found)

    @cached_property
    def middle(self) -> float:
        """Reference time of the drift [s]."""
        return float(np.mean([measurement.time for measurement in self.measurements]))

    def unpacked(self, values: Array) -> tuple[Sensors, Array, Array]:
        """Return sensors, offset (s, 6) and drift (s, 6) for parameters (p,)."""
        rows = values.reshape(len(self.robot.sensor_names), -1)
        mounting = np.array([rotation_from_vector(row[12:15]) for row in rows])
        gravity = self.robot.base.rotation.T @ self.down
        skew, hanging = rows[:, -36:].reshape(-1, 6, 6), rows[:, 15:-36].reshape(-1, 4)
        sensors = Sensors(mounting, hanging[:, 0].copy(), hanging[:, 1:].copy(), gravity, skew)
        return sensors, rows[:, :6], rows[:, 6:12]

    def residuals(self, values: Array) -> Array:
        """Return residuals (6 m,): force and moment of every measurement; only the moment for an unknown force."""
        sensors, offset, drift = self.unpacked(values)
        since, joints, readings = self._measured
        corrected = readings - offset - since[:, None, None] * drift
        loads = _loads(
            self.robot.layout, joints, corrected, sensors.matrix, sensors.weight, sensors.first_moment, sensors.gravity
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
        """Return the residuals' derivatives by central differences.

        The differences are accurate because the residuals are linear in all parameters but the mounting angles.
        """
        columns: list[Array] = []
        for k, parameter in enumerate(self.parameters):
            half = np.zeros_like(values)
            half[k] = 1e-2 * parameter.size
            columns.append((self.residuals(values + half) - self.residuals(values - half)) / (2.0 * half[k]))
        return np.column_stack(columns)

    @cached_property
    def _measured(self) -> tuple[Array, Array, Array]:
        """Times relative to `middle` (m,), joints (m, n) and readings (m, s, 6) of all measurements."""
        return (
            np.array([measurement.time for measurement in self.measurements]) - self.middle,
            np.array([measurement.joints for measurement in self.measurements]),
            np.array([measurement.wrenches for measurement in self.measurements]),
        )

    @cached_property
    def _expected(self) -> tuple[Array, Array, float, Array]:
        """Expected forces (m, 3), whether they are known (m, 1), standard deviations of forces and of moments (m, 1).

        The tip's position and an unknown force have errors; both add to the moment's standard deviation.
        """
        known = np.array([[measurement.weight is not None] for measurement in self.measurements])
        weights = np.array(
            [0.0 if measurement.weight is None else measurement.weight for measurement in self.measurements]
        )
        lever = np.linalg.norm(self.tips, axis=1) * self.noise.force
        pull = np.where(known[:, 0], weights, TYPICAL_FORCE_N)
        noise = np.sqrt(self.noise.moment**2 + (self.tip_error * pull) ** 2 + np.where(known[:, 0], 0.0, lever) ** 2)
        return weights[:, None] * self.down, known, self.noise.force, noise[:, None]


def _axes() -> Iterator[tuple[str, str, str, float]]:
    """Yield for each pair of axes: both names, the unit of their cross-talk and the ratio of their ranges."""
    names = [f"{kind}{axis}" for kind in "FM" for axis in "xyz"]
    units = ["N"] * 3 + ["N m"] * 3
    for to, unit, range_ in zip(names, units, AXIS_RANGES, strict=True):
        for by, per, whole in zip(names, units, AXIS_RANGES, strict=True):
            yield to, by, f"{unit}/({per})", range_ / whole


@compiled
def _loads(
    layout: Layout, joints: Array, readings: Array, matrix: Array, weight: Array, first_moment: Array, gravity: Array
) -> Array:
    """Return force and moment (m, 6) of the whole robot, world frame, from readings (m, s, 6) without offset."""
    result = np.empty((joints.shape[0], 6))
    for k in range(joints.shape[0]):
        wrenches = exerted(layout, joints[k], readings[k], matrix, weight, first_moment, gravity)
        result[k] = fused_at(layout, joints[k], wrenches)
    return result
