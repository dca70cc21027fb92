"""Planning of a motion of the tip to a target in the scene, and the check whether the tip can reach it."""

import math
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from core.control.reachability import check_reach
from core.control.tip_direction import POSITION_ONLY, TaskSelection, shortest_rotation
from core.errors import CtrError
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array
from station.config.motions import WaypointsMotion, directions_of

#: Mean speed of the tip during a motion to a target [m/s], and the shortest duration of such a motion [s].
MEAN_SPEED_M_S, MIN_DURATION_S = 0.008, 2.0
#: Mean turning speed of the tip's direction during the motion [rad/s].
MEAN_TURN_RAD_S = 0.1
#: Factors on the duration of the motion. They are tried in this order until the robot can follow the motion.
SLOWER_FACTORS = (1.0, 2.0, 4.0)
#: Largest distance of a target from the tip [m]; the bound limits the computing time of the check on the model.
MAX_DISTANCE_M = 0.35
#: Time for which the tip stays at the target after the motion [s].
HOLD_TIME_S = 3.0
#: A check stays valid while target [m], its direction, joints [rad or m] and force [N] change less than this.
TOLERANCES = (1e-5, 1e-4, 1e-3, 0.02)
#: A check stays valid for this time [s] although joints or force change, as they always do during a run.
MIN_PERIOD_S = 3.0


class TargetMotion(NamedTuple):
    """Motion of the tip to a target, or the reason why there is none."""

    motion: WaypointsMotion | None  #: straight motion to the target; None: the target cannot be reached
    duration: float  #: duration of the motion, including the time at the target [s]
    reason: str  #: why the target cannot be reached; empty if it can


class DirectionTarget(NamedTuple):
    """Desired direction of the tip at the target."""

    aim: TaskSelection  #: which components of position and direction the controller controls
    now: Array  #: present direction of the tip (3,), unit vector
    desired: Array  #: desired direction of the tip (3,), unit vector


def plan_target_motion(
    target: Array, statics: Statics, limits: Limits, joints: Array, tip: Array, force: Array,
    pointing: DirectionTarget | None = None,
) -> TargetMotion:  # fmt: skip
    """Return the fastest of a few straight motions to a target that the robot can follow according to the model.

    Args:
        target: position of the target (3,), world frame [m].
        statics, limits: model and limits that the controller uses.
        joints: present joint positions (n,) [rad or m].
        tip: present position of the tip (3,) [m].
        force: present force on the tip (3,) [N], assumed constant.
        pointing: direction to turn to during the motion; None: the direction is not controlled.
    """
    offset = target - tip
    distance = float(np.linalg.norm(offset))
    if not distance <= MAX_DISTANCE_M:
        return TargetMotion(None, 0.0, f"{1e3 * distance:.0f} mm away, more than {1e3 * MAX_DISTANCE_M:.0f} mm")
    shortest = max(MIN_DURATION_S, distance / MEAN_SPEED_M_S)
    if pointing is not None:
        shortest = max(
            shortest, float(np.linalg.norm(shortest_rotation(pointing.now, pointing.desired))) / MEAN_TURN_RAD_S
        )
    reason = ""
    for slower in SLOWER_FACTORS:
        time = slower * shortest
        end = math.ceil(10.0 * time) / 10.0
        directions = () if pointing is None else ((0.0, *pointing.now.tolist()), (end, *pointing.desired.tolist()))
        try:
            motion = WaypointsMotion(points=((end, *offset.tolist()),), directions=directions)
            check_reach(
                statics, limits, joints, motion.trajectory(), time + 0.5, lambda _: force,
                POSITION_ONLY if pointing is None else pointing.aim, directions_of(motion.directions),
            )  # fmt: skip
        except (CtrError, ValueError) as error:
            reason = str(error)
            continue
        return TargetMotion(motion, time + HOLD_TIME_S, "")
    return TargetMotion(None, 0.0, reason)


class TargetCheck:
    """The last plan of a motion to the target.

    Planning takes up to a second on a busy computer, and every open page requests the result twice a second.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._state: tuple[Array, ...] = ()
        self._plan = TargetMotion(None, 0.0, "")
        self._planned_at = -math.inf

    def plan(self, state: tuple[Array, ...], planned: Callable[[], TargetMotion]) -> TargetMotion:
        """Return the last plan while it is valid, otherwise a new one.

        Args:
            state: position of the target (3,) [m], its direction (3,), joints (n,) [rad or m] and force (3,) [N].
            planned: returns a new plan; this class calls it at most once at a time.
        """
        with self._lock:
            same = [
                float(np.abs(new - old).max()) < tolerance
                for new, old, tolerance in zip(state, self._state, TOLERANCES, strict=False)
            ]
            recent = time.monotonic() - self._planned_at < MIN_PERIOD_S
            if not same or not all(same[:2]) or not (recent or all(same)):
                self._state = state
                self._plan, self._planned_at = planned(), time.monotonic()
            return self._plan
