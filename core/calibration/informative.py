"""Which poses to measurement: those that say most by the model, reachable one after the other.

Greedy D-optimal design: of many candidates inside the limits the next one is always that which adds most to
log det of the information, log det(1 + J A^-1 J^T) for its rows J. The chosen ones are then put in an order of
short ways, and each way is walked on the model before it is taken.
"""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from core.calibration.measurements import Measurement, Noise
from core.calibration.prediction import Frames, Prediction, predicted
from core.calibration.quantities import Quantity
from core.calibration.rigid import Rigid
from core.errors import CtrError, Unreachable
from core.model.many import solve_many
from core.model.solution import pure_force
from core.model.statics import Statics
from core.robot.limits import At, Limits
from core.robot.robot import Array, Flags, Indices, Robot

T = TypeVar("T")

#: Rotations further than half a turn from zero show nothing new [rad].
HALF_TURN = np.pi
#: Part of each travel that is left free at either end.
MARGIN = 0.03
#: Below this margin of elastic stability a pose is left out.
STABLE = 0.25
#: Between the ends of neighbouring tubes [m].
APART = 1.5e-3
#: Poses that are looked at on the way between two measurements.
STEPS = 12


def candidates(statics: Statics, limits: Limits, force: Array, count: int) -> Array:
    """Joint positions (m, n) spread evenly over what the limits allow under a tip force (3,); m <= count."""
    lower = np.array([max(j.lower, -HALF_TURN) if j.unit == "rad" else j.lower for j in limits.joints])
    upper = np.array([min(j.upper, HALF_TURN) if j.unit == "rad" else j.upper for j in limits.joints])
    inner = lower + (upper - lower) * (MARGIN + (1.0 - 2.0 * MARGIN) * evenly(count, lower.size))
    found = inner[possible(statics, limits, inner, force)]
    if not found.size:
        raise Unreachable(f"none of {count} poses inside the travel is inside all limits under {force.tolist()} N")
    return found


def evenly(count: int, n: int) -> Array:
    """Points (count, n) that fill the unit cube evenly: the additive recurrence of the generalised golden ratio."""
    ratio = 2.0
    for _ in range(40):
        ratio = (1.0 + ratio) ** (1.0 / (n + 1.0))
    steps = (1.0 / ratio) ** np.arange(1, n + 1)
    return (0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0


def possible(statics: Statics, limits: Limits, poses: Array, force: Array) -> Flags:
    """At which joint positions (m, n) the robot can stand (m,): inside travel, order, workspace, far from snapping.

    Ends of neighbouring tubes keep apart: lengths, zeros and plays that a fit tries must not put one inside the other.
    """
    can = np.array([_holds(limits.check, joints) and _apart(statics.robot, joints) for joints in poses])
    travel = poses[can]
    solved = solve_many(statics, travel, np.tile(pure_force(force), (len(travel), 1)))
    can[can] = [
        solved.ok[k] and solved.stability[k] > STABLE and all(_holds(limit.check, at) for limit in limits.others)
        for k, at in enumerate(map(At, travel, solved.jacobian[:, :3], solved.tip, [force] * len(travel)))
    ]
    return can


def _apart(robot: Robot, joints: Array) -> bool:
    """Whether every tube ends clearly beyond its neighbour."""
    ends = robot.tube_poses(joints)[1] + np.array([tube.length for tube in robot.tubes])
    return bool((ends[:-1] - ends[1:] > APART).all())


def _holds(check: Callable[[T], None], what: T) -> bool:
    try:
        check(what)
    except CtrError:
        return False
    return True


def choose(
    robot: Robot, what: tuple[Quantity, ...], poses: Array, force: Array, noise: Noise, count: int,
    known: Array | None = None,
) -> tuple[Indices, Array]:  # fmt: skip
    """The `count` most informative of poses (m, n) under a force (3,) at the tip [N].

    Args:
        robot: as it is believed to be.
        what: quantities of its tubes that are asked for beside the frames.
        poses: to choose from.
        force: at the tip, world frame [N].
        noise: of a measurement.
        count: how many.
        known: information (p, p), in sizes, of what has been visited already.

    Returns:
        Indices (count,) in order of choice, and the information (p, p) of all together.

    """
    empty = np.zeros((len(robot.tubes), 6))
    weight = None if force.any() else 0.0
    measurements = [Measurement(0.0, joints, np.zeros(3), empty, weight) for joints in poses]
    frames = Frames(Rigid(np.eye(3), np.zeros(3)), np.zeros(3), np.zeros(3))
    problem = Prediction(
        robot, what, placed(robot, measurements, force), np.tile(force, (len(poses), 1)), noise, frames
    )
    sizes = np.array([p.size for p in problem.parameters])
    rows = (problem.jacobian(np.zeros(sizes.size)) * sizes).reshape(len(poses), 3, -1)
    # What nothing is known of beforehand starts nearly unknown, so that the first choices have a value.
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


def placed(robot: Robot, measurements: Sequence[Measurement], force: Array) -> list[Measurement]:
    """Measurements with the coil where the model has the tip.

    Raises:
        NoSolution, PoseError: it has none at one of them.

    """
    tips = predicted(robot, measurements, np.tile(force, (len(measurements), 1))).complete().tip
    return [measurement._replace(coil=tip) for measurement, tip in zip(measurements, tips, strict=True)]


def tour(statics: Statics, limits: Limits, start: Array, poses: Array, force: Array) -> Array:
    """Poses (m, n) in an order of short ways from `start` (n,), each way inside the limits.

    A pose that cannot be reached straight from where the robot is waits for another turn; one that can be reached
    from nowhere is left out.

    Raises:
        Unreachable: none can be reached.

    """
    left, at = list(poses), start
    order: list[Array] = []
    while left:
        left.sort(key=lambda pose: float(np.abs((pose - at) / limits.speed).max()))
        following = next((k for k, pose in enumerate(left) if way_is_free(statics, limits, at, pose, force)), None)
        if following is None:
            break
        at = left.pop(following)
        order.append(at)
    if not order:
        raise Unreachable(f"none of {len(poses)} poses can be reached from {start.tolist()} inside the limits")
    return np.array(order)


def way_is_free(statics: Statics, limits: Limits, start: Array, end: Array, force: Array) -> bool:
    """Whether the straight way between two joint positions stays inside all limits."""
    parts = np.arange(1, STEPS + 1)[:, None] / STEPS
    return bool(possible(statics, limits, start + (end - start) * parts, force).all())
