"""Commissioning of a robot's hardware: the sign of each axis, and the latency of the tracker.

An axis has the sign -1 if its stage moves opposite to the robot file. The search for the signs needs no registration of
the tracker: with the right signs, one rigid transform maps the measured positions onto the model's tips. No rigid
transform compensates a wrong sign; a reversal of all rotations, for example, would need a reflection. The search
therefore fits a rigid transform for every combination of signs, always to the same few small moves.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from core.calibration.fit import UnobservableCombination
from core.calibration.measurements import Measurement
from core.calibration.rigid_transform import kabsch
from core.errors import CtrError
from core.model.statics import Statics
from core.robot.robot import Array, Robot

#: The axis signs are accepted if the second-best combination has at least this many times the best position residual.
MIN_FIT_RATIO = 3.0
#: An axis has no visible sign if both signs fit and move the model's tip alike within this distance [m]. An example is
#: the rotation of a nearly straight tube.
MAX_UNSEEN_M = 2e-3
#: Largest number of Gauss-Newton steps in the search for the latency; convergence is quadratic.
LATENCY_SEARCH_STEPS = 20


class Signs(NamedTuple):
    """Estimated signs of the axes, with the residuals of the best and the second-best combination."""

    signs: Array  #: (n,) +1: the axis moves as the robot file states; -1: it is reversed; 0: the tip does not show it
    rms: float  #: position residual of these signs, root mean square [m]
    next_rms: float  #: position residual of the second-best combination of the visible signs [m]


class Latency(NamedTuple):
    """Estimated latency of the tracker's measurements."""

    latency: float  #: delay from measurement to arrival [s]
    error: float  #: standard deviation of the latency [s]
    rms: float  #: position residual, root mean square [m]


def find_signs(robot: Robot, about: Array, measurements: Sequence[Measurement]) -> Signs:
    """Find the signs of the axes from small moves without load about the joint positions `about` (n,).

    Raises:
        UnobservableCombination: the tip shows no sign, or two combinations of signs fit equally well although they move
            the model's tip differently; the text names the axes and what to do.

    """
    model = Statics(robot, integrator="fourth_order")
    coils = np.array([measurement.coil for measurement in measurements])
    moves = np.array([measurement.joints for measurement in measurements]) - about
    found: list[tuple[float, Array, Array]] = []
    for combination in itertools.product((1.0, -1.0), repeat=about.size):
        signs = np.array(combination)
        try:
            tips = np.array([model.solve(about + signs * move, np.zeros(6)).tip for move in moves])
        except CtrError:
            continue  # a pose is invalid with these signs, so the signs are wrong
        found.append((_difference(coils, tips), signs, tips))
    found.sort(key=lambda each: each[0])
    best, signs, tips = found[0]
    alike = [each for each in found if each[0] <= MIN_FIT_RATIO * best and _difference(tips, each[2]) < MAX_UNSEEN_M]
    unseen = np.any([each[1] != signs for each in alike], axis=0)
    others = [each for each in found if (each[1] != signs)[~unseen].any()]
    if unseen.all() or (others and others[0][0] < MIN_FIT_RATIO * best):
        second, other, _ = found[1] if unseen.all() else others[0]
        unclear = [j.name for j, a, b in zip(robot.joints, signs, other, strict=True) if a != b]
        raise UnobservableCombination(
            f"the sign of {', '.join(unclear)} is ambiguous: residual {1e3 * best:.2f} mm with one sign and"
            f" {1e3 * second:.2f} mm with the other; make larger moves, or check the tubes' description"
        )
    return Signs(np.where(unseen, 0.0, signs), best, others[0][0] if others else np.inf)


def find_latency(times: Array, tips: Array, arrivals: Array, coils: Array) -> Latency:
    """Find the delay of tracker measurements relative to the model's motion of the tip.

    Args:
        times: increasing times of the model's motion (m,) [s].
        tips: the model's tip positions at `times` (m, 3) [m].
        arrivals: arrival times of the tracker frames (k,) [s]; inside `times` even after subtracting the latency.
        coils: measured coil positions (k, 3), in any frame [m].

    Raises:
        UnobservableCombination: the motion is too slow or too small to determine the latency.

    """
    latency, rate = 0.0, np.gradient(tips, times, axis=0)
    position, speed, error, rms = coils, np.zeros_like(coils), np.inf, np.inf
    for _ in range(LATENCY_SEARCH_STEPS):
        at = arrivals - latency
        position, speed = _interpolated(times, tips, at), _interpolated(times, rate, at)
        transform = kabsch(coils, position)
        residual = transform.apply(coils) - position
        # The fitted rigid transform absorbs a part of the delay; only the rest of the speed determines the latency.
        observable = speed - _rigid_part(position, speed)
        power = float(np.sum(observable * observable))
        rms = _rms(residual)
        if power < 1e-12:
            break
        step = -float(np.sum(observable * residual)) / power
        latency += step if np.isfinite(step) else 0.0
        error = rms / np.sqrt(3.0 * power)
        if abs(step) < 1e-7:
            break
    if not error < 5e-3:
        raise UnobservableCombination(
            f"the tip moved at {1e3 * float(np.sqrt(np.mean(speed**2))):.2g} mm/s; the latency is known only to"
            f" {1e3 * error:.2g} ms: move faster, back and forth"
        )
    return Latency(latency, error, rms)


def _difference(here: Array, there: Array) -> float:
    """Return the distance between points (m, 3) after the best rigid transform, root mean square [m]."""
    return _rms(kabsch(here, there).apply(here) - there)


def _rms(vectors: Array) -> float:
    """Return the root mean square of the lengths of vectors (k, 3)."""
    return float(np.sqrt((vectors * vectors).sum(axis=1).mean()))


def _interpolated(times: Array, values: Array, when: Array) -> Array:
    columns: list[Array] = [np.interp(when, times, values[:, k]) for k in range(values.shape[1])]
    return np.stack(columns, axis=1)


def _rigid_part(points: Array, speeds: Array) -> Array:
    """Return the part of speeds (k, 3) that a common rotation and translation of all points (k, 3) explains."""
    away = points - points.mean(axis=0)
    columns = [np.tile(axis, (len(points), 1)).ravel() for axis in np.eye(3)]
    columns += [np.cross(axis, away).ravel() for axis in np.eye(3)]
    orthonormal: Array = np.linalg.qr(np.column_stack(columns))[0]
    return (orthonormal @ (orthonormal.T @ speeds.ravel())).reshape(speeds.shape)
