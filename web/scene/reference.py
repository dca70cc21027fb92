"""The path that a run will ask the tip to follow, drawn before it is followed."""

import numpy as np

from core.control.trajectories import Setpoint
from core.robot.robot import Array
from station.control.led import Lead
from station.control.loop import Task
from station.service.status import Status

STEP = 5e-4  #: between points [m]
LONGEST_STEP = 0.05  #: [s]
MOST = 2000  #: points; a longer path is cut


def offsets(task: Task) -> Array:
    """Points (k, 3) [m] of a task's path, from the tip at its start; a periodic motion's first lap.

    Less than two where no path is asked for: to hold still, or to move a joint.
    """
    if isinstance(task.orders, Lead):
        return np.empty((0, 3))  # nobody knows it beforehand
    time, points = 0.0, []
    first = task.orders.at(0.0)
    if not isinstance(first, Setpoint):
        return np.empty((0, 3))
    left = False
    while time <= task.duration and len(points) < MOST:
        order = task.orders.at(time)
        if not isinstance(order, Setpoint):
            break
        points.append(order.position)
        way = float(np.linalg.norm(order.position - first.position))
        left = left or way > 4.0 * STEP
        if left and way < 1.5 * STEP and order.velocity @ first.velocity > 0.9 * (first.velocity @ first.velocity):
            points.append(first.position)
            break
        time += min(STEP / max(float(np.linalg.norm(order.velocity)), 1e-9), LONGEST_STEP)
    path = np.array(points)
    return path if np.ptp(path, axis=0).max() > STEP else path[:1]


def path(task: Task, status: Status) -> Array:
    """`offsets` in the world (k, 3) [m], while the task is in motion."""
    if isinstance(task.orders, Lead):
        return np.empty((0, 3))
    now = task.orders.at(status.progress * task.duration)
    points = offsets(task)
    if not isinstance(now, Setpoint) or len(points) < 2:
        return np.empty((0, 3))
    return points + status.values["tip_desired"] - now.position
