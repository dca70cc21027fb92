"""Check waypoints on the model before anything moves; find the first one that cannot be reached, and the reason."""

import bisect
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from core.control.step import Controller
from core.errors import CtrError, DescriptionError
from core.robot.robot import Array
from station.config.motions import Orders, Places, WaypointsMotion
from station.service.suggestion import suggest_motion

#: Number of points of the drawn path between two waypoints, and largest number of points of the whole path.
POINTS_PER_SEGMENT, MAX_POINTS = 12, 600


class FeasibilityResult(NamedTuple):
    """Result of the check of a path through waypoints."""

    reason: str  #: why the path cannot be followed; empty when it can
    place: int | None  #: index of the first waypoint that cannot be reached, from 0
    instead: str  #: suggestion of a possible motion; empty if there is none
    path: Array  #: tip path through the waypoints, from the start (k, 3) [m]; empty if there is no trajectory


def check_waypoints(
    places: Places, controller: Controller, joints: Array, cancelled: Callable[[], bool] = lambda: False
) -> FeasibilityResult:
    """Check the waypoints `places` from `joints` (n,) [rad or m] with the limits of this controller.

    Raises:
        Cancelled: `cancelled` returned True; the result is no longer required.
    """
    times = [row[0] for row in places.points]
    try:
        trajectory = places.trajectory()
    except DescriptionError as error:
        return FeasibilityResult(str(error), _waypoint_index(times, error), "", np.empty((0, 3)))
    count = min(MAX_POINTS, POINTS_PER_SEGMENT * (len(times) + 1))
    path = np.array([trajectory.setpoint(time).position for time in np.linspace(0.0, times[-1], count)])
    motion = WaypointsMotion.model_validate(places.model_dump(include=set(Places.model_fields)))
    try:
        Orders(motion, controller.statics.robot).check(controller, joints, times[-1], cancelled=cancelled)
    except CtrError as error:
        instead = suggest_motion(motion, controller, joints, times[-1], cancelled)
        return FeasibilityResult(str(error), _waypoint_index(times, error), instead, path)
    return FeasibilityResult("", None, "", path)


def _waypoint_index(times: list[float], error: CtrError) -> int | None:
    """Return the index of the waypoint that follows the time of the error, at most the last one."""
    return None if error.time is None else min(bisect.bisect_left(times, error.time - 1e-9), len(times) - 1)
