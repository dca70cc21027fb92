"""Content of the scene: the last picture around the tip for the page's close-up view, and the run's desired path."""

from typing import Any, NamedTuple

import numpy as np

from core.control.trajectories import Setpoint
from core.robot.robot import Array
from station.control.loop import MotionTask
from station.control.task import StreamLimits
from station.service.status import StationStatus

#: Length of each tube's distal part that is sent to the close-up [m].
CLOSE_UP_LENGTH_M = 0.10
#: Points of the plate and its guide that the following view shows, relative to where the tubes leave it [m].
GUIDE_CORNERS_M = np.array([(x, 0.0, z) for x in (-0.02, 0.02) for z in (-0.02, 0.0)])
#: Largest number of points of the desired path that are sent to the close-up.
PATH_POINTS = 240


class SceneContent(NamedTuple):
    """Content of one picture in the world frame; values that are not measured now are None."""

    message: str  #: text that lists the values that are not measured now; empty if all are
    age: float  #: age of the newest telemetry row [s]
    tubes: tuple[Array, ...]  #: distal part of each tube's centre line (k, 3) [m]; empty if the model has no solution
    estimated: Array | None  #: position of the tip by the model (3,) [m]
    measured: Array | None  #: position of the tip by the tracker (3,) [m]
    desired: Array | None  #: desired position of the tip (3,) [m]
    force: Array | None  #: force on the robot (3,) [N]; None also if it is only noise
    place: Array | None  #: point where the force acts (3,) [m]
    contact: str  #: position of a contact on the shaft as text; empty if the force acts at the tip
    trace: Array  #: recent positions of the measured tip, oldest first (n, 3) [m]
    path: Array  #: desired path of the tip (m, 3) [m]
    robot: Array = np.empty((0, 3))  #: drawn centre line from the plate to the last tube end (k, 3) [m]
    model_end: Array = np.empty((0, 3))  #: end of the model's centre line (k, 3) [m]; empty near the measured tip
    model_error: float | None = None  #: distance of the model's tip from the measured tip [m], smoothed

    @property
    def tip(self) -> Array | None:
        """Best known position of the tip (3,) [m]; None: unknown."""
        known = (*(line[-1] for line in self.tubes[:1] if len(line)), self.estimated, self.measured)
        return next((tip for tip in known if tip is not None), None)

    @property
    def framed(self) -> Array:
        """Points (k, 3) [m] that the following view shows: robot with its guide, path, trace and load."""
        place = NO_POINTS if self.place is None else self.place[None]
        return np.concatenate((self.robot, self.robot[:1] + GUIDE_CORNERS_M, self.path, self.trace, place))

    def to_json(self) -> dict[str, Any]:
        """Return the content as JSON values for the page, positions in millimetres."""
        return {
            "message": self.message,
            "age": round(self.age, 2),
            "tubes": [_mm(line) for line in self.tubes],
            "estimated": _mm(self.estimated),
            "measured": _mm(self.measured),
            "desired": _mm(self.desired),
            "force": None if self.force is None else np.round(self.force, 4).tolist(),
            "place": _mm(self.place),
            "contact": self.contact,
            "trace": _mm(self.trace),
            "model_end": _mm(self.model_end),
            "model_error": None if self.model_error is None else round(1e3 * self.model_error, 2),
            "path": _mm(self.path[:: len(self.path) // PATH_POINTS + 1]),
        }


NO_POINTS = np.empty((0, 3))
NOTHING = SceneContent("no telemetry yet", 0.0, (), None, None, None, None, None, "", NO_POINTS, NO_POINTS)


def _mm(points: Array | None) -> Any:
    return None if points is None else np.round(1e3 * points, 2).tolist()


MIN_STEP_M = 5e-4  #: distance between points of the drawn path [m]
MAX_STEP_S = 0.05  #: largest time between sampled points of the path [s]
MAX_POINTS = 2000  #: largest number of points of the path; a longer path is cut


def path_offsets(task: MotionTask) -> Array:
    """Return points (k, 3) [m] of a task's path relative to the tip at the start; a periodic path ends after a period.

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
