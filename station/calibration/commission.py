"""First procedures on a new bench: which way the axes run, where their zeros are, how late the tracker is."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from core.calibration.commissioning import Latency, Signs, find_latency, find_signs
from core.calibration.fit import fit
from core.calibration.informative import way_is_free
from core.calibration.measurements import Measurement
from core.calibration.prediction import Prediction
from core.calibration.quantities import Quantity, quantities
from core.calibration.registration import closed_form
from core.errors import Unreachable
from core.model.statics import Statics
from core.robot.robot import Array
from station.calibration.plan import NOISE, Subject
from station.calibration.procedure import AbortedError, GoTo, Procedure, Swing, Swung

#: Small moves about the start pose [rad, m], and larger ones for the zeros.
SMALL, LARGE = {"rad": 0.25, "m": 0.010}, {"rad": 1.2, "m": 0.015}
#: Where limits (short travels, ends of tubes that come close) leave no room for all of a move, these parts are tried.
PARTS = (1.0, 0.8, 0.6, 0.4, 0.2)
#: The model is not better than this before the tubes are calibrated [m].
MODEL_ERROR = 1e-3
#: To and fro for the latency [rad, m], once in so many seconds, for so long.
SWING, PERIOD, DURATION = {"rad": 0.25, "m": 0.006}, 8.0, 16.0


class AxesResult(NamedTuple):
    """What the procedure `axes` has found."""

    signs: Signs
    zeros: tuple[tuple[Quantity, float, float], ...]  #: zero angle of a tube and half its 95 % interval [rad]
    measurements: tuple[Measurement, ...]


class LatencyResult(NamedTuple):
    """What the procedure `latency` has found."""

    latency: Latency  #: beyond what the tracker is said to have
    time: float  #: when the swing had ended [s]


def axes(subject: Subject) -> Procedure[AxesResult]:
    """Signs by small moves; if all axes run as described, zero angles of the tubes by larger ones.

    Raises:
        Unobservable: the signs are not clear.
        Unreachable: a joint has no room to move.
    """
    measurements: list[Measurement] = []
    yield from _moves(subject, SMALL, 0.0, measurements)
    # A stage that runs the other way is still right in the middle of its travel.
    middle = np.array([0.5 * (limit.lower + limit.upper) for limit in subject.limits.joints])
    signs = find_signs(subject.robot, middle, measurements)
    if (signs.signs < 0.0).any():
        # Larger moves wait until the bench's file has the directions right.
        return AxesResult(signs, (), tuple(measurements))
    yield from _moves(subject, LARGE, 0.5, measurements)
    what = tuple(quantity for quantity in quantities(subject.robot) if quantity.kind == "zero_angle")
    forces, noise = np.zeros((len(measurements), 3)), NOISE._replace(coil=MODEL_ERROR)
    problem = Prediction(
        subject.robot, what, measurements, forces, noise, closed_form(subject.robot, measurements, forces)
    )
    found = fit(problem, problem.parameters)
    names = [quantity.parameter(subject.robot).name for quantity in what]
    zeros = tuple((q, found.value(name), found.interval(name)) for q, name in zip(what, names, strict=True))
    return AxesResult(signs, zeros, tuple(measurements))


def _moves(
    subject: Subject, steps: Mapping[str, float], done: float, measurements: list[Measurement]
) -> Procedure[None]:
    """Each joint either way from the start pose; half of the procedure, from `done` on."""
    moves: list[Array] = []
    for k, joint in enumerate(subject.robot.joints):
        both = [sign * steps[joint.unit] * np.eye(len(subject.robot.joints))[k] for sign in (1.0, -1.0)]
        found = [move for move in (_with_room(subject, move) for move in both) if move is not None]
        if not found:
            raise Unreachable(
                f"{joint.name} has no room either way where the robot rests; give it a working_pose with more"
            )
        moves += found
    for number, move in enumerate(moves):
        measurement = yield GoTo(subject.start + move, 0.0, done + 0.5 * number / len(moves))
        measurements += [measurement] if isinstance(measurement, Measurement) else []


def _with_room(subject: Subject, move: Array) -> Array | None:
    """The move (n,) from the start pose, or a part of it that stays inside all limits; None when there is none."""
    for part in PARTS:
        if way_is_free(subject.statics, subject.limits, subject.start, subject.start + part * move, np.zeros(3)):
            return part * move
    return None


def latency(subject: Subject) -> Procedure[LatencyResult]:
    """How much later than it says the tracker measures: the joints swing, and the model tells where the tip was.

    Raises:
        Unobservable: the swing was too slow to tell.
    """
    yield GoTo(subject.start, 0.0, 0.0)
    amplitudes = np.array([SWING[joint.unit] for joint in subject.robot.joints])
    swung = yield Swing(amplitudes, PERIOD, DURATION, 0.2)
    if not isinstance(swung, Swung):
        raise AbortedError("nothing was recorded of the swing")
    found = find_latency(swung.times, _tips(subject, swung.joints), swung.frame_times, swung.coils)
    return LatencyResult(found, float(swung.times[-1]))


def _tips(subject: Subject, joints: Array) -> Array:
    """Where the model has the tip (m, 3) without load [m]."""
    model = Statics(subject.robot, integrator="fourth_order")
    tips, near = np.empty((len(joints), 3)), None
    for k, pose in enumerate(joints):
        near = model.solve(pose, np.zeros(6), near)
        tips[k] = near.tip
    return tips
