"""Selection of the poses that a calibration measures: the most informative ones that the robot can reach in sequence.

The selection is greedy and D-optimal. Among many candidates inside the limits, the next pose is the candidate that
increases the log determinant of the information matrix A most. The increase is log det(1 + J A^-1 J^T), where J are the
candidate's rows of the fit's Jacobian. The selected poses are then ordered for short paths, and every path is checked
on the model before it is used.
"""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from core.calibration.measurements import Measurement, Noise
from core.calibration.prediction import Frames, Prediction, predict
from core.calibration.quantities import MIN_TUBE_DISTANCE_M, Quantity, end_distances
from core.calibration.rigid_transform import RigidTransform
from core.errors import CtrError, Unreachable
from core.model.batch import solve_many
from core.model.fold import margin_of_worst_tubes
from core.model.solution import pure_force
from core.model.statics import Statics
from core.robot.limits import Configuration, Limits
from core.robot.robot import Array, Flags, Indices, Robot

T = TypeVar("T")

#: Largest rotation of a candidate pose from zero [rad]; larger rotations repeat the poses within this range.
HALF_TURN_RAD = np.pi
#: Fraction of each joint's travel that candidate poses leave unused at both ends.
TRAVEL_MARGIN = 0.03
#: Tubes whose curvature and stiffness differ by this share from their description must not snap: before the calibration
#: they are not known better.
TUBE_UNCERTAINTY = 0.1
#: Number of checked poses on the path between two measurements.
PATH_STEPS = 12


def candidates(statics: Statics, limits: Limits, force: Array, count: int) -> Array:
    """Return feasible joint positions (m, n), m <= count, under a tip force (3,) [N]; they cover the limits evenly."""
    lower = np.array([max(j.lower, -HALF_TURN_RAD) if j.unit == "rad" else j.lower for j in limits.joints])
    upper = np.array([min(j.upper, HALF_TURN_RAD) if j.unit == "rad" else j.upper for j in limits.joints])
    inner = lower + (upper - lower) * (
        TRAVEL_MARGIN + (1.0 - 2.0 * TRAVEL_MARGIN) * low_discrepancy_points(count, lower.size)
    )
    found = inner[feasible(statics, limits, inner, force)]
    if not found.size:
        raise Unreachable(f"none of {count} poses inside the travel is inside all limits under {force.tolist()} N")
    return found


def low_discrepancy_points(count: int, n: int) -> Array:
    """Return points (count, n) that fill the unit cube evenly: the additive recurrence of the golden ratio."""
    ratio = 2.0
    for _ in range(40):
        ratio = (1.0 + ratio) ** (1.0 / (n + 1.0))
    steps = (1.0 / ratio) ** np.arange(1, n + 1)
    return (0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0


def feasible(statics: Statics, limits: Limits, poses: Array, force: Array) -> Flags:
    """Return which joint positions (m, n) are feasible (m,): inside travel, order and workspace, far from snapping.

    Ends of neighbouring tubes keep a distance, so that poses stay valid when a fit changes lengths, zeros and plays.
    """
    rows, bound = limits.order  # required even if the robot may retract its tip: a retracted tip is out of sight
    can = np.array([
        bool((rows @ joints <= bound).all())
        and _is_solvable(limits.check, joints)
        and _tubes_apart(statics.robot, joints)
        for joints in poses
    ])  # fmt: skip
    travel = poses[can]
    solved = solve_many(statics, travel, np.tile(pure_force(force), (len(travel), 1)))
    can[can] = [
        solved.ok[k]
        and margin_of_worst_tubes(statics, solved.at(k), travel[k], TUBE_UNCERTAINTY)[1] > 0.0
        and all(_is_solvable(limit.check, at) for limit in limits.others)
        for k, at in enumerate(map(Configuration, travel, solved.jacobian[:, :3], solved.tip, [force] * len(travel)))
    ]
    return can


def _tubes_apart(robot: Robot, joints: Array) -> bool:
    """Return whether tubes that slide end more than `MIN_TUBE_DISTANCE_M` from their neighbours' ends.

    Ends of fixed tubes stay where they are; `quantities` keeps them flush.
    """
    here, always = end_distances(robot, [joints]), end_distances(robot, ())
    return bool(((here > MIN_TUBE_DISTANCE_M) | (here >= always)).all())


def _is_solvable(check: Callable[[T], None], what: T) -> bool:
    try:
        check(what)
    except CtrError:
        return False
    return True


def select_poses(
    robot: Robot, what: tuple[Quantity, ...], poses: Array, force: Array, noise: Noise, count: int,
    known: Array | None = None,
) -> tuple[Indices, Array]:  # fmt: skip
    """Select the `count` most informative poses (m, n) under a force (3,) at the tip [N].

    Args:
        robot: best current description of the robot.
        what: tube quantities to fit in addition to the frames.
        poses: candidate joint positions (m, n).
        force: force at the tip (3,), world frame [N].
        noise: standard deviations of a measurement.
        count: number of poses to select.
        known: information matrix (p, p), in tolerances, of the poses visited so far; None: no poses yet.

    Returns:
        Indices (count,) in order of selection, and the information matrix (p, p) of all poses together.

    """
    empty = np.zeros((len(robot.sensor_names), 6))
    weight = None if force.any() else 0.0
    measurements = [Measurement(0.0, joints, np.zeros(3), empty, weight) for joints in poses]
    frames = Frames(RigidTransform(np.eye(3), np.zeros(3)), np.zeros(3), np.zeros(3))
    problem = Prediction(
        robot, what, expected_measurements(robot, measurements, force), np.tile(force, (len(poses), 1)), noise, frames
    )
    sizes = np.array([p.size for p in problem.parameters])
    rows = (problem.jacobian(np.zeros(sizes.size)) * sizes).reshape(len(poses), 3, -1)
    # Parameters without prior start with a small information, so that the gain of the first pose is finite.
    information = np.diag([max((p.size / p.prior) ** 2, 1e-4) for p in problem.parameters]) if known is None else known
    chosen: list[int] = []
    for _ in range(min(count, len(poses))):
        inner = np.eye(3) + rows @ np.linalg.inv(information) @ rows.transpose(0, 2, 1)
        gain = np.linalg.slogdet(inner)[1]
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        chosen.append(best)
        information = information + rows[best].T @ rows[best]
    return np.array(chosen, dtype=np.int64), information


def expected_measurements(robot: Robot, measurements: Sequence[Measurement], force: Array) -> list[Measurement]:
    """Return the measurements with the coil at the model's tip.

    Raises:
        NoSolution, PoseError: the model has no shape at a measurement.

    """
    tips = predict(robot, measurements, np.tile(force, (len(measurements), 1))).complete().tip
    return [measurement._replace(coil=tip) for measurement, tip in zip(measurements, tips, strict=True)]


def order_poses(statics: Statics, limits: Limits, start: Array, poses: Array, force: Array) -> Array:
    """Return poses (m, n) in an order of short paths from `start` (n,), each path inside the limits.

    A pose that cannot be reached straight from the current pose is deferred. Poses that cannot be reached from any
    other pose are omitted.

    Raises:
        Unreachable: no pose can be reached.

    """
    left, at = list(poses), start
    order: list[Array] = []
    while left:
        left.sort(key=lambda pose: float(np.abs((pose - at) / limits.speed).max()))
        following = next((k for k, pose in enumerate(left) if path_is_free(statics, limits, at, pose, force)), None)
        if following is None:
            break
        at = left.pop(following)
        order.append(at)
    if not order:
        raise Unreachable(f"none of {len(poses)} poses can be reached from {start.tolist()} inside the limits")
    return np.array(order)


def path_is_free(statics: Statics, limits: Limits, start: Array, end: Array, force: Array) -> bool:
    """Return whether the straight path between two joint positions stays inside all limits."""
    parts = np.arange(1, PATH_STEPS + 1)[:, None] / PATH_STEPS
    return bool(feasible(statics, limits, start + (end - start) * parts, force).all())
