"""Desired path of a run, as points that the scene draws."""

import numpy as np

from core.control.trajectories import Setpoint
from core.robot.robot import Array
from station.control.loop import MotionTask
from station.control.streamed_motion import StreamLimits
from station.service.status import StationStatus

MIN_STEP_M = 5e-4  #: distance between points of the drawn path [m]
MAX_STEP_S = 0.05  #: largest time between sampled points of the path [s]
MAX_POINTS = 2000  #: largest number of points of the path; a longer path is cut


def path_offsets(task: MotionTask) -> Array:
    """Return points (k, 3) [m] of a task's path relative to the tip at the start; of a periodic path, one period.

    The result has fewer than two points if the task has no path, for example a rest or a joint motion.
    """
    if isinstance(task.orders, StreamLimits):
        return np.empty((0, 3))  # the path of a streamed motion is unknown in advance
    time, points = 0.0, []
    first = task.orders.at(0.0)
    if not isinstance(first, Setpoint):
        return np.empty((0, 3))
    left = False
    while time <= task.duration and len(points) < MAX_POINTS:
        order = task.orders.at(time)
        if not isinstance(order, Setpoint):
            break
        points.append(order.position)
        distance = float(np.linalg.norm(order.position - first.position))
        left = left or distance > 4.0 * MIN_STEP_M
        if (
            left
            and distance < 1.5 * MIN_STEP_M
            and order.velocity @ first.velocity > 0.9 * (first.velocity @ first.velocity)
        ):
            points.append(first.position)
            break
        time += min(MIN_STEP_M / max(float(np.linalg.norm(order.velocity)), 1e-9), MAX_STEP_S)
    path = np.array(points)
    return path if np.ptp(path, axis=0).max() > MIN_STEP_M else path[:1]


def path(task: MotionTask, status: StationStatus) -> Array:
    """Return the points of `path_offsets` in the world frame (k, 3) [m] for a task that is moving now."""
    if isinstance(task.orders, StreamLimits):
        return np.empty((0, 3))
    now = task.orders.at(status.progress * task.duration)
    points = path_offsets(task)
    if not isinstance(now, Setpoint) or len(points) < 2:
        return np.empty((0, 3))
    return points + status.values["tip_desired"] - now.position
