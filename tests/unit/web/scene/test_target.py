"""Targets, handles and reachable tips on the model."""

import numpy as np
import pytest
import viser
from viser.transforms import SO3

from core.control.tip_direction import shortest_rotation, task_selection
from core.model.statics import Statics
from core.robot.robot import Array
from station.config.motions import directions_of
from station.config.robots import RobotFile, load_robot, start_pose
from web.scene.gizmos import (
    LOWER_BOUNDS_M,
    MAX_FORCE_N,
    TARGET_HANDLE,
    TARGET_SIZE_M,
    UPPER_BOUNDS_M,
    Gizmo,
    along,
    boxes,
    handle_force,
)
from web.scene.overlays import reachable_tips
from web.scene.scene import ARROW_SCALE_M_PER_N, UNITS_PER_M
from web.scene.target import (
    HOLD_TIME_S,
    MEAN_TURN_RAD_S,
    DirectionTarget,
    TargetCheck,
    TargetMotion,
    plan_target_motion,
)

POSE = np.array([0.0, np.pi / 2, -0.1])
NOTHING = np.zeros(3)


@pytest.fixture(scope="module")
def robot() -> RobotFile:
    return load_robot("paper")


@pytest.fixture(scope="module")
def statics(robot: RobotFile) -> Statics:
    return Statics(robot.robot())


def test_a_near_target_is_reached_by_waypoints_that_end_there(robot: RobotFile, statics: Statics) -> None:
    tip = statics.solve(POSE, np.zeros(6)).tip
    way = plan_target_motion(tip + np.array((0.008, 0.0, -0.004)), statics, robot.limits(), POSE, tip, NOTHING)
    assert way.motion is not None
    time = way.motion.points[-1][0]
    end = way.motion.trajectory().setpoint(time + 1.0).position
    np.testing.assert_allclose(end, (0.008, 0.0, -0.004), atol=1e-12)
    assert way.duration == pytest.approx(time + HOLD_TIME_S, abs=0.1)


def test_the_motion_to_a_target_takes_longer_where_the_joints_are_too_slow(robot: RobotFile, statics: Statics) -> None:
    tip = statics.solve(POSE, np.zeros(6)).tip
    easy, hard = (
        plan_target_motion(tip + np.array(offset), statics, robot.limits(), POSE, tip, NOTHING)
        for offset in ((0.01, 0.0, 0.0), (0.0, 0.01, 0.01))
    )
    assert easy.motion is not None
    assert hard.motion is not None
    assert hard.duration > easy.duration


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.5), (0.2, 0.0, 0.0), (0.0, 0.0, 1e3), (np.nan, 0.0, 0.0)])
def test_a_far_target_cannot_be_reached_and_has_a_reason(robot: RobotFile, statics: Statics, offset: Array) -> None:
    tip = statics.solve(POSE, np.zeros(6)).tip
    way = plan_target_motion(tip + np.array(offset), statics, robot.limits(), POSE, tip, NOTHING)
    assert way.motion is None
    assert way.reason


def test_the_present_load_counts_for_the_reachability_of_a_target(robot: RobotFile, statics: Statics) -> None:
    force = np.array([0.3, 0.0, 0.0])
    loaded = statics.solve(POSE, np.concatenate((force, np.zeros(3)))).tip
    assert plan_target_motion(loaded, statics, robot.limits(), POSE, loaded, force).motion is not None


def turned_by(angle: float) -> tuple[TargetMotion, Array]:
    """Return the motion of six motors to a near target with a direction turned by an angle [rad], and the direction."""
    robot = load_robot("balanced_pair")
    assert robot.working_pose is not None
    statics, pose = Statics(robot.robot()), start_pose(robot.working_pose, robot)
    at = statics.solve(pose, np.zeros(6))
    now = at.rotation[:, 2]
    told = np.cos(angle) * now + np.sin(angle) * at.rotation[:, 0]
    pointing = DirectionTarget(task_selection("position_and_direction"), now, told)
    place = at.tip + np.array((0.0, 0.0, -0.002))
    return plan_target_motion(place, statics, robot.limits(), pose, at.tip, NOTHING, pointing), told


@pytest.mark.parametrize("angle", [0.15, 0.3])
def test_the_tip_of_a_robot_with_six_motors_turns_within_its_speed_limit(angle: float) -> None:
    way, told = turned_by(angle)
    assert way.motion is not None, way.reason
    directions = directions_of(way.motion.directions)
    assert directions is not None
    end = way.motion.points[-1][0]
    assert end >= angle / MEAN_TURN_RAD_S
    np.testing.assert_allclose(directions.at(end)[0], told, atol=1e-12)
    rates = [np.linalg.norm(directions.at(time)[1]) for time in np.linspace(0.0, end, 200)]
    assert max(rates) <= MEAN_TURN_RAD_S * np.pi / 2.0


@pytest.mark.parametrize("angle", [np.pi / 2.0, np.pi])
def test_an_unreachable_direction_at_a_target_has_a_reason(angle: float) -> None:
    way, _ = turned_by(angle)
    assert way.motion is None
    assert way.reason


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0), (0.48, -0.6, 0.64), (1e-9, 0, -1)])
def test_the_z_axis_of_the_target_handle_is_the_desired_direction(direction: tuple[float, ...]) -> None:
    wanted = np.array(direction, dtype=np.float64)
    matrix = SO3(along(wanted)).as_matrix()
    np.testing.assert_allclose(matrix[:, 2], wanted, atol=1e-8)
    if wanted[2] > -0.9:  # for the opposite direction any half turn is correct
        np.testing.assert_allclose(
            SO3(along(wanted)).log(), shortest_rotation(np.array([0.0, 0.0, 1.0]), wanted), atol=1e-8
        )


def test_the_target_handle_has_rings_only_where_the_direction_is_controlled(server: viser.ViserServer) -> None:
    for turns in (False, True):
        gizmo = Gizmo(server.scene, TARGET_HANDLE, UNITS_PER_M, TARGET_SIZE_M, turns=turns)
        assert gizmo._handle.disable_rotations == (not turns)
        gizmo.put(np.zeros(3), np.array([0.6, 0.0, 0.8]))
        np.testing.assert_allclose(gizmo.direction, [0.6, 0.0, 0.8])


def test_the_force_handle_acts_along_its_arrow_with_bounded_force() -> None:
    tip = np.array([0.02, -0.04, 0.19])
    np.testing.assert_allclose(
        handle_force(tip + ARROW_SCALE_M_PER_N * np.array((0.1, 0.2, 0.0)), tip, ARROW_SCALE_M_PER_N), (0.1, 0.2, 0.0)
    )
    assert np.linalg.norm(handle_force(tip + np.array((9.0, 0.0, 0.0)), tip, ARROW_SCALE_M_PER_N)) == pytest.approx(
        MAX_FORCE_N
    )
    np.testing.assert_allclose(handle_force(tip, tip, ARROW_SCALE_M_PER_N), 0.0)


def test_every_reachable_tip_can_be_targeted(robot: RobotFile, statics: Statics) -> None:
    tips = reachable_tips(statics, robot.limits(), 500)
    assert len(tips) > 400
    assert (tips > LOWER_BOUNDS_M).all()
    assert (tips < UPPER_BOUNDS_M).all()
    assert all(box.contains(tuple(UNITS_PER_M * tip)) for box in boxes(UNITS_PER_M).values() for tip in tips)
    # The tubes' lengths bound how far a tip can be from the plate.
    assert np.linalg.norm(tips, axis=1).max() < 0.303


def test_target_is_checked_again_only_after_a_change() -> None:
    check, plans = TargetCheck(), []

    def planned() -> TargetMotion:
        plans.append(TargetMotion(None, float(len(plans)), ""))
        return plans[-1]

    def asked(target: float = 0.0, joint: float = 0.0, force: float = 0.0) -> TargetMotion:
        along_z = np.array([0.0, 0.0, 1.0])
        return check.plan((np.full(3, target), along_z, np.full(3, joint), np.full(3, force)), planned)

    for _ in range(3):
        assert asked() is plans[0]
    assert asked(force=0.01) is plans[0]  # noise of the force sensors
    assert asked(target=1e-3) is plans[1]
    assert asked(target=1e-3, joint=0.1, force=1.0) is plans[1]  # the tip moves: the last check is still recent
    assert len(plans) == 2


def test_target_is_checked_again_some_time_after_the_tip_has_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("web.scene.target.MIN_PERIOD_S", 0.0)
    check = TargetCheck()
    results = [TargetMotion(None, float(number), "") for number in range(3)]
    following = iter(results)
    states = [(NOTHING, NOTHING, np.full(3, joint), np.full(3, force)) for joint, force in ((0, 0), (0.1, 0), (0.1, 1))]
    assert [check.plan(state, lambda: next(following)) for state in states] == results
    assert check.plan(states[-1], lambda: next(following)) is results[-1]
