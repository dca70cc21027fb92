"""Places and times tried on the model before anything moves: the first that the tip does not get to, and why."""

import bisect
from typing import NamedTuple

import numpy as np

from core.control.step import Controller
from core.errors import CtrError, DescriptionError
from core.robot.robot import Array
from station.config.motions import Orders, Places, WaypointsMotion
from station.service.suggestion import suggestion

#: Points between two places of the path that is drawn, and how many there are at most.
BETWEEN, MOST_POINTS = 12, 600


class Tried(NamedTuple):
    """What came of it."""

    reason: str  #: why it cannot be followed; empty when it can
    place: int | None  #: the first that is not got to, from 0
    instead: str  #: what would work; empty when nothing that was tried does
    path: Array  #: on the way through the places, from the start tip (k, 3) [m]; none where there is no way


def try_places(places: Places, controller: Controller, joints: Array) -> Tried:
    """Walk through `places` from `joints` (n,) [rad or m], at this controller's limits."""
    times = [row[0] for row in places.points]
    try:
        way = places.trajectory()
    except DescriptionError as error:
        return Tried(str(error), _place(times, error), "", np.empty((0, 3)))
    count = min(MOST_POINTS, BETWEEN * (len(times) + 1))
    path = np.array([way.setpoint(time).position for time in np.linspace(0.0, times[-1], count)])
    motion = WaypointsMotion.model_validate(places.model_dump(include=set(Places.model_fields)))
    try:
        Orders(motion, controller.statics.robot).check(controller, joints, times[-1])
    except CtrError as error:
        return Tried(str(error), _place(times, error), suggestion(motion, controller, joints, times[-1]), path)
    return Tried("", None, "", path)


def _place(times: list[float], error: CtrError) -> int | None:
    """That the tip was on the way to when it went wrong; the last for what goes wrong after it."""
    return None if error.time is None else min(bisect.bisect_left(times, error.time - 1e-9), len(times) - 1)
