"""A place for the tip that a person points at: whether it can be reached from here, and the way there."""

import math
from typing import NamedTuple

import numpy as np

from core.control.pointing import PLACE, Aim, turn
from core.control.reachability import check_reach
from core.errors import CtrError
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array
from station.config.motions import WaypointsMotion, directions_of

#: Mean speed on the way [m/s] and the shortest time for it [s].
SPEED, SHORTEST = 0.008, 2.0
#: And of the direction, where the tip is to point elsewhere [rad/s].
TURN = 0.1
#: Where the joints are too slow the way is tried again in so many times the time.
SLOWER = (1.0, 2.0, 4.0)
#: No way is longer [m]: what is tried on the model has an end.
FARTHEST = 0.35
#: Held at the place afterwards [s].
STAY = 3.0


class Way(NamedTuple):
    """How to get to a target."""

    motion: WaypointsMotion | None  #: None when it cannot be reached
    duration: float  #: with the stay [s]
    reason: str  #: why not; empty when it can


class Pointing(NamedTuple):
    """Where the tip is to point at the target."""

    aim: Aim  #: the controller's
    now: Array  #: (3,) where it points, unit vector
    told: Array  #: (3,) where it should, unit vector


def way_to(
    target: Array, statics: Statics, limits: Limits, joints: Array, tip: Array, force: Array,
    pointing: Pointing | None = None,
) -> Way:  # fmt: skip
    """The quickest of a few straight ways that the robot can follow, walked on the model.

    Args:
        target: (3,) world frame [m].
        statics, limits: the controller's.
        joints: where they are (n,) [rad or m].
        tip: where the tip is (3,) [m].
        force: on the tip now, and taken to stay (3,) [N].
        pointing: which direction it turns to on the way; None: that is not controlled.
    """
    offset = target - tip
    distance = float(np.linalg.norm(offset))
    if not distance <= FARTHEST:
        return Way(None, 0.0, f"{1e3 * distance:.0f} mm away, more than {1e3 * FARTHEST:.0f} mm")
    shortest = max(SHORTEST, distance / SPEED)
    if pointing is not None:
        shortest = max(shortest, float(np.linalg.norm(turn(pointing.now, pointing.told))) / TURN)
    reason = ""
    for slower in SLOWER:
        time = slower * shortest
        end = math.ceil(10.0 * time) / 10.0
        directions = () if pointing is None else ((0.0, *pointing.now.tolist()), (end, *pointing.told.tolist()))
        try:
            motion = WaypointsMotion(points=((end, *offset.tolist()),), directions=directions)
            check_reach(
                statics, limits, joints, motion.trajectory(), time + 0.5, lambda _: force,
                PLACE if pointing is None else pointing.aim, directions_of(motion.directions),
            )  # fmt: skip
        except (CtrError, ValueError) as error:
            reason = str(error)
            continue
        return Way(motion, time + STAY, "")
    return Way(None, 0.0, reason)
