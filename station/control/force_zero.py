"""Zero of the force on the tip: no tare hides a contact, and the bound of the force counts what tares have removed.

A tare sets the force to zero, whatever touches the robot. So the loop also keeps the readings without contact, and

    total force = force since the last tare + removed force,
    removed force = force that belongs to the readings at the last tare minus those without contact.

A tare may remove only a force that errors explain: `QUIET_N`, the drift since the last tare, and the larger of two
parts: one grows with the travel of the joints since then, the other is the error of gain and cross-talk for the change
of the readings. Friction between the tubes changes the readings without any travel or force on the tip: in the lab
realistic by up to 17 N along z, with opposite signs at the two sensors, which appears as 0.3 N. Only the drift changes
the readings without contact. The rest of a removed force remains in the total force, so many small contacts add up
until a tare is refused.

Readings are those of the base sensors. On a bench without sensors the reading is the measured tip minus the model's tip
without load, and its force follows from the compliance. Where the tubes are stiff, that force is unknown.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from core.control.controller_settings import Controller
from core.control.deflection_force import LARGEST_FORCE_N
from core.control.sensors import fuse_at
from core.model.solution import Solution
from core.robot.robot import Array

#: Largest force that counts as no contact in the pose of the last tare [N].
QUIET_N = 0.06
#: Largest apparent force after a motion to another pose, per relative error of the sensors' gain or of the tubes'
#: deflection [N]. Measured without load in the realistic lab: 0.17 N by the sensors, 0.34 N by the deflection.
POSE_N_BY_GAIN, POSE_N_BY_DEFLECTION = 33.0, 7.0
#: Travel of a joint at which the apparent force is the largest [rad, m].
POSE_TRAVEL = {"rad": 1.0, "m": 0.030}
#: Standard deviations of the force in each axis by errors of gain and cross-talk; 97 % of the vectors are smaller.
GAIN_DEVIATIONS = 3.0
#: Largest drift that a tare accepts without a person's confirmation [N]; also at most half of the bound.
LARGEST_DRIFT_N = 0.3
#: Drift of the force from the deflection [N/s]: the tubes' curvature may change by 2 % in an hour.
DEFLECTION_DRIFT_N_S = 2e-3 / 60.0
#: Standard deviations of the noise of a tare by a single sample, and the largest force that is attributed to it [N].
NOISE_DEVIATIONS, LARGEST_NOISE_N = 4.0, 0.2
#: Force at the first connection above which the tracker's tip and the model's tip without load contradict each other
#: [N]. With nominal tubes and poses they differ by less than half of it.
LARGEST_UNKNOWN_N = 0.5
#: Assumed error of the tip when a force is computed from a deflection [m].
TIP_ERROR_M = 0.5e-3
#: Instruction for a robot that nothing touches although its force is not zero.
ZERO_AGAIN = "if nothing touches the robot, zero the force and confirm that it is untouched"


@dataclass(frozen=True)
class ForceZero:
    """Readings without contact and readings at the last tare."""

    free: Array  #: readings without contact: (q, 6) of the sensors [N, N m], or (3,) difference of the tips [m]
    tare: Array  #: readings at the last tare, in the same form
    joints: Array  #: joints (n,) at the last tare [rad or m]
    time: float  #: time of the last tare [s]
    noise: float = 0.0  #: largest force by the noise of a tare of few samples [N]
    doubt: str = ""  #: why the readings without contact are unknown; empty if they are known


def first_zero(controller: Controller, readings: Array, joints: Array, now: float) -> ForceZero:
    """Return the zero after the first reading (q, 6) or (3,); whether something touches the robot is unknown."""
    noise = 0.0
    if controller.senses:
        variances = np.broadcast_to(controller.estimator.load.errors.noise, (len(readings), 2))[:, 0]
        noise = min(NOISE_DEVIATIONS * math.sqrt(float(variances.sum())), LARGEST_NOISE_N)
    return ForceZero(readings, readings, joints.copy(), now, noise)


def removed_force(controller: Controller, zero: ForceZero, solution: Solution) -> Array:
    """Return the force (3,) [N] that the tares have removed, at the joints of a solved model."""
    if zero.tare is zero.free:
        return _ZERO
    return _force(controller, zero.tare - zero.free, solution)


def contact(
    controller: Controller, zero: ForceZero, change: Array, force: Array, removed: Array, joints: Array, now: float
) -> str:
    """Return why the tip may have contact, with what to do; empty without contact.

    Args:
        controller: controller of the bench.
        zero: zero of the force.
        change: readings (q, 6) of the sensors minus those at the last tare [N, N m].
        force: force (3,) since the last tare [N].
        removed: force (3,) that the tares have removed [N].
        joints: joints (n,) [rad or m].
        now: time [s].
    """
    if zero.doubt:
        return zero.doubt
    pose, drift = _pose_error(controller), _drift(controller, zero, now)
    here = _share(controller, zero, joints) * pose
    if controller.senses:
        here = max(here, _gain_error(controller, change))
        pose = max(pose, _gain_error(controller, change + zero.tare - zero.free))
    most, drift = _half_bound(controller), drift + zero.noise
    limit, total = min(QUIET_N + pose, most) + drift, _size(force + removed)
    near, since = min(QUIET_N + here, most) + drift, _size(force)
    if since > near:
        total, limit = since, near
    elif total <= limit:
        return ""
    return (
        f"the force on the tip {total:.2g} N is above the {limit:.2g} N that drift and errors of the sensors explain:"
        f" jog the tip off what it touches, or take the load off; {ZERO_AGAIN}"
    )


def still_pressing(pressed: Array, force: Array) -> str:
    """Return why the tip has contact after a motion that ended under the force `pressed` (3,) [N]; empty without it.

    The force since the tare must have fallen by half. After a long motion `contact` misses such a small force.
    """
    size = _size(pressed)
    still = float(pressed @ force) / max(size, 1e-9)
    if still < 0.5 * size:
        return ""
    return (
        f"the last motion ended on an obstacle with {size:.2g} N, and the tip still bears {still:.2g} N (contact ends"
        f" below {0.5 * size:.2g} N): jog it off the obstacle; {ZERO_AGAIN}"
    )


def after_tare(
    controller: Controller, zero: ForceZero, readings: Array, solution: Solution, now: float, *, first: bool = False
) -> tuple[ForceZero, str]:
    """Return the zero after a tare, and why the tare must be refused unless a known load hangs at the tip.

    Args:
        controller: controller of the bench.
        zero: zero before the tare.
        readings: mean readings of the tare.
        solution: solved model at the joints of the tare.
        now: time [s].
        first: nothing has moved since the first reading, so these readings replace it.
    """
    removed = removed_force(controller, zero, solution)
    total = _force(controller, readings - zero.free, solution)
    refused = contact(controller, zero, readings - zero.tare, total - removed, removed, solution.joints, now)
    if refused:  # keep the readings without contact, so that a known load remains in the total force
        return replace(zero, tare=readings, joints=solution.joints.copy(), noise=0.0), refused
    part = 1.0 if first else min(1.0, _drift(controller, zero, now) / max(_size(total), 1e-9))
    free = readings if part == 1.0 else zero.free + part * (readings - zero.free)
    return ForceZero(free, readings, solution.joints.copy(), now), ""


def doubted(zero: ForceZero, difference: Array, unloaded: Solution) -> ForceZero:
    """Return the zero after the first tracker frame; `difference` (3,) is measured minus unloaded model's tip [m]."""
    force = _size(_by_deflection(difference, unloaded))
    if force <= LARGEST_UNKNOWN_N:
        return replace(zero, doubt="")
    return replace(
        zero,
        doubt=(
            f"the tracker shows the tip {1e3 * _size(difference):.0f} mm from the model without load, as a"
            f" force of {force:.2g} N would (errors explain at most {LARGEST_UNKNOWN_N:g} N): jog the tip off what it"
            f" touches; {ZERO_AGAIN}"
        ),
    )


def _force(controller: Controller, offset: Array, solution: Solution) -> Array:
    """Return the force (3,) [N] that corresponds to an offset of the readings at the joints of a solved model."""
    if not controller.senses:
        return _by_deflection(offset, solution)
    if controller.corrections is not None:
        offset = np.einsum("qij,qj->qi", controller.corrections.sensors.matrix, offset)
    return fuse_at(controller.statics.robot, solution.joints, offset).force


def _by_deflection(offset: Array, solution: Solution) -> Array:
    compliance = solution.compliance[:3, :3] / TIP_ERROR_M
    information = compliance.T @ compliance + np.eye(3) / LARGEST_FORCE_N**2
    return np.asarray(np.linalg.solve(information, compliance.T @ offset / TIP_ERROR_M), dtype=np.float64)


def _pose_error(controller: Controller) -> float:
    if controller.senses:
        return POSE_N_BY_GAIN * controller.estimator.load.errors.gain
    return POSE_N_BY_DEFLECTION * controller.tube_error


def _gain_error(controller: Controller, change: Array) -> float:
    """Return the largest force by errors of gain and cross-talk if the readings of the sensors change [N]."""
    errors = controller.estimator.load.errors
    ranges = np.repeat([errors.force_range, errors.moment_range], 3)
    return GAIN_DEVIATIONS * errors.gain * errors.force_range * float(np.linalg.norm(change / ranges))


def _share(controller: Controller, zero: ForceZero, joints: Array) -> float:
    """Return the travel of the joints since the last tare as a fraction of `POSE_TRAVEL`, at most 1."""
    limits = controller.limits.joints
    travel = (
        abs(now - then) / POSE_TRAVEL[one.unit]
        for one, now, then in zip(limits, joints.tolist(), zero.joints.tolist(), strict=True)
    )
    return min(1.0, max(travel))


def _drift(controller: Controller, zero: ForceZero, now: float) -> float:
    """Return the largest drift of the force since the last tare [N]."""
    rate = DEFLECTION_DRIFT_N_S
    if controller.senses:
        by_sensor = np.broadcast_to(controller.estimator.load.errors.drift, (len(zero.free), 2))[:, 0]
        rate = math.sqrt(3.0) * float(np.sqrt(by_sensor).sum())
    return min(rate * (now - zero.time), LARGEST_DRIFT_N, _half_bound(controller))


def _half_bound(controller: Controller) -> float:
    bound = controller.limits.overload
    return math.inf if bound is None else 0.5 * bound.newton


def _size(vector: Array) -> float:
    return math.hypot(*vector.tolist())


_ZERO = np.zeros(3)
