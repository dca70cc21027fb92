"""The procedures `axes` and `latency`, which come first on a new bench.

`axes` finds signs and zeros of the axes; `latency` finds the latency of the tracker.
"""

from collections.abc import Mapping, Sequence
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
from core.robot.robot import Array, Flags
from station.calibration.plan import MEASUREMENT_NOISE, PlanSubject
from station.calibration.procedure import AbortedError, GoToPose, Procedure, SwingMotion, SwingRecord

#: Sizes of the small moves about the start pose that determine the signs, and of the larger moves that determine the
#: zeros [rad, m].
SMALL_MOVES, LARGE_MOVES = {"rad": 0.25, "m": 0.010}, {"rad": 1.2, "m": 0.015}
#: Sizes of the moves of joints whose small moves do not show their sign at the tip [rad, m].
FAR_MOVES = {"rad": 3.0, "m": 0.060}
#: Shares of a move, tried in this order if limits (joint travel, ends of the tubes) do not allow the whole move.
MOVE_SHARES = (1.0, 0.8, 0.6, 0.4, 0.2, 0.1)
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

    Joints whose sign does not show move again, as far as the limits allow in both directions. A sign that still does
    not show, such as that of a straight tube's rotation, is 0 in the result.

    Raises:
        UnobservableCombination: the signs are ambiguous.
        Unreachable: the limits allow no move of any joint.
    """
    measurements: list[Measurement] = []
    every = np.ones(len(subject.robot.joints), bool)
    yield from _moves(subject, SMALL_MOVES, every, 0.0, measurements)
    # A stage that is reversed reports its correct position only in the middle of its travel.
    middle = np.array([0.5 * (limit.lower + limit.upper) for limit in subject.limits.joints])
    signs = find_signs(subject.robot, middle, measurements)
    if (unseen := signs.signs == 0.0).any():
        yield from _moves(subject, FAR_MOVES, unseen, 0.25, measurements, mirrored=True)
        signs = find_signs(subject.robot, middle, measurements)
    if (signs.signs < 0.0).any():
        # The larger moves need correct directions, so the operator must correct the station file first.
        return AxesResult(signs, (), tuple(measurements))
    yield from _moves(subject, LARGE_MOVES, signs.signs != 0.0, 0.5, measurements)
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
    subject: PlanSubject, steps: Mapping[str, float], which: Flags, done: float, measurements: list[Measurement],
    mirrored: bool = False,
) -> Procedure[None]:  # fmt: skip
    """Move each joint of `which` (n,) in both directions from the start pose.

    `done` is the share of the procedure that is done before the moves. Joints without room do not move; with
    `mirrored`, a move is short enough to be free in both directions, because the axis may be reversed.
    """
    moves: list[Array] = []
    for k in np.flatnonzero(which).tolist():
        joint = subject.robot.joints[k]
        both = [sign * steps[joint.unit] * np.eye(len(subject.robot.joints))[k] for sign in (1.0, -1.0)]
        moves += [
            part * move for move in both if (part := _free_share(subject, both if mirrored else [move])) is not None
        ]
    if not moves and done == 0.0:
        raise Unreachable("no joint has room to move in either direction at the rest pose; set another working_pose")
    for number, move in enumerate(moves):
        measurement = yield GoToPose(subject.start + move, 0.0, done + 0.25 * number / len(moves))
        measurements += [measurement] if isinstance(measurement, Measurement) else []


def _free_share(subject: PlanSubject, moves: Sequence[Array]) -> float | None:
    """Return the largest share of moves (n,) from the start pose that is inside all limits; None if there is none."""
    for part in MOVE_SHARES:
        ends = (subject.start + part * move for move in moves)
        if all(path_is_free(subject.statics, subject.limits, subject.start, end, np.zeros(3)) for end in ends):
            return part
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
        raise AbortedError("the oscillation of the joints was not recorded; repeat the procedure")
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
