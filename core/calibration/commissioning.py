"""First light on a bench: which way each axis really turns, and how late the tracker is.

Signs need no registration: a rigid motion carries the measured places onto the model's tips, if the joints move as
the model thinks, and no rigid motion makes up for an axis that runs the other way (turning all rotations round
would take a mirror, which is none). So every combination of signs is tried on the same few small moves.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from core.calibration.fit import Unobservable
from core.calibration.measurements import Measurement
from core.calibration.rigid import kabsch
from core.errors import CtrError
from core.model.statics import Statics
from core.robot.robot import Array, Robot

#: The right combination must fit this many times better than the next.
CLEAR = 3.0
#: Steps of the search for the latency: Gauss-Newton, quadratic.
STEPS = 20


class Signs(NamedTuple):
    """Which way the axes run."""

    signs: Array  #: (n,) +1 as described, -1 the other way
    rms: float  #: of the places [m]
    next_rms: float  #: of the next best combination [m]


class Latency(NamedTuple):
    """How late measurements are."""

    latency: float  #: [s]
    error: float  #: standard deviation [s]
    rms: float  #: of what is left [m]


def find_signs(robot: Robot, about: Array, measurements: Sequence[Measurement]) -> Signs:
    """Signs of the axes from small moves without load; `about` (n,) is where an axis is either way it runs.

    Raises:
        Unobservable: two combinations fit alike; says which axes, and what to do.

    """
    model = Statics(robot, integrator="fourth_order")
    coils = np.array([measurement.coil for measurement in measurements])
    moves = np.array([measurement.joints for measurement in measurements]) - about
    found: list[tuple[float, Array]] = []
    for combination in itertools.product((1.0, -1.0), repeat=about.size):
        signs = np.array(combination)
        try:
            tips = np.array([model.solve(about + signs * move, np.zeros(6)).tip for move in moves])
        except CtrError:
            continue  # the robot could not even stand so
        left = kabsch(coils, tips).apply(coils) - tips
        found.append((_rms(left), signs))
    found.sort(key=lambda each: each[0])
    (best, signs), (second, others) = found[0], found[1]
    if second < CLEAR * best:
        unclear = [j.name for j, a, b in zip(robot.joints, signs, others, strict=True) if a != b]
        raise Unobservable(
            f"the sign of {', '.join(unclear)} is not clear: {1e3 * best:.2f} mm one way, {1e3 * second:.2f} mm the"
            " other; make larger moves, or check the tubes' description"
        )
    return Signs(signs, best, second)


def find_latency(times: Array, tips: Array, arrivals: Array, coils: Array) -> Latency:
    """Delay of measurements against a known motion.

    Args:
        times: rising (m,) [s].
        tips: where the tip was then by the model (m, 3) [m].
        arrivals: when the frames arrived (k,) [s]; inside `times` even when moved back by the latency.
        coils: what they said (k, 3), in any frame [m].

    Raises:
        Unobservable: the motion is too slow or too small to tell.

    """
    latency, rate = 0.0, np.gradient(tips, times, axis=0)
    place, speed, error, rms = coils, np.zeros_like(coils), np.inf, np.inf
    for _ in range(STEPS):
        at = arrivals - latency
        place, speed = _at(times, tips, at), _at(times, rate, at)
        carried = kabsch(coils, place)
        left = carried.apply(coils) - place
        # A rigid motion could take part of the delay: what of the speed it cannot explain counts.
        told = speed - _rigid_part(place, speed)
        power = float(np.sum(told * told))
        rms = _rms(left)
        if power < 1e-12:
            break
        step = -float(np.sum(told * left)) / power
        latency += step if np.isfinite(step) else 0.0
        error = rms / np.sqrt(3.0 * power)
        if abs(step) < 1e-7:
            break
    if not error < 5e-3:
        raise Unobservable(
            f"the tip moved at {1e3 * float(np.sqrt(np.mean(speed**2))):.2g} mm/s; the latency is known to"
            f" {1e3 * error:.2g} ms only: move faster, back and forth"
        )
    return Latency(latency, error, rms)


def _rms(vectors: Array) -> float:
    """Root mean square of the lengths of vectors (k, 3)."""
    return float(np.sqrt((vectors * vectors).sum(axis=1).mean()))


def _at(times: Array, values: Array, when: Array) -> Array:
    columns: list[Array] = [np.interp(when, times, values[:, k]) for k in range(values.shape[1])]
    return np.stack(columns, axis=1)


def _rigid_part(points: Array, speeds: Array) -> Array:
    """Of speeds (k, 3), what turning and shifting all points (k, 3) alike would do."""
    away = points - points.mean(axis=0)
    columns = [np.tile(axis, (len(points), 1)).ravel() for axis in np.eye(3)]
    columns += [np.cross(axis, away).ravel() for axis in np.eye(3)]
    orthonormal: Array = np.linalg.qr(np.column_stack(columns))[0]
    return (orthonormal @ (orthonormal.T @ speeds.ravel())).reshape(speeds.shape)
