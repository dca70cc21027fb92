"""Inverse kinematics of positions: poses at which the tip is at a point, with a direction if one is given.

A robot may reach a point in several poses, so `reaching_poses` moves the tip to the point from start poses all over the
joint space.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.stats import qmc

from core.control.reachability import SolvedConfiguration
from core.control.tip_motion import ARROW_M, Aim, move_tip
from core.errors import CtrError
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.solve_many import solve_many

#: Largest number of joint positions that are drawn for each requested pose. If a robot needs more, almost no pose is
#: valid, and the robot is refused.
MAX_DRAWS = 1000
#: Two poses count as equal if each joint moves from one to the other in at most this time at full speed [s].
SAME_POSE_S = 1e-2
#: Number of compared start poses, and largest number of those from which a path to the point is computed.
START_POSES, MAX_PATHS = 400, 40


def spread_poses(file: RobotFile, count: int, seed: int, ordered: bool = True) -> Array:
    """Return valid poses (count, n) that a Halton sequence spreads evenly over the travel of the joints [rad or m].

    A joint that can turn by more than a full turn gets the middle turn of its travel. `ordered`: every tube ends beyond
    the tube around it, even if the robot permits other orders.

    Raises:
        ConfigError: almost no joint position of the robot is valid.

    """
    robot, limits = file.robot(), file.limits()
    lower, upper = limits.packed[0].copy(), limits.packed[1].copy()
    for j, joint in enumerate(robot.joints):
        if joint.motion == "rotation" and upper[j] - lower[j] > 2.0 * np.pi:
            middle = 0.5 * (lower[j] + upper[j])
            lower[j], upper[j] = middle - np.pi, middle + np.pi
    rows, bound = limits.order if ordered else limits.required_order
    drawing = qmc.Halton(len(lower), rng=np.random.default_rng(seed))
    found, drawn, left = list[Array](), 0, count
    while left > 0:
        if drawn > MAX_DRAWS * count:
            raise ConfigError(
                f"robot '{robot.name}': almost no joint position is valid (tubes collide or are out of order):"
                " check lengths and travel"
            )
        poses = qmc.scale(drawing.random(count), lower, upper)
        drawn += count
        poses = poses[(poses @ rows.T <= bound).all(axis=1)]
        found.append(np.array([pose for pose in poses if robot.is_valid_pose(pose)]).reshape(-1, len(lower))[:left])
        left -= len(found[-1])
    return np.concatenate(found)


class ReachingPoses(NamedTuple):
    """Result of a search for poses at which the tip is at an aim."""

    poses: tuple[Solution, ...]  #: different poses within the tolerance, the most stable first
    nearest: Solution  #: pose with the smallest distance, also if it is beyond the tolerance
    distance: float  #: distance of the nearest pose, see `Aim.distance` [m]
    why: str  #: why the nearest pose is not within the tolerance; empty if it is
    retracted: bool  #: whether the poses have the tip inside another tube, because no other pose was found


def reaching_poses(file: RobotFile, aim: Aim, seed: int = 0) -> ReachingPoses:
    """Return poses whose tip is at an aim, inside all limits of the robot.

    Poses at which every tube ends beyond the tube around it are preferred. Other poses are searched only if the robot's
    limits permit them and no preferred pose is found.

    Raises:
        ConfigError: almost no joint position is valid.
    """
    limits, model = file.limits(), Statics(file.robot())
    found = _reaching(file, model, limits, aim, seed, ordered=True)
    if found.poses or limits.order[1].size == limits.required_order[1].size:
        return found
    retracted = _reaching(file, model, limits, aim, seed, ordered=False)
    return retracted if retracted.distance < found.distance else found


def _reaching(file: RobotFile, model: Statics, limits: Limits, aim: Aim, seed: int, *, ordered: bool) -> ReachingPoses:
    nearest, least, why = None, math.inf, "no pose has a shape"
    poses = list[Solution]()
    for at, distance, reason in paths(file, model, limits, aim, seed, ordered=ordered):
        if not reason:
            try:
                limits.check_all(SolvedConfiguration(model, at))
            except CtrError as beyond:
                reason = str(beyond)
        if not reason and all(np.abs(_travel(model, one, at) / limits.speed).max() > SAME_POSE_S for one in poses):
            poses.append(at)
        if nearest is None or (bool(reason), distance) < (bool(why), least):
            nearest, least, why = at, distance, reason
    if nearest is None:
        raise ConfigError(f"robot '{file.name}': {why} under this load")
    poses.sort(key=lambda one: -one.stability)
    return ReachingPoses(tuple(poses), nearest, least, why, not ordered)


def _travel(model: Statics, one: Solution, other: Solution) -> Array:
    """Return the difference of joints (n,) [rad or m]; a whole turn of a tube does not change the shape."""
    turns = np.array([joint.motion == "rotation" for joint in model.robot.joints])
    apart = other.joints - one.joints
    return np.where(turns, (apart + np.pi) % (2.0 * np.pi) - np.pi, apart)


def paths(
    file: RobotFile, model: Statics, limits: Limits, aim: Aim, seed: int, starts: int = START_POSES,
    most: int = MAX_PATHS, *, ordered: bool = True,
) -> Iterator[tuple[Solution, float, str]]:  # fmt: skip
    """Yield the results of `move_tip` from the start poses whose tips are nearest to the aim."""
    poses = spread_poses(file, starts, seed, ordered)
    found = solve_many(model, poses, np.zeros((starts, 6)), threads=1)
    distances = np.linalg.norm(found.tip - aim.point, axis=1)
    if aim.direction is not None:
        distances = distances + ARROW_M * np.linalg.norm(found.rotation[:, :, 2] - aim.direction, axis=1)
    order = limits.order if ordered else limits.required_order
    for row in [row for row in np.argsort(distances).tolist() if found.ok[row]][:most]:
        yield move_tip(model, limits, order, found.at(row), aim)
