"""Files of poses of an exact rod, as a laboratory measures them with a tracker."""

import csv
from pathlib import Path

import numpy as np

from core.calibration.quantities import quantities, with_changes
from core.calibration.rigid_transform import RigidTransform, rotation_from_vector
from core.model.cosserat import ExactRod
from station.config.robots import load_robot

TRACKER = RigidTransform(rotation_from_vector(np.array([1.0, -2.0, 0.5])), np.array([0.3, 0.2, -0.1]))


def written_poses(
    folder: Path,
    name: str,
    *,
    poses: int = 60,
    force: float = 0.0,
    play: tuple[float, float] = (0.0, 0.0),
    curvature: float = 0.0,
    timed: bool = True,
) -> Path:
    """Write poses along a random walk of the joints to a CSV file and return its path.

    Each curvature of the tubes is larger by the share `curvature`. The tubes follow the joints with a play of
    `play` [rad, m]. The components of the force have the standard deviation `force` [N]. The sensor is beside the tip.
    """
    file, random = load_robot(name), np.random.default_rng(3)
    robot, limits = file.robot(), file.limits().joints
    what = [quantity for quantity in quantities(robot) if quantity.kind == "curvature"]
    exact = ExactRod(with_changes(robot, what, np.full(len(what), curvature)))
    lower = np.array([max(limit.lower, -1.2) for limit in limits])
    upper = np.array([min(limit.upper, 1.2) for limit in limits])
    width = np.array([play[limit.unit == "m"] for limit in limits])
    joints = behind = 0.5 * (lower + upper)
    path = folder / f"{name}.csv"
    with path.open("w", newline="") as out:
        writer = csv.writer(out)
        forces = ("force_x", "force_y", "force_z")
        writer.writerow([*(["time"] if timed else []), *robot.joint_names, "tip_x", "tip_y", "tip_z", *forces])
        for number in range(poses):
            moved = np.clip(joints + 0.3 * (upper - lower) * random.uniform(-1.0, 1.0, len(limits)), lower, upper)
            joints = moved if robot.is_valid_pose(moved) else joints
            behind = np.clip(behind, joints - 0.5 * width, joints + 0.5 * width)
            load = force * random.standard_normal(3)
            rod = exact.solve(behind, np.r_[load, 0.0, 0.0, 0.0])
            tip = TRACKER.apply(rod.tip + rod.rotation @ [0.0, 1e-3, 8e-3]) + 2e-5 * random.standard_normal(3)
            writer.writerow([*([float(number)] if timed else []), *joints, *tip, *load])
    return path
