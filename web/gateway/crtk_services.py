"""Services of CRTK, which move nothing: kinematics of the unloaded model, and the operating state."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from core.control.reachability import check_pose
from core.control.tip_direction import task_selection
from core.control.tip_motion import Aim, move_tip
from core.errors import CtrError
from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.recording.drawing import quaternion_of
from station.service.feasibility import DISPLACEMENT_TOLERANCE_M
from web.gateway.cdr import BadMessage, blank
from web.gateway.crtk import direction_of, finite
from web.gateway.ros_types import FORWARD, INVERSE, POSE, STATE_QUERY, RosService

#: Smallest number of joints with which the inverse kinematics also uses the direction of the tip.
DIRECTION_JOINTS = task_selection("position_and_direction").rows


class Service(NamedTuple):
    """A service that the gateway answers."""

    kind: RosService
    answer: Callable[[tuple[Any, ...]], tuple[Any, ...]]  #: returns the response to a request


def services(file: RobotFile, state: Callable[[], tuple[Any, ...]]) -> dict[str, Service]:
    """Return the services of a robot by name; `state` returns the fields of its operating state."""
    model, limits = Statics(file.robot()), file.limits()

    def checked(numbers: list[float]) -> Array:
        if len(numbers) != len(limits.joints):
            raise BadMessage(f"jp has {len(numbers)} numbers; {len(limits.joints)} are needed")
        return np.array(finite("jp", numbers))

    def forward(request: tuple[Any, ...]) -> tuple[Any, ...]:
        try:
            joints = checked(request[0])
            check_pose(model, limits, joints)
            at = model.solve(joints, np.zeros(6))
        except CtrError as error:
            return blank(POSE.layout)[1], False, str(error)
        return (at.tip.tolist(), quaternion_of(at.rotation)), True, ""

    def inverse(request: tuple[Any, ...]) -> tuple[Any, ...]:
        (point, quaternion), numbers = request
        try:
            start = model.solve(checked(numbers), np.zeros(6))
            direction = direction_of(quaternion) if len(numbers) >= DIRECTION_JOINTS else None
            aim = Aim(np.array(finite("cp", point)), DISPLACEMENT_TOLERANCE_M, np.zeros(6), direction)
            at, _, why = move_tip(model, limits, limits.required_order, start, aim)
            if why:
                raise BadMessage(f"no pose near jp has its tip at cp ({why})")
            check_pose(model, limits, at.joints)
        except CtrError as error:
            return (), False, str(error)
        return at.joints, True, "" if direction is not None else "the orientation of cp is not used"

    return {
        "forward_kinematics": Service(FORWARD, forward),
        "inverse_kinematics": Service(INVERSE, inverse),
        "operating_state": Service(STATE_QUERY, lambda _: (state(),)),
    }
