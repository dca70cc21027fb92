"""The sub-links chosen for a robot: the tip error obeys its bound for every robot, and J and C are exact."""

import math

import numpy as np
import pytest

from core.errors import CtrError
from core.model.cosserat import ExactRod, Rod
from core.model.statics import Statics, suitable_integrator, suitable_sublink
from core.robot.robot import Joint, Robot, Section, Tube
from station.config.robots import load_robot

#: Bound of the tip error: the larger of a length [m] and a share of the robot's length beyond the plate.
BOUND_M, BOUND_SHARE = 5e-5, 5e-4
#: Largest relative error of J and C.
DERIVATIVE_ERROR = 1e-3


def random_robot(rng: np.random.Generator, count: int) -> Robot:
    """Return tubes of 50 to 500 mm, with radii of 5 mm to straight, and EI / GJ of 1 to 2.5."""
    tubes: list[Tube] = []
    length = outermost = math.exp(rng.uniform(math.log(0.05), math.log(0.5)))
    stiffness = math.exp(rng.uniform(math.log(1e-3), math.log(0.1)))
    for i in range(count):
        curvature = 0.0 if rng.random() < 0.1 else math.exp(rng.uniform(math.log(0.3), math.log(200.0)))
        turn = math.tau if count == 1 else rng.uniform(0.5, 2.0)
        curved = min(rng.uniform(0.2, 0.9) * length, turn / max(curvature, 1e-9))
        about = rng.uniform(-math.pi, math.pi)
        bend = (curvature * math.cos(about), curvature * math.sin(about))
        tubes.append(
            Tube(
                f"tube {i}",
                (Section(length - curved), Section(curved, bend)),
                stiffness,
                torsional_stiffness=stiffness / rng.uniform(1.0, 2.5),
                outer_diameter=1e-3 + 6e-4 * i,
                inner_diameter=0.5e-3 + 6e-4 * i,
            )
        )
        stiffness *= math.exp(rng.uniform(math.log(0.5), math.log(8.0)))
        length *= rng.uniform(0.5, 0.95)
    assert outermost <= 0.5
    joints = [Joint(f"{motion} {i}", i, motion) for motion in ("rotation", "translation") for i in range(count)]
    return Robot("random", tuple(tubes), tuple(joints))


def random_pose(rng: np.random.Generator, robot: Robot, load: float) -> tuple[np.ndarray, np.ndarray]:
    """Return valid joints, and a force that is `load` times EI / length^2 of the innermost tube."""
    while True:
        starts = np.cumsum([rng.uniform(0.0, 0.15) * tube.length for tube in reversed(robot.tubes)])[::-1]
        joints = np.concatenate((rng.uniform(-math.pi, math.pi, len(robot.tubes)), -starts))
        if robot.is_valid_pose(joints):
            break
    direction = rng.normal(size=3)
    length = robot.tubes[0].length - starts[0]
    force = load * robot.tubes[0].bending_stiffness / length**2
    return joints, np.append(force * direction / np.linalg.norm(direction), np.zeros(3))


def exact_tip(rod: ExactRod, solution, joints: np.ndarray, wrench: np.ndarray) -> np.ndarray:
    """Return the tip of the exact rod on the branch of the solution."""
    q = len(rod.robot.tubes)
    guess = np.concatenate((solution.unknowns[q : q + 2], solution.unknowns[:q]))
    near = Rod(solution.tip, solution.rotation, guess[2:], guess, np.zeros((q + 2, q + 2)), 0)
    return rod.solve(joints, wrench, near).tip


@pytest.mark.parametrize("tubes", [1, 2, 3])
def test_the_tip_error_of_random_robots_is_below_its_bound_under_any_load(tubes):
    rng, checked, errors = np.random.default_rng(tubes), 0, []
    for number in range(60):
        robot = random_robot(rng, tubes)
        joints, wrench = random_pose(rng, robot, load=(0.0, 1.0, 3.0)[number % 3])
        model, steepest = Statics(robot), max(abs(u) for t in robot.tubes for s in t.sections for u in s.curvature)
        try:
            solution = model.solve(joints, wrench)
        except CtrError:
            continue  # a force that the tubes do not hold
        rod = ExactRod(robot, step=min(0.001, 0.1 / max(steepest, 1e-9)))
        error = np.linalg.norm(solution.tip - exact_tip(rod, solution, joints, wrench))
        errors.append(error / max(BOUND_M, BOUND_SHARE * model.shape(solution)[-1, 0]))
        checked += 1
    assert checked > 50
    assert max(errors) < 1.0


def test_j_and_c_of_random_robots_are_those_of_short_sub_links():
    rng, checked = np.random.default_rng(9), 0
    for number in range(45):
        robot = random_robot(rng, 1 + number % 3)
        joints, wrench = random_pose(rng, robot, load=1.0)
        model = Statics(robot)
        fine = Statics(robot, 0.1 * model.step)
        try:
            found = model.solve(joints, wrench)
            expected = fine.solve(joints, wrench, found)
        except CtrError:
            continue
        for name in ("jacobian", "compliance"):
            exact = getattr(expected, name)[:3]
            assert np.abs(getattr(found, name)[:3] - exact).max() < DERIVATIVE_ERROR * np.abs(exact).max()
        checked += 1
    assert checked > 35


@pytest.mark.parametrize("radius", [0.005, 0.010, 0.020, 0.050, 0.25, 3.0])
def test_the_tip_of_one_tube_is_that_of_its_arc(one_tube, radius):
    arc = 0.07
    tip = (
        Statics(one_tube(Section(0.1), Section(arc, (1.0 / radius, 0.0)))).solve(np.array([0.0, -0.1]), np.zeros(6)).tip
    )

    expected = [0.0, radius * (math.cos(arc / radius) - 1.0), radius * math.sin(arc / radius)]
    np.testing.assert_allclose(tip, expected, rtol=0, atol=BOUND_M)


def test_only_a_robot_that_names_it_gets_the_papers_integrator_and_only_if_it_is_accurate(paper_robot, one_tube):
    steep = one_tube(Section(0.1), Section(0.05, (20.0, 0.0)))
    named = Robot("steep", steep.tubes, steep.joints, integrator="paper")

    assert (suitable_integrator(paper_robot), Statics(paper_robot).step) == ("paper", 0.010)
    assert {suitable_integrator(robot) for robot in (steep, named)} == {"fourth_order"}
    assert Statics(named, integrator="paper").used_integrator == "paper"


def test_the_preset_paper_names_its_integrator_and_no_other_preset_does():
    names = ("paper", "nylon", "balanced_pair", "three_tubes", "wpi_kit")
    assert [name for name in names if load_robot(name).robot().integrator == "paper"] == ["paper"]


def test_the_sub_link_changes_smoothly_with_the_tubes(one_tube):
    lengths = [
        suitable_sublink(one_tube(Section(0.1), Section(0.05, (curvature, 0.0))))
        for curvature in np.linspace(10.0, 11.0, 101)
    ]
    assert (np.diff(lengths) < 0.0).all()
    assert np.ptp(np.diff(lengths)) < 0.1 * np.abs(np.diff(lengths)).max()
