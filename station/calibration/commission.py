"""The procedures `axes` and `latency`, the first on a new bench.

`axes` finds signs and zeros of the axes; `latency` finds the latency of the tracker.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from core.calibration.commissioning import Latency, Signs, find_latency, find_signs
from core.calibration.fit import fit
from core.calibration.measurements import Measurement
from core.calibration.pose_selection import path_is_free
from core.calibration.prediction import Prediction
from core.calibration.quantities import Quantity, quantities
from core.calibration.registration import closed_form
from core.errors import Unreachable
from core.model.statics import Statics
from core.robot.robot import Array
from station.calibration.plan import MEASUREMENT_NOISE, PlanSubject
from station.calibration.procedure import AbortedError, GoToPose, Procedure, SwingMotion, SwingRecord

#: Sizes of the small moves about the start pose that determine the signs, and of the larger moves that determine the
#: zeros [rad, m].
SMALL_MOVES, LARGE_MOVES = {"rad": 0.25, "m": 0.010}, {"rad": 1.2, "m": 0.015}
#: Shares of a move, tried in this order if limits (joint travel, ends of the tubes) do not allow the whole move.
MOVE_SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)
#: Assumed error of the model before the tubes are calibrated [m].
MODEL_ERROR_M = 1e-3
#: Oscillation of the joints that determines the latency: peak-to-peak displacement (the distance between the turning
#: points) by the joint's unit [rad, m], period [s] and duration [s].
SWING_AMPLITUDES, SWING_PERIOD_S, SWING_DURATION_S = {"rad": 0.25, "m": 0.006}, 8.0, 16.0


class AxesResult(NamedTuple):
    """Result of the procedure `axes`."""

    signs: Signs
    zeros: tuple[tuple[Quantity, float, float], ...]  #: quantity, zero angle, half width of 95 % interval [rad]
    measurements: tuple[Measurement, ...]


class LatencyResult(NamedTuple):
    """Result of the procedure `latency`."""

    latency: Latency  #: latency in addition to the configured latency of the tracker
    time: float  #: time at the end of the swing [s]


def axes(subject: PlanSubject) -> Procedure[AxesResult]:
    """Find the axes' signs by small moves and, if no axis is reversed, the tubes' zero angles by larger moves.

    Raises:
        UnobservableCombination: the signs are ambiguous.
        Unreachable: the limits allow no move of a joint.
    """
    measurements: list[Measurement] = []
    yield from _moves(subject, SMALL_MOVES, 0.0, measurements)
    # A stage that is reversed reports its correct position only in the middle of its travel.
    middle = np.array([0.5 * (limit.lower + limit.upper) for limit in subject.limits.joints])
    signs = find_signs(subject.robot, middle, measurements)
    if (signs.signs < 0.0).any():
        # The larger moves need correct directions, so the operator must correct the station file first.
        return AxesResult(signs, (), tuple(measurements))
    yield from _moves(subject, LARGE_MOVES, 0.5, measurements)
    what = tuple(quantity for quantity in quantities(subject.robot) if quantity.kind == "zero_angle")
    forces, noise = np.zeros((len(measurements), 3)), MEASUREMENT_NOISE._replace(coil=MODEL_ERROR_M)
    problem = Prediction(
        subject.robot, what, measurements, forces, noise, closed_form(subject.robot, measurements, forces)
    )
    found = fit(problem, problem.parameters)
    names = [quantity.parameter(subject.robot).name for quantity in what]
    zeros = tuple((q, found.value(name), found.interval(name)) for q, name in zip(what, names, strict=True))
    return AxesResult(signs, zeros, tuple(measurements))


def _moves(
    subject: PlanSubject, steps: Mapping[str, float], done: float, measurements: list[Measurement]
) -> Procedure[None]:
    """Move each joint in both directions from the start pose.

    These moves are half of the procedure; `done` is the share of the procedure that is done before the moves.
    """
    moves: list[Array] = []
    for k, joint in enumerate(subject.robot.joints):
        both = [sign * steps[joint.unit] * np.eye(len(subject.robot.joints))[k] for sign in (1.0, -1.0)]
        found = [move for move in (_feasible_move(subject, move) for move in both) if move is not None]
        if not found:
            raise Unreachable(
                f"{joint.name} has no room to move in either direction at the rest pose; set another working_pose"
            )
        moves += found
    for number, move in enumerate(moves):
        measurement = yield GoToPose(subject.start + move, 0.0, done + 0.5 * number / len(moves))
        measurements += [measurement] if isinstance(measurement, Measurement) else []


def _feasible_move(subject: PlanSubject, move: Array) -> Array | None:
    """Return the move (n,) from the start pose, or the largest share of it inside all limits; None if there is none."""
    for part in MOVE_SHARES:
        if path_is_free(subject.statics, subject.limits, subject.start, subject.start + part * move, np.zeros(3)):
            return part * move
    return None


def latency(subject: PlanSubject) -> Procedure[LatencyResult]:
    """Find the latency of the tracker from a swing of the joints and the model's tip.

    Raises:
        UnobservableCombination: the swing was too slow.
    """
    yield GoToPose(subject.start, 0.0, 0.0)
    amplitudes = np.array([SWING_AMPLITUDES[joint.unit] for joint in subject.robot.joints])
    swung = yield SwingMotion(amplitudes, SWING_PERIOD_S, SWING_DURATION_S, 0.2)
    if not isinstance(swung, SwingRecord):
        raise AbortedError("the swing was not recorded")
    found = find_latency(swung.times, _tips(subject, swung.joints), swung.frame_times, swung.coils)
    return LatencyResult(found, float(swung.times[-1]))


def _tips(subject: PlanSubject, joints: Array) -> Array:
    """Return the model's tips (m, 3) without load [m]."""
    model = Statics(subject.robot, integrator="fourth_order")
    tips, solution = np.empty((len(joints), 3)), None
    for k, pose in enumerate(joints):
        solution = model.solve(pose, np.zeros(6), solution)
        tips[k] = solution.tip
    return tips
