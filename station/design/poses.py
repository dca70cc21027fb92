"""Poses all over the joint space of given tubes."""

import numpy as np
from scipy.stats import qmc

from core.robot.robot import Array
from station.config.robots import RobotFile
from station.config.strict import ConfigError

#: Draws for each pose that is wanted, before a robot file is given up.
MOST_DRAWS = 1000


def spread_poses(file: RobotFile, count: int, seed: int) -> Array:
    """Poses (count, n) evenly spread (Halton) over the joints' travel, where the tubes stand [rad or m].

    Of a rotation's travel only the turn in its middle is taken: the others are the same shapes.

    Raises:
        ConfigError: the tubes stand hardly anywhere in it.

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
        if drawn > MOST_DRAWS * count:
            raise ConfigError(f"robot '{robot.name}': its tubes stand hardly anywhere in the travel of its joints")
        poses = qmc.scale(drawing.random(count), lower, upper)
        drawn += count
        found.append(np.array([pose for pose in poses if robot.stands(pose)]).reshape(-1, len(lower))[:left])
        left -= len(found[-1])
    return np.concatenate(found)
