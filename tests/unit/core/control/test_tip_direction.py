"""The direction task's rows are compared with the exact rod, and its control is tested."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.control.controller_settings import Controller
from core.control.controllers import Strategy, VelocityMode, strategy
from core.control.estimation import Actuation, Estimator
from core.control.observer import Observer, RateFilter
from core.control.step import restart_setpoints_here
from core.control.tip_direction import POSITION_ONLY, TASKS, TaskSelection, shortest_rotation, task_rows, task_selection
from core.control.trajectories import Setpoint
from core.errors import DescriptionError
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from station.config.robots import load_robot, start_pose
from tests.harness.exact_plant import HERE, PERIOD, ExactPlant, run


@pytest.fixture(scope="module")
def file():
    return load_robot("balanced_pair")


@pytest.fixture(scope="module")
def robot(file):
    return file.robot()


def controller(file, task="position_and_direction", inner="type_2", observes=True):
    estimator = Estimator(RateFilter(PERIOD, 5.0), Observer(PERIOD), Actuation(PERIOD, 0.0, 0.0))
    loops = strategy("dual_layer", 2.5, 2.5, True, inner)
    return Controller(Statics(file.robot()), loops, file.limits(), estimator, observes, aim=task_selection(task))


def plant_of(file) -> ExactPlant:
    return ExactPlant(file.robot(), start_pose(file.working_pose, file))


def errors(unit, plant, seconds, order=lambda _: HERE, force=lambda _: np.zeros(3)):
    """Run a closed loop; return distance [m] and angle [rad] from the pose at rest or from the desired direction."""
    loop, rest = run(unit, plant, seconds, order, force), plant.rest.rotation[:, 2]
    desired = [rest if order.direction is None else order.direction for order in loop.orders]
    turns = [shortest_rotation(rod.rotation[:, 2], axis) for rod, axis in zip(loop.rods, desired, strict=True)]
    return np.column_stack((np.linalg.norm(loop.tips, axis=1), np.linalg.norm(turns, axis=1))), loop.memory


def pull(time: float) -> np.ndarray:
    return 0.15 * (1.0 - math.cos(0.8 * time)) * np.array([0.6, 0.8, 0.0])


def test_direction_rows_match_the_exact_rods_derivatives_at_loaded_poses(file, robot):
    """The derivatives are central differences along a random motion of all joints and a random change of the force."""
    rng, model, exact = np.random.default_rng(7), Statics(robot, integrator="fourth_order"), ExactRod(robot)
    lower, upper, speed = file.limits().packed[:3]
    tried = 0
    while tried < 20:
        joints, force = rng.uniform(lower, upper), rng.normal(size=3)
        if (
            not robot.is_valid_pose(joints)
            or not robot.is_valid_pose(joints + 1e-3 * speed)
            or not robot.is_valid_pose(joints - 1e-3 * speed)
        ):
            continue
        wrench = np.r_[0.3 * rng.uniform() * force / np.linalg.norm(force), np.zeros(3)]
        now = model.solve(joints, wrench)
        if now.stability < 0.1:
            continue
        tried += 1
        here = exact.solve(joints, wrench)
        velocity, load = speed * rng.uniform(-1.0, 1.0, 6), np.r_[rng.normal(size=3), np.zeros(3)]
        across = here.rotation[:, :2]
        for derivative, ends in (
            (now.jacobian @ velocity, [exact.solve(joints + h * velocity, wrench, here) for h in (1e-3, -1e-3)]),
            (now.compliance @ load, [exact.solve(joints, wrench + h * load, here) for h in (1e-3, -1e-3)]),
        ):
            rate = (ends[0].rotation[:, 2] - ends[1].rotation[:, 2]) / 2e-3
            expected = across.T @ np.cross(here.rotation[:, 2], rate)
            rows = task_rows(TaskSelection(0.0, 1.0), derivative[:, None], now.rotation)[:, 0]
            np.testing.assert_allclose(rows, expected, rtol=0, atol=2e-3 * max(0.05, np.linalg.norm(expected)))


@pytest.mark.parametrize(("task", "rows"), [("position", 3), ("position_and_direction", 5), ("direction", 2)])
def test_each_control_task_has_its_number_of_rows(task, rows):
    assert task_selection(task).rows == rows
    assert task_rows(task_selection(task), np.ones((6, 4)), np.eye(3)).shape == (rows, 4)


def test_an_unknown_control_task_is_refused_by_name():
    with pytest.raises(DescriptionError, match="'roll' is unknown; choose one of position, position_and_direction"):
        task_selection("roll")
    assert task_selection("position") == POSITION_ONLY
    assert set(TASKS) == {"position", "position_and_direction", "direction"}


def test_control_task_with_more_rows_than_joints_is_refused(file):
    unit = controller(file)
    with pytest.raises(DescriptionError, match="custom loops control position only"):
        replace(unit, strategy=Strategy(VelocityMode(), lambda u_int, view: (view.loaded.jacobian[:3], u_int)))
    paper = load_robot("paper")
    with pytest.raises(DescriptionError, match="5 coordinates need at least as many joints; the robot has 3"):
        replace(unit, limits=paper.limits())


@pytest.mark.parametrize("inner", ["type_1_exact", "type_2"])
def test_tip_position_and_direction_stay_constant_under_a_varying_load(file, inner):
    """The load deflects the tip by centimetres and degrees; the error that remains is the lag of the rate filter."""
    plant = plant_of(file)
    found, _ = errors(controller(file, inner=inner), plant, 2.5, force=pull)
    bent = plant.rod.solve(start_pose(file.working_pose, file), np.r_[pull(2.5), np.zeros(3)])
    assert np.linalg.norm(shortest_rotation(bent.rotation[:, 2], plant.rest.rotation[:, 2])) > math.radians(2.0)
    assert found[:, 0].max() < 4e-4
    assert found[:, 1].max() < math.radians(0.4)


def test_tip_direction_changes_under_load_when_only_the_position_is_controlled(file):
    found, memory = errors(controller(file, "position"), plant_of(file), 2.5, force=pull)
    assert found[:, 0].max() < 4e-4
    assert found[-1, 1] > math.radians(0.7)
    assert memory.direction is None


def test_direction_task_leaves_the_position_free(file):
    found, _ = errors(controller(file, "direction"), plant_of(file), 2.5, force=pull)
    assert found[:, 1].max() < math.radians(0.4)
    assert found[-1, 0] > 1e-3


def test_tip_follows_a_changing_direction_at_constant_position(file):
    plant = plant_of(file)
    axis = np.cross(plant.rest.rotation[:, 2], [0.0, 0.0, 1.0])
    axis /= np.linalg.norm(axis)
    first = plant.rest.rotation[:, 2]

    def order(time: float) -> Setpoint:
        angle = 0.04 * time
        direction = first * math.cos(angle) + np.cross(axis, first) * math.sin(angle)
        return Setpoint(np.zeros(3), np.zeros(3), direction, 0.04 * axis)

    found, memory = errors(controller(file), plant, 2.0, order)
    assert np.linalg.norm(shortest_rotation(first, plant.now.rotation[:, 2])) == pytest.approx(0.08, abs=3e-3)
    assert found[500:, 1].max() < math.radians(0.2)
    assert found[:, 0].max() < 3e-4
    assert shortest_rotation(
        restart_setpoints_here(memory).direction.origin, plant.now.rotation[:, 2]
    ) == pytest.approx(np.zeros(3), abs=3e-3)
