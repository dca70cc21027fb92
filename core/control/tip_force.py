"""Force at the tip: the best linear unbiased estimate from all forces and moments of the base sensors.

In the total wrench of all base sensors the forces between the tubes cancel. Let c be the point on the tubes' axis about
which the errors e_F and e_M of the total force F and moment M are uncorrelated. This point is the mean of the
sensors' positions, weighted by the variances of their force errors. With the tip force f and the model's loaded tip r
of the previous tick,

    F = f + e_F,    M = (r - c) x f + e_M.

These are six equations for the three components of f. Generalised least squares gives

    f = P (F / A + X^T W M),    P = (I / A + X^T W X)^-1,    X = [(r - c) x],

where A is the variance of each component of F and 1 / W contains the variances of M. The variances contain filtered
noise, drift since the tare, gain and cross-talk errors in proportion to the load of each sensor, and an error of the
lever in proportion to f.

The residual M - (r - c) x F is the mismatch. A load that does not act at the tip makes the mismatch large. Where its
chi square exceeds `FITS`, the moments lose their weight, and the estimate becomes the sum of the sensors' forces.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError
from core.robot.robot import Array, Layout, sensor_poses

#: Rows of the estimator's state (5, 3), passed from tick to tick.
FORCE, VARIANCE, COVARIANCE, MISMATCH, QUALITY = range(5)
#: Columns of the state's row QUALITY: bandwidth of the force filter [Hz]; chi square of the moment mismatch; time since
#: the tare [s].
BANDWIDTH, MISFIT, SINCE = range(3)
#: Chi square of the moment mismatch above which the estimator assumes that the load does not act at the tip: the 99.9 %
#: quantile with three degrees of freedom.
FITS = 16.266
#: Time constant with which the moment mismatch is averaged [s].
MISMATCH_TIME_S = 0.1
#: Factor 2 pi 3 / (2 sqrt 2): the force filter multiplies the variance of white noise by this factor times bandwidth
#: times period.
PASSED = 6.66
#: A sensor channel with this noise or more counts as missing, and its reading is not used [N or N m].
MISSING = 1e3
#: Product of the force filter's bandwidth and the standard deviation of the force's error [Hz N]; the adaptive
#: bandwidth is this product divided by the present standard deviation.
BANDWIDTH_TIMES_DEVIATION_HZ_N = 0.01
#: Largest effective drift time of tracked zeros [s]: later, the tracker keeps their errors from growing.
TRACKED_DRIFT_S = 300.0
#: Upper and lower bound of the force filter's adaptive bandwidth [Hz].
WIDEST_HZ, NARROWEST_HZ = 3.0, 0.5


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the base sensors as standard deviations; each noise is one number per sensor or one number for all.

    The defaults describe an ATI Nano43 SI-18-0.25. Its noise was measured. ATI states a largest error of 1 % of the
    range; the variance is a third of the square of this error. The drift is that of the virtual lab.
    """

    force_noise: float | tuple[float, ...] = 0.02  #: force noise of one sample [N]; inf: the sensor measures no force
    moment_noise: float | tuple[float, ...] = 0.2e-3  #: moment noise of one sample [N m]; inf: it measures no moment
    force_drift: float = 5e-3 / 60.0  #: drift of a force since the tare [N/s]
    moment_drift: float = 0.1e-3 / 60.0  #: drift of a moment since the tare [N m/s]
    gain: float = 0.01 / math.sqrt(3.0)  #: error of an axis due to each axis at full range, fraction of the range
    force_range: float = 18.0  #: range of a force axis [N]
    moment_range: float = 0.25  #: range of a moment axis [N m]
    lever: float = 1.5e-3  #: position error of the model's tip [m]

    @cached_property
    def noise(self) -> Array:
        """Variances (q or 1, 2) of the noise of a sensor's forces and moments."""
        deviations = np.stack(np.broadcast_arrays(*map(np.atleast_1d, (self.force_noise, self.moment_noise))), axis=1)
        if not (deviations > 0.0).all():
            raise DescriptionError(f"sensor noise {deviations.tolist()} N, N m must be above 0 (inf: not measured)")
        return np.asarray(np.minimum(deviations, MISSING) ** 2, dtype=np.float64)

    @cached_property
    def drift(self) -> Array:
        """Squares (q or 1, 2) of the drift rates of a sensor's forces and moments; 0 for a missing channel."""
        return np.where(self.noise < MISSING**2, np.array([self.force_drift, self.moment_drift]) ** 2, 0.0)


#: Gain error of a sensor's axis that remains after `calibrate tubes`, as a fraction of its range (1 % before).
CALIBRATED_GAIN = 0.001


@dataclass(frozen=True)
class LoadEstimator:
    """Settings of the estimator of the force at the tip."""

    #: True: the estimate uses forces and moments. False: it uses the forces alone, as in the paper.
    moments: bool = False
    errors: SensorErrors = field(default_factory=SensorErrors)
    #: True: the force filter's bandwidth follows from the covariance. False: the bandwidth is fixed.
    adapts: bool = False
    #: True: the sensors' zeros are estimated from the tracker, see `sensor_zeros`. False: the zeros of the tare remain.
    tracks_zeros: bool = False

    @cached_property
    def settings(self) -> Array:
        """Packed argument `settings` of `estimate_force`: the scalars, then the sensors' noise by rows."""
        of = self.errors
        numbers = [
            float(self.moments), float(self.adapts), of.force_drift**2, of.moment_drift**2,
            (of.gain * of.force_range) ** 2, (of.gain * of.moment_range) ** 2,
            of.force_range**-2, of.moment_range**-2, of.lever**2, TRACKED_DRIFT_S if self.tracks_zeros else math.inf,
        ]  # fmt: skip
        return np.concatenate((numbers, of.noise.ravel()))

    def start(self, force: Array, bandwidth: float) -> Array:
        """Return the estimator's state (5, 3) before the first tick.

        `force` (3,) is the initial tip force [N], `bandwidth` the bandwidth of the force filter [Hz].
        """
        rows = np.zeros((5, 3))
        rows[FORCE], rows[QUALITY, BANDWIDTH] = force, bandwidth
        return rows


@compiled
def estimate_force(
    settings: Array, period: float, layout: Layout, joints: Array, wrenches: Array, tip: Array,
    last: Array, now: Array,
) -> None:  # fmt: skip
    """Estimate the force at the tip in one tick; the result is the new state `now`.

    Args:
        settings: packed settings `LoadEstimator.settings`.
        period: time between two ticks [s].
        layout, joints: description and joint positions of the robot.
        wrenches: wrenches (s, 6) on the sensors, tared, each in its tube's or the plate's axes [N, N m].
        tip: the model's loaded tip (3,), world frame [m].
        last, now: states (5, 3) of the previous tick and of this tick; the rows are `FORCE` ... `QUALITY`.

    """
    moments, adapts, force_drift, moment_drift, force_gain, moment_gain = settings[:6]
    by_force, by_moment, lever, tracked = settings[6:10]
    noise = settings[10:].reshape(-1, 2)
    bandwidth, since = last[QUALITY, BANDWIDTH], last[QUALITY, SINCE] + period
    passed, elapsed = min(PASSED * bandwidth * period, 1.0), min(since, tracked) ** 2
    alpha, beta = sensor_poses(layout, joints)
    # Total wrench about the plate's origin in the plate's axes, and sums of the variances of forces and moments.
    fx, fy, fz, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    a, at, b = 0.0, 0.0, 0.0
    variances = np.empty(alpha.shape[0])
    for i in range(alpha.shape[0]):
        row = min(i, noise.shape[0] - 1)
        has_force, has_moment = noise[row, 0] < MISSING * MISSING, noise[row, 1] < MISSING * MISSING
        c, s = math.cos(alpha[i]), math.sin(alpha[i])
        carried = 0.0
        if has_force:
            x, y, z = wrenches[i, 0], wrenches[i, 1], wrenches[i, 2]
            carried += by_force * (x * x + y * y + z * z)
            x, y = c * x - s * y, s * x + c * y
            fx, fy, fz, mx, my = fx + x, fy + y, fz + z, mx - beta[i] * y, my + beta[i] * x
        if has_moment:
            x, y, z = wrenches[i, 3], wrenches[i, 4], wrenches[i, 5]
            carried += by_moment * (x * x + y * y + z * z)
            mx, my, mz = mx + c * x - s * y, my + s * x + c * y, mz + z
        variances[i] = passed * noise[row, 0] + force_drift * elapsed + force_gain * carried
        a, at = a + variances[i], at + variances[i] * beta[i]
        b += passed * noise[row, 1] + moment_drift * elapsed + moment_gain * carried
    # Move the moment's reference to the point where the errors of force and moment are uncorrelated.
    at /= a
    mx, my = mx + at * fy, my - at * fx
    base = layout.base
    x, y, z = tip[0] - base[9], tip[1] - base[10], tip[2] - base[11]
    x, y, z = (
        base[0] * x + base[3] * y + base[6] * z,
        base[1] * x + base[4] * y + base[7] * z,
        base[2] * x + base[5] * y + base[8] * z - at,
    )
    shape = lever * (last[FORCE, 0] ** 2 + last[FORCE, 1] ** 2 + last[FORCE, 2] ** 2)
    about, across = b + shape, b + shape
    for i in range(alpha.shape[0]):
        across += variances[i] * (beta[i] - at) ** 2
    # Average the mismatch between the measured moment and the moment of a force at the tip.
    part = period / MISMATCH_TIME_S
    now[MISMATCH, 0] = last[MISMATCH, 0] + part * (mx - (y * fz - z * fy) - last[MISMATCH, 0])
    now[MISMATCH, 1] = last[MISMATCH, 1] + part * (my - (z * fx - x * fz) - last[MISMATCH, 1])
    now[MISMATCH, 2] = last[MISMATCH, 2] + part * (mz - (x * fy - y * fx) - last[MISMATCH, 2])
    inverse, left = np.empty(6), now[MISMATCH]
    invert_symmetric(
        across + a * (y * y + z * z), -a * x * y, -a * x * z, across + a * (x * x + z * z), -a * y * z,
        about + a * (x * x + y * y), inverse,
    )  # fmt: skip
    misfit = _form(inverse, left)
    trust = moments * (1.0 if misfit <= FITS else (FITS / misfit) ** 2)
    # Solve the normal equations of the generalised least squares.
    u, v = trust / across, trust / about
    invert_symmetric(
        1.0 / a + u * z * z + v * y * y, -v * x * y, -u * x * z, 1.0 / a + u * z * z + v * x * x, -u * y * z,
        1.0 / a + u * (x * x + y * y), inverse,
    )  # fmt: skip
    rx = fx / a + u * z * my - v * y * mz
    ry = fy / a - u * z * mx + v * x * mz
    rz = fz / a + u * (y * mx - x * my)
    p = inverse
    if moments > 0.0:
        fx, fy, fz = (
            p[0] * rx + p[1] * ry + p[2] * rz,
            p[1] * rx + p[3] * ry + p[4] * rz,
            p[2] * rx + p[4] * ry + p[5] * rz,
        )
    for i in range(3):
        now[FORCE, i] = base[3 * i] * fx + base[3 * i + 1] * fy + base[3 * i + 2] * fz
        for j in range(i, 3):
            r, t = base[3 * i : 3 * i + 3], base[3 * j : 3 * j + 3]
            turned = (
                r[0] * (p[0] * t[0] + p[1] * t[1] + p[2] * t[2])
                + r[1] * (p[1] * t[0] + p[3] * t[1] + p[4] * t[2])
                + r[2] * (p[2] * t[0] + p[4] * t[1] + p[5] * t[2])
            )
            if i == j:
                now[VARIANCE, i] = turned
            else:
                now[COVARIANCE, i + j - 1] = turned
    now[QUALITY, MISFIT], now[QUALITY, SINCE] = misfit, since
    now[QUALITY, BANDWIDTH] = bandwidth
    if adapts > 0.0:
        spread = math.sqrt((p[0] + p[3] + p[5]) / 3.0)
        now[QUALITY, BANDWIDTH] = min(max(BANDWIDTH_TIMES_DEVIATION_HZ_N / spread, NARROWEST_HZ), WIDEST_HZ)


@compiled
def invert_symmetric(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float, inverse: Array) -> None:
    """Write the inverse of a symmetric matrix to `inverse` (6,), in the order xx, xy, xz, yy, yz, zz."""
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    scale = 1.0 / (xx * a + xy * b + xz * c)
    inverse[0], inverse[1], inverse[2] = scale * a, scale * b, scale * c
    inverse[3], inverse[4], inverse[5] = (
        scale * (xx * zz - xz * xz),
        scale * (xy * xz - xx * yz),
        scale * (xx * yy - xy * xy),
    )


@compiled
def _form(p: Array, v: Array) -> float:
    """Return the quadratic form v^T P v for a symmetric matrix P stored as xx, xy, xz, yy, yz, zz."""
    return (
        p[0] * v[0] * v[0] + p[3] * v[1] * v[1] + p[5] * v[2] * v[2]
        + 2.0 * (p[1] * v[0] * v[1] + p[2] * v[0] * v[2] + p[4] * v[1] * v[2])
    )  # fmt: skip
