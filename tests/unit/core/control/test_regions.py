"""Motions of the joints stop in front of a region, and the robot retreats from it only during a motion of the tip."""

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from core.control.controller_settings import Controller
from core.control.reachability import SolvedConfiguration
from core.control.retreat import (
    MAX_BEYOND_M,
    MAX_EXTRA_TIME_S,
    MAX_RETREAT_M_S,
    NO_RETREAT,
    continued_retreat,
    inverse_after_retreat,
    retreat,
    within_acceleration,
)
from core.control.step import Sample, Tick, start_controller, step
from core.control.trajectories import JointMotion, Setpoint
from core.control.velocity_ik import VelocityTask
from core.errors import PoseError
from core.model.backbone import backbone
from core.robot.keep_out import RESERVE_M, KeepOut
from core.robot.regions import Region, mesh
from core.robot.robot import Array
from station.config.controllers import PERIOD_S, ControllerFile
from station.config.regions import SphereRegion
from station.config.robots import load_robot

ROBOT = load_robot("paper")
START = np.array([0.0, 0.5 * np.pi, -0.1])


def controller(offset: tuple[float, float, float], radius: float) -> Controller:
    """Return a controller with a ball at an offset from the tip of the start pose."""
    tip = ControllerFile().controller(ROBOT).statics.solve(START, np.zeros(6)).tip
    ball = SphereRegion(name="ball", centre=tuple((tip + np.array(offset)).tolist()), radius=radius)
    return ControllerFile(strategy="dual_layer", feedback="observer").controller(ROBOT, regions=[ball])


def moved(control: Controller, order: Setpoint | JointMotion | None, seconds: float) -> Tick:
    """Return the last tick of an order to a robot whose joints follow at once and whose tip is that of the model."""
    joints, sent = START.copy(), np.zeros(3)
    at = control.statics.solve(joints, np.zeros(6))
    memory = start_controller(control, Sample(joints, sent, np.zeros((2, 6)), at.tip, 0.0))
    tick = None
    for _ in range(round(seconds / PERIOD_S)):
        at = control.statics.solve(joints, np.zeros(6), at)
        tick = step(control, memory, Sample(joints, sent, np.zeros((2, 6)), at.tip, 0.0), order)
        memory, sent = tick.memory, tick.command
        joints = joints + PERIOD_S * sent
    assert tick is not None
    return tick


def test_a_joint_motion_stops_in_front_of_a_region() -> None:
    """The inner tube slides toward a ball in front of the tip; without the ball it would slide 24 mm."""
    control = controller((0.006, -0.004, 0.012), 0.004)
    tick = moved(control, JointMotion(np.array([0.0, 0.0, 0.008])), 3.0)

    assert np.abs(tick.command).max() < 1e-4
    assert tick.clearance == pytest.approx(RESERVE_M, abs=2e-5)
    assert tick.at_row.any()


def test_a_robot_inside_a_margin_retreats_in_a_motion_and_stays_without_one() -> None:
    control = controller((0.0058, 0.0, 0.0), 0.004)
    (limit,) = control.regions
    assert isinstance(limit, KeepOut)
    before = moved(control, None, PERIOD_S).clearance
    assert -0.5e-3 < before < -0.1e-3

    assert moved(control, None, 1.0).clearance == pytest.approx(before, abs=1e-6)
    assert moved(control, Setpoint(np.zeros(3), np.zeros(3)), 1.5).clearance > -0.03e-3


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_retreat_is_as_fast_as_the_other_limits_allow(share: float) -> None:
    """Another limit, such as the tube order, leaves room for a share of the retreat."""
    control = controller((0.0058, 0.0, 0.0), 0.004)
    context = SolvedConfiguration(control.statics, control.statics.solve(START, np.zeros(6)))
    rows, room = control.limits.rows(context)
    free = retreat(control.limits, context, rows, room)
    assert free is not None
    worst = int(room.argmin())
    assert rows[worst] @ free < -1e-3

    other = -rows[worst]  # a row that the retreat uses
    found = retreat(control.limits, context, np.vstack((rows, other)), np.append(room, -share * (rows[worst] @ free)))
    assert found is not None
    assert rows[worst] @ found == pytest.approx(share * (rows[worst] @ free), abs=1e-9)


def test_a_task_does_not_slow_a_retreat() -> None:
    """The task requests the opposite of the retreat."""
    control = controller((0.0058, 0.0, 0.0), 0.004)
    context = SolvedConfiguration(control.statics, control.statics.solve(START, np.zeros(6)))
    rows, room = control.limits.rows(context)
    free = retreat(control.limits, context, rows, room)
    assert free is not None

    task = VelocityTask(context.jacobian, -5.0 * context.jacobian @ free)
    velocity, *_ = inverse_after_retreat(control.limits, START, task, rows, room, free)
    missed = room == 0.0
    assert missed.any()
    assert (rows[missed] @ velocity < rows[missed] @ free + 1e-9).all()


def test_nothing_retreats_outside_of_the_margin() -> None:
    control = controller((0.0080, 0.0, 0.0), 0.004)
    context = SolvedConfiguration(control.statics, control.statics.solve(START, np.zeros(6)))
    assert retreat(control.limits, context, *control.limits.rows(context)) is None


def test_joints_that_change_their_velocities_reach_them_together() -> None:
    """The second joint changes its velocity six times as much as the first and needs 14 commands."""
    control, sent, desired = controller((0.0, 0.1, 0.0), 0.004), np.array([-0.1, 0.3, 0.0]), np.array([0.0, -0.3, 0.0])
    limits = control.limits
    context = SolvedConfiguration(control.statics, control.statics.solve(START, np.zeros(6)))
    found = within_acceleration(limits, context, sent, desired, 0.025)

    assert found[1] == pytest.approx(0.3 - 0.025 * limits.joints[1].acceleration)
    assert (found[0] + 0.1) / 0.1 == pytest.approx((found[1] - 0.3) / -0.6)
    close = sent + np.array([0.001, -0.002, 0.0001])
    assert np.array_equal(within_acceleration(limits, context, sent, close, 0.025), close)


def test_a_limit_is_not_missed_for_the_acceleration_of_the_joints() -> None:
    """The joints approach the ball faster than its row allows, and stop at once as far as the row requires."""
    control = controller((0.0064, 0.0, 0.0), 0.004)
    context = SolvedConfiguration(control.statics, control.statics.solve(START, np.zeros(6)))
    rows, room = control.limits.rows(context)
    nearest = int(room.argmin())
    sent = 0.3 * np.sign(rows[nearest]) * (1.0, 1.0, 0.0)
    assert rows[nearest] @ sent > 2.0 * room[nearest] > 0.0
    found = within_acceleration(control.limits, context, sent, np.zeros(3), 0.025)

    assert (rows @ found <= room + 1e-12).all()
    assert rows[nearest] @ found == pytest.approx(room[nearest])


def test_a_controller_without_regions_has_the_largest_recorded_clearance() -> None:
    control = ControllerFile().controller(ROBOT)
    assert moved(control, None, PERIOD_S).clearance == 0.1


@pytest.mark.parametrize("depth", [0.0005, 0.002, 0.008])
def test_a_retreat_goes_no_farther_than_its_depth_and_lasts_no_longer(depth: float) -> None:
    """The clearance does not change, as if the region were somewhere else."""
    control = controller((0.0058, 0.0, 0.0), 0.004)
    near = backbone(control.statics, control.statics.solve(START, np.zeros(6)))
    course, reason = NO_RETREAT, ""
    for _ in range(10_000):
        try:
            course = continued_retreat(course, -depth, PERIOD_S, control.regions, near)
        except PoseError as error:
            reason = str(error)
            break
    assert re.match(r"the retreat from the region 'ball' has gone .* jog the joints away", reason)
    assert 0.0 < course.distance <= depth + MAX_BEYOND_M
    assert course.duration <= 2.0 * depth / MAX_RETREAT_M_S + MAX_EXTRA_TIME_S
    assert continued_retreat(course, 0.0, PERIOD_S, control.regions, near) == NO_RETREAT


def test_a_distance_that_jumps_is_an_error_and_not_a_command() -> None:
    """One wall of a box in front of the tip is turned, so the sign of the distance changes where it is the nearest."""
    control = controller((0.0, 0.0, 0.1), 0.004)
    tip = control.statics.solve(START, np.zeros(6)).tip
    boxes = [box(tip + 0.016 * np.eye(3)[0], 0.020), box(tip + 0.016 * np.eye(3)[2], 0.016)]
    boxes[1] = boxes[1][:, ::-1]
    wrong = KeepOut(Region("boxes", "mesh", (), mesh=mesh(np.concatenate(boxes))))
    control = replace(control, limits=replace(control.limits, others=(wrong,)))
    with pytest.raises(PoseError, match=r"the distance of the tubes from the region 'boxes' jumps by .* mm"):
        moved(control, Setpoint(np.array([-0.002, 0.0, 0.0035]), np.zeros(3)), 3.0)


def box(centre: Array, edge: float) -> Array:
    """Return the outward triangles of a cube [m]."""
    return np.asarray(trimesh.creation.box((edge,) * 3).triangles) + centre
