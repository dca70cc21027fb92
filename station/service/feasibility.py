"""Checks before anything moves: whether a case fits the station, and whether the model can follow a motion.

A case for another robot is refused. A case for another lab or calibration runs on the lab and calibration of this
station; a warning before the start, and in the recording, reports the deviation. The path to a joint-space pose is
checked for snaps. If a motion cannot be followed, a slower or smaller motion is suggested.
"""

import bisect
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from core.control.controller_settings import Controller
from core.control.force_control import OVERSHOOT, Press
from core.control.reachability import SolvedConfiguration, check_pose
from core.control.tip_motion import Aim, move_tip
from core.errors import CtrError, DescriptionError, PoseError
from core.model.fold import margin_of_worst_tubes
from core.model.solution import pure_force
from core.model.statics import Solution, Statics
from core.robot.limits import Limits
from core.robot.robot import Array
from station.config.motions import (
    CircleMotion,
    HelixMotion,
    HoldMotion,
    Orders,
    Places,
    SinusoidMotion,
    StepMotion,
    TipMotion,
    WaypointsMotion,
)
from station.config.regions import MeshRegion, RegionFile
from station.config.robots import named_pose
from station.config.strict import ConfigError
from station.config.units import format_quantity
from station.control.task import MotionTask
from station.experiments.experiment import Case
from station.service.runs import StartRequest
from station.service.station_file import Rig


def incompatibility(case: Case, bench: Rig) -> str:
    """Return why this station cannot run a case; empty when it can run it."""
    if case.robot != bench.robot:
        name = bench.robot.name
        other = f"this station has '{name}'" if case.robot.name != name else "this station's robot of this name differs"
        return f"for robot '{case.robot.name}'; {other}: restart it with `ctr-station serve --robot {case.file.robot}`"
    try:
        case.file.controller.check_devices(bench.present)
    except DescriptionError as error:
        return str(error)
    for one in case.file.keep_out:
        if one not in bench.keep_out:
            return _unknown_region(one, bench)
    if case.orders.follow is not None and (missing := missing_target(bench)):
        return missing
    if excessive := excessive_force(case.orders.press, bench):
        return excessive
    if case.file.faults and bench.devices is not None:
        return "its faults need simulated devices, but this station has real devices; run it in a virtual lab"
    return ""


def _unknown_region(region: RegionFile, bench: Rig) -> str:
    """Return why a case's region is not one of this station's regions."""
    if isinstance(region, MeshRegion) and any(one.model_dump() == region.model_dump() for one in bench.keep_out):
        return (
            f"{region.file} of its region '{region.name}' has changed since the start of the station, which still uses"
            " the earlier surface; restart the station to use the present one"
        )
    return f"the station does not know its region '{region.name}'; add the case's `[[keep_out]]` to the station's file"


def missing_target(bench: Rig) -> str:
    """Return why this station cannot follow a target; empty when it can follow one."""
    if bench.can_track_target:
        return ""
    how = "`serve --lab breathing` has one" if bench.devices is None else "name its coil in devices.tracker.target"
    return f"it follows a target, but this station's tracker has no second coil for a target: {how}"


def excessive_force(press: Press | None, bench: Rig) -> str:
    """Return why a desired force would end in HOLD on this station; empty when it is small enough or None."""
    if press is None or press.force <= bench.max_desired_force:
        return ""
    return (
        f"a desired force of {press.force:.3g} N is above {bench.max_desired_force:.3g} N: at the contact the force may"
        f" exceed it by {100 * OVERSHOOT:.0f} %, and the motion ends in HOLD at {bench.max_force:.3g} N"
        f" ({bench.best_known_robot.largest_force().reason})"
    )


def deviations_from_case(case: Case, bench: Rig) -> tuple[str, ...]:
    """Return the differences between a case and this station that do not prevent its run."""
    file, found = case.file, []
    if "lab" in file.model_fields_set and (bench.devices is not None or case.lab != bench.lab):
        found.append(
            f"written for lab '{file.lab}', runs on this station instead: {bench.title};"
            f" `ctr-station run` and `serve --lab {file.lab}` use that lab"
        )
    own = None if bench.calibration is None else bench.calibration.folder
    if file.calibration and (own is None or own.resolve() != Path(file.calibration).resolve()):
        found.append(
            f"written with the calibration {file.calibration}, runs with this station's"
            f" ({'none' if own is None else own}); `serve --calibration {file.calibration}` uses that calibration"
        )
    return tuple(found)


#: Largest distance of a displaced tip from its goal [m], a tenth of the smallest step of the page.
DISPLACEMENT_TOLERANCE_M = 1e-5
#: Interval between two checked poses of a path: longest travel time of a joint at top speed [s].
PATH_STEP_S = 0.1
#: Largest error of the tip position that the Jacobian predicts from one checked pose to the next [m]; a larger error
#: is a snap. The curvature of a valid path causes a tenth of this error.
MAX_TIP_JUMP_M = 2e-3


def goto_working_pose(bench: Rig) -> StartRequest:
    """Return the start request of the motion to the working pose, which also follows homing.

    The robot's file defines the working pose, which leaves room for motions.

    Raises:
        ConfigError: the robot's file has no working pose.
    """
    robot = bench.robot
    if robot.working_pose is None:
        raise ConfigError(
            f"robot '{robot.name}' has no working_pose: add one to its file, all joints by name [rad or m],"
            " or name the joint positions to go to"
        )
    return goto_joints(bench, named_pose(robot.working_pose, robot, "working_pose"), "to the working pose")


def goto_joints(bench: Rig, target: Array, title: str) -> StartRequest:
    """Return the start request of the motion to `target` (n,) [rad or m], without recording, tare or change of load.

    Raises:
        PoseError: the target violates a limit of the robot.
    """
    controller = bench.controlled(bench.controller)
    check_pose(controller.statics, controller.limits, target)
    task = MotionTask(controller, Orders(HoldMotion(), controller.statics.robot), 0.0, target, rests=False)
    return StartRequest(task, title, load=None, recorded=False)


def displaced_joints(bench: Rig, joints: Array, force: Array, offset: Array, field: str = "tip") -> Array:
    """Return joint positions (n,) near `joints` (n,) [rad or m] that displace the model's tip by `offset` (3,) [m].

    `force` (3,) acts on the tip [N]. The joints stay inside their travel and the order of the tubes. An error names the
    request's `field` first.

    Raises:
        ConfigError: the tip cannot go there.
    """
    controller = bench.controlled(bench.controller)
    at = controller.statics.solve(joints, pure_force(force))
    aim = Aim(at.tip + offset, DISPLACEMENT_TOLERANCE_M, at.wrench)
    at, distance, reason = move_tip(controller.statics, controller.limits, controller.limits.required_order, at, aim)
    if reason:
        raise ConfigError(
            f"{field}: the tip cannot move there, it would end {distance:.4f} m away ({reason}); choose a nearer place"
            " or another direction"
        )
    return at.joints


def check_path(bench: Rig, start: StartRequest, joints: Array) -> None:
    """Refuse a path from `joints` (n,) [rad or m] on which the tubes would snap, or which leaves a limit.

    A path that starts outside a limit may lead back inside.

    Raises:
        ConfigError: the path is refused; the text names the part of the path and the reason.
    """
    task, statics = start.task, start.task.controller.statics
    limits, inside = task.controller.limits, False
    assert task.start is not None, "a motion to a pose needs a target"  # noqa: S101
    travel, uncertainty = task.start - joints, bench.margins.uncertainty
    steps = max(1, math.ceil(np.abs(travel / task.controller.limits.speed).max() / PATH_STEP_S))
    at, first = None, math.inf
    for number in range(steps + 1):
        position, before = f"{start.title}: after {100 * number / steps:.0f} % of the path", at
        try:
            at = statics.solve(joints + number / steps * travel, np.zeros(6), before)
            inside = _is_inside(statics, limits, at, required=inside)
        except CtrError as error:
            raise ConfigError(f"{position}: {error}; go there via another pose") from None
        # A snap between two checked poses appears as a large prediction error of the Jacobian.
        jump = 0.0 if before is None else _prediction_error(before, at)
        if jump > MAX_TIP_JUMP_M:
            raise ConfigError(
                f"{position} the tubes would snap (jump of {1e3 * jump:.1f} mm); go there via another pose"
            )
        first = at.stability if before is None else first
        worst = margin_of_worst_tubes(statics, at, at.joints, uncertainty)[1]
        if worst <= 0.0 and at.stability < first:  # a path from a pose near a snap may lead away from it
            raise ConfigError(
                f"{position} tubes that differ by {100 * uncertainty:g} % from the robot's file may snap; go there via"
                " another pose"
            )


def _is_inside(statics: Statics, limits: Limits, at: Solution, *, required: bool) -> bool:
    """Return whether the pose `at` satisfies every limit; raise PoseError if it does not and `required` is set."""
    try:
        limits.check_all(SolvedConfiguration(statics, at))
    except PoseError:
        if required:
            raise
        return False
    return True


def _prediction_error(before: Solution, at: Solution) -> float:
    """Return the distance of the tip from the position that the previous pose's Jacobian predicts [m]."""
    predicted = before.tip + before.jacobian[:3] @ (at.joints - before.joints)
    return float(np.linalg.norm(at.tip - predicted))


#: Factors by which a suggestion changes the duration or the size of a motion; the smallest change is tried first.
SLOWER_FACTORS = (1.25, 1.5, 2.0, 3.0, 5.0)
SMALLER_FACTORS = (0.8, 0.6, 0.4, 0.2)

#: Hint that is shown if no slower or smaller motion is possible.
WORKING_POSE_HINT = "from the robot's working pose there is more room: go there first (tab Jog, or POST /api/goto)"

Change = Callable[[TipMotion, float], tuple[TipMotion, str] | None]


def suggest_motion(
    motion: TipMotion, controller: Controller, joints: Array, duration: float,
    cancelled: Callable[[], bool] = lambda: False,
) -> str:  # fmt: skip
    """Suggest a motion that is possible from `joints` (n,) [rad or m]; empty if no checked motion is possible.

    Args:
        motion: motion that cannot be followed.
        controller: controller with the model and limits for the checks.
        joints: start pose.
        duration: duration of the motion [s]; slower waypoints take longer.
        cancelled: function that returns whether the result is no longer required.

    Raises:
        Cancelled: the result is no longer required.
    """
    for change, factors in ((_slower, SLOWER_FACTORS), (_smaller, SMALLER_FACTORS)):
        for factor in factors:
            changed = change(motion, factor)
            if changed is None:
                break
            other, words = changed
            longer = duration * factor if isinstance(motion, WaypointsMotion) and change is _slower else duration
            try:
                other = type(other).model_validate(other.model_dump())
                Orders(other, controller.statics.robot).check(controller, joints, longer, cancelled=cancelled)
            except (CtrError, ValidationError):
                continue
            return f"{words} would work from here"
    return ""


def _slower(motion: TipMotion, factor: float) -> tuple[TipMotion, str] | None:
    """Return the motion slowed by `factor` and its description; None for a motion without a speed."""
    change: dict[str, Any]
    match motion:
        case CircleMotion():
            change = {"period": _round(motion.period * factor)}
            words = f"a period of {format_quantity(change['period'], 's')}"
        case HelixMotion():
            change = {"turn": _round(motion.turn * factor)}
            words = f"{format_quantity(change['turn'], 's')} for one turn"
        case SinusoidMotion():
            change = {"frequency": _round(motion.frequency / factor)}
            words = f"a frequency of {format_quantity(change['frequency'], 'Hz')}"
        case WaypointsMotion():
            change = {"points": tuple((time * factor, *position) for time, *position in motion.points)}
            words = f"waypoint times multiplied by {factor:g}"
        case _:
            return None
    return motion.model_copy(update=change), words


def _smaller(motion: TipMotion, factor: float) -> tuple[TipMotion, str] | None:
    """Return the motion scaled by `factor` and its description; None for a motion without a size."""
    change: dict[str, Any]
    match motion:
        case CircleMotion():
            change = {"radius": _round(motion.radius * factor)}
            words = f"a radius of {format_quantity(change['radius'], 'm')}"
        case HelixMotion():
            change = {"radius": _round(motion.radius * factor), "pitch": _round(motion.pitch * factor)}
            radius, pitch = (format_quantity(length, "m") for length in change.values())
            words = f"a radius of {radius} and a pitch of {pitch}"
        case SinusoidMotion():
            change = {"amplitude": _round(motion.amplitude * factor)}
            words = f"an amplitude of {format_quantity(change['amplitude'], 'm')}"
        case StepMotion():
            change = {"offset": tuple(_round(factor * value) for value in motion.offset)}
            words = f"an offset of {', '.join(format_quantity(value, 'm') for value in change['offset'])}"
        case WaypointsMotion():
            points = tuple((time, *(factor * value for value in position)) for time, *position in motion.points)
            change, words = {"points": points}, f"waypoint offsets multiplied by {factor:g}"
        case _:
            return None
    return motion.model_copy(update=change), words


def _round(value: float) -> float:
    """Return a value rounded to two significant digits."""
    return float(f"{value:.2g}")


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
