"""Joint positions (poses) that are evenly spread over the joint space of a robot."""

import numpy as np
from scipy.stats import qmc

from core.robot.robot import Array
from station.config.robots import RobotFile
from station.config.strict import ConfigError

#: Largest number of joint positions that are drawn for each requested pose. If a robot needs more, almost no pose is
#: valid, and the robot is refused.
MAX_DRAWS = 1000


def spread_poses(file: RobotFile, count: int, seed: int) -> Array:
    """Return valid poses (count, n) that a Halton sequence spreads evenly over the travel of the joints [rad or m].

    Of a rotation only the turn in the middle of the travel is used, because other turns give the same shapes.

    Raises:
        ConfigError: almost no joint position of the robot is valid.

    """
    robot, limits = file.robot(), file.limits()
    lower, upper = limits.packed[0].copy(), limits.packed[1].copy()
    for j, joint in enumerate(robot.joints):
        if joint.motion == "rotation" and upper[j] - lower[j] > 2.0 * np.pi:
            middle = 0.5 * (lower[j] + upper[j])
            lower[j], upper[j] = middle - np.pi, middle + np.pi
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
        found.append(np.array([pose for pose in poses if robot.is_valid_pose(pose)]).reshape(-1, len(lower))[:left])
        left -= len(found[-1])
    return np.concatenate(found)
