"""Targets, hands and the cloud of reachable tips, on the model."""

import numpy as np
import pytest
import viser
from viser.transforms import SO3

from core.control.pointing import aim, turn
from core.model.statics import Statics
from core.robot.robot import Array
from station.config.motions import directions_of
from station.config.robots import RobotFile, load_robot, start_pose
from web.scene.gizmos import LOWER, MOST_FORCE, TARGET, TARGET_SIZE, UPPER, Gizmo, along, boxes, pull
from web.scene.scene import ARROW, UNIT
from web.scene.target import STAY, TURN, Pointing, Way, way_to
from web.scene.workspace import reachable_tips

POSE = np.array([0.0, np.pi / 2, -0.1])
NOTHING = np.zeros(3)


@pytest.fixture(scope="module")
def robot() -> RobotFile:
    return load_robot("paper")


@pytest.fixture(scope="module")
def statics(robot: RobotFile) -> Statics:
    return Statics(robot.robot())


def test_a_near_place_is_reached_by_waypoints_that_end_there(robot: RobotFile, statics: Statics) -> None:
    tip = statics.solve(POSE, np.zeros(6)).tip
    way = way_to(tip + np.array((0.008, 0.0, -0.004)), statics, robot.limits(), POSE, tip, NOTHING)
    assert way.motion is not None
    time = way.motion.points[-1][0]
    end = way.motion.trajectory().setpoint(time + 1.0).position
    np.testing.assert_allclose(end, (0.008, 0.0, -0.004), atol=1e-12)
    assert way.duration == pytest.approx(time + STAY, abs=0.1)


def test_where_the_joints_are_too_slow_the_way_takes_longer(robot: RobotFile, statics: Statics) -> None:
    tip = statics.solve(POSE, np.zeros(6)).tip
    easy, hard = (
        way_to(tip + np.array(offset), statics, robot.limits(), POSE, tip, NOTHING)
        for offset in ((0.01, 0.0, 0.0), (0.0, 0.01, 0.01))
    )
    assert easy.motion is not None
    assert hard.motion is not None
    assert hard.duration > easy.duration


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.5), (0.2, 0.0, 0.0), (0.0, 0.0, 1e3), (np.nan, 0.0, 0.0)])
def test_a_far_place_is_out_of_reach_with_a_reason(robot: RobotFile, statics: Statics, offset: Array) -> None:
    tip = statics.solve(POSE, np.zeros(6)).tip
    way = way_to(tip + np.array(offset), statics, robot.limits(), POSE, tip, NOTHING)
    assert way.motion is None
    assert way.reason


def test_the_load_that_is_on_counts(robot: RobotFile, statics: Statics) -> None:
    force = np.array([0.3, 0.0, 0.0])
    loaded = statics.solve(POSE, np.concatenate((force, np.zeros(3)))).tip
    assert way_to(loaded, statics, robot.limits(), POSE, loaded, force).motion is not None


def turned_by(angle: float) -> tuple[Way, Array]:
    """The way of six motors to a near place where the tip points by an angle [rad] off, and that direction."""
    robot = load_robot("balanced_pair")
    assert robot.working_pose is not None
    statics, pose = Statics(robot.robot()), start_pose(robot.working_pose, robot)
    at = statics.solve(pose, np.zeros(6))
    now = at.rotation[:, 2]
    told = np.cos(angle) * now + np.sin(angle) * at.rotation[:, 0]
    pointing = Pointing(aim("position_and_direction"), now, told)
    place = at.tip + np.array((0.0, 0.0, -0.002))
    return way_to(place, statics, robot.limits(), pose, at.tip, NOTHING, pointing), told


@pytest.mark.parametrize("angle", [0.15, 0.3])
def test_the_tip_of_six_motors_turns_on_the_way_no_faster_than_it_may(angle: float) -> None:
    way, told = turned_by(angle)
    assert way.motion is not None, way.reason
    directions = directions_of(way.motion.directions)
    assert directions is not None
    end = way.motion.points[-1][0]
    assert end >= angle / TURN
    np.testing.assert_allclose(directions.at(end)[0], told, atol=1e-12)
    rates = [np.linalg.norm(directions.at(time)[1]) for time in np.linspace(0.0, end, 200)]
    assert max(rates) <= TURN * np.pi / 2.0


@pytest.mark.parametrize("angle", [np.pi / 2.0, np.pi])
def test_a_direction_that_the_tip_cannot_point_in_is_out_of_reach_with_a_reason(angle: float) -> None:
    way, _ = turned_by(angle)
    assert way.motion is None
    assert way.reason


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0), (0.48, -0.6, 0.64), (1e-9, 0, -1)])
def test_a_handle_is_turned_until_its_z_axis_is_the_direction(direction: tuple[float, ...]) -> None:
    wanted = np.array(direction, dtype=np.float64)
    matrix = SO3(along(wanted)).as_matrix()
    np.testing.assert_allclose(matrix[:, 2], wanted, atol=1e-8)
    if wanted[2] > -0.9:  # any half turn will do for the opposite one
        np.testing.assert_allclose(SO3(along(wanted)).log(), turn(np.array([0.0, 0.0, 1.0]), wanted), atol=1e-8)


def test_a_handle_has_rings_only_where_the_direction_is_controlled(server: viser.ViserServer) -> None:
    for turns in (False, True):
        gizmo = Gizmo(server.scene, TARGET, UNIT, TARGET_SIZE, turns=turns)
        assert gizmo._handle.disable_rotations == (not turns)
        gizmo.put(np.zeros(3), np.array([0.6, 0.0, 0.8]))
        np.testing.assert_allclose(gizmo.direction, [0.6, 0.0, 0.8])


def test_a_hand_pulls_along_the_arrow_and_not_too_hard() -> None:
    tip = np.array([0.02, -0.04, 0.19])
    np.testing.assert_allclose(pull(tip + ARROW * np.array((0.1, 0.2, 0.0)), tip, ARROW), (0.1, 0.2, 0.0))
    assert np.linalg.norm(pull(tip + np.array((9.0, 0.0, 0.0)), tip, ARROW)) == pytest.approx(MOST_FORCE)
    np.testing.assert_allclose(pull(tip, tip, ARROW), 0.0)


def test_every_reachable_tip_can_be_targeted(robot: RobotFile, statics: Statics) -> None:
    tips = reachable_tips(statics, robot.limits(), 500)
    assert len(tips) > 400
    assert (tips > LOWER).all()
    assert (tips < UPPER).all()
    assert all(box.holds(tuple(UNIT * tip)) for box in boxes(UNIT).values() for tip in tips)
    # The tubes' lengths bound how far a tip can be from the plate.
    assert np.linalg.norm(tips, axis=1).max() < 0.303
