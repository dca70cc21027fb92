"""The best possible error of a case is compared with the deflection of the true robot."""

import math

import numpy as np
import pytest

from core.errors import DescriptionError
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from core.robot.limits import JointLimit, Limits
from core.robot.robot import Joint, Robot, Section, Tube
from station.config.loads import ConstantLoad, ContactLoad, NoLoad, RaisedCosineLoad, TrapezoidLoad
from station.config.motions import CircleMotion, Orders
from station.experiments.best_possible import BoundedCase, LoadCourse, best_path, bound, cases_to_bound, with_bound
from station.experiments.experiment import load_experiment
from station.lab.virtual_bench import virtual_bench
from tests.harness.cases import a_case

STEP = TrapezoidLoad(magnitude=0.5, rise=0.0, start=1.0, stay=10.0)


def bounded(load, duration=6.0, **changes):
    case = a_case("fig8", "regulation", load=load, duration=duration)._replace(**changes)
    return bound(BoundedCase(case, 0), lambda _: None)


def test_the_best_possible_error_under_a_step_load_is_the_deflection_of_the_true_robot():
    """It is the exact rod's deflection at the start pose; at load removal, with other joints, nearly the same."""
    found = bounded(STEP, 14.0)
    case = a_case("fig8", "regulation")
    rod = ExactRod(virtual_bench(case.robot, case.lab, 0, case.start).lab.true_robot)
    loaded, rest = (rod.solve(case.start, np.array([pull, 0.0, 0.0, 0.0, 0.0, 0.0])).tip for pull in (0.5, 0.0))

    assert list(found) == ["1 s", "11 s"]
    assert found["1 s"] == pytest.approx(1e3 * np.linalg.norm(loaded - rest), rel=3e-4)
    assert found["11 s"] == pytest.approx(found["1 s"], rel=0.2)


def test_the_best_possible_joint_path_does_not_anticipate_the_removal_of_the_load():
    lifted = bounded(STEP.model_copy(update={"rise": 1.5}), 16.0)
    for_ever = bounded(STEP.model_copy(update={"rise": 1.5, "stay": None}), 12.5)

    assert lifted["1 s"] == pytest.approx(for_ever["1 s"], rel=5e-3)
    assert lifted["1 s"] < 1.5 < 10.0 < lifted["12.5 s"]


def test_the_best_possible_error_under_a_slow_load_is_nearly_zero():
    assert bounded(RaisedCosineLoad(peak=0.5, period=20.0), 10.0)["0 s"] < 0.05


def test_a_best_possible_error_is_computed_for_a_moving_tip(paper_robot):
    motion = CircleMotion(radius=0.005, period=20.0)
    load = TrapezoidLoad(magnitude=0.3, rise=8.0, start=1.0)
    assert bounded(load, 10.0, orders=Orders(motion, paper_robot))["1 s"] < 0.1


def test_a_load_without_a_model_solution_has_no_best_possible_error():
    assert bounded(ConstantLoad.model_construct(magnitude=1000.0), 2.0) == {"0 s": None}


def test_each_load_has_one_best_possible_error_when_a_load_of_the_experiment_is_too_fast(write, short):
    text = short + '[controller]\nstrategy = "dual_layer"\n[load]\nkind = "trapezoid"\nmagnitude = 0.5\n'
    slow = "[cross.load]\nslow = { load = { rise = 60.0 } }\n"
    fast = "fast = { load = { rise = 0.1 } }\n"
    strategies = '[cross.strategy]\na = {}\nb = { controller = { inner = "type_2" } }\n'
    alone, both = (load_experiment(str(write(text + slow + more + strategies))).cases for more in ("", fast))

    assert cases_to_bound(alone, 0) == {}
    assert [about.case.name for about in cases_to_bound(both, 0).values()] == ["slow-b", "fast-b"]


@pytest.mark.parametrize("load", [NoLoad(), ContactLoad(magnitude=0.3, place=0.1)])
def test_a_case_without_a_load_at_the_tip_has_no_best_possible_error(load):
    fast, other = (a_case("fig8", "regulation", load=each) for each in (STEP, load))
    assert len(cases_to_bound([fast._replace(warnings=("too fast",)), other], 0)) == 1


def test_a_summary_has_the_best_possible_error_of_each_part_and_the_largest_of_them():
    numbers = {"completed": True, "by_change": {"2 s": {"true_max_distance_mm": 3.0}, "9 s": {"x": 1.0}}}
    found = with_bound(numbers, {"2 s": 1.5, "9 s": 2.5})

    assert found["best_possible_mm"] == 2.5
    assert found["by_change"]["2 s"] == {"true_max_distance_mm": 3.0, "best_possible_mm": 1.5}
    assert with_bound(numbers, {}) == numbers
    assert with_bound({"completed": False}, {"2 s": 1.5}) == {"completed": False}


SPEED, ACCELERATION = 0.020, 0.100
#: One straight tube of 0.2 m that turns and slides: its tip moves along z with the translation.
LIMITS = Limits(
    (
        JointLimit("rotation", "rad", -6.0, 6.0, 0.35, 1.75),
        JointLimit("translation", "m", -0.1, -0.01, SPEED, ACCELERATION),
    )
)
START = np.array([0.0, -0.05])
STILL = np.zeros(2)
STIFFNESS = 0.04


@pytest.fixture(scope="module")
def rod() -> Statics:
    tube = Tube("only", (Section(0.2),), STIFFNESS, 0.30)
    joints = Joint("rotation", 0, "rotation"), Joint("translation", 0, "translation")
    return Statics(Robot("one", (tube,), joints), 0.005)


def along_z(rod: Statics, times: np.ndarray, heights: np.ndarray) -> LoadCourse:
    """Return a load course without load; its targets are at `heights` [m] above the start tip along z."""
    tip = rod.solve(START, np.zeros(6)).tip
    return LoadCourse(times, tip + np.outer(heights, (0.0, 0.0, 1.0)), np.zeros((len(times), 3)))


def test_best_path_to_a_target_faster_than_the_joint_has_the_error_of_speed_and_acceleration_bounds(rod):
    times = np.linspace(0.0, 1.0, 101)
    best = best_path(rod, LIMITS, START, STILL, along_z(rod, times, 0.030 * times))

    # Within the time T a joint moves from rest by at most speed T - speed^2 / (2 a).
    reached = SPEED * 1.0 - SPEED**2 / (2.0 * ACCELERATION)
    assert best.largest == pytest.approx(0.030 - reached, rel=2e-3)


def test_best_path_has_an_error_of_half_a_target_jump_before_and_after_it(rod):
    """With enough time the joint is halfway when the target jumps by 8 mm."""
    times = np.linspace(0.0, 2.0, 101)
    best = best_path(rod, LIMITS, START, STILL, along_z(rod, times, np.where(times < 1.0 - 1e-9, 0.0, 0.008)))

    # between the last time before the jump and the first time after the jump the joint moves at top speed
    assert best.largest == pytest.approx(0.5 * (0.008 - SPEED * 0.02), rel=5e-3)


def test_best_path_to_a_target_beyond_the_travel_has_the_remaining_distance_as_error(rod):
    times = np.linspace(0.0, 8.0, 81)
    best = best_path(rod, LIMITS, START, STILL, along_z(rod, times, np.minimum(0.006 * times, 0.045)))

    assert best.largest == pytest.approx(0.045 - 0.040, rel=2e-3)
    assert best.joints[:, 1].max() <= -0.01 + 1e-9


def test_a_step_of_load_deflects_a_cantilever_before_any_joint_can_move(rod):
    """The error at the first time is F L^3 / (3 EI), independent of what follows."""
    times, force, length = np.linspace(0.0, 1.0, 51), 0.05, 0.15
    tip = rod.solve(START, np.zeros(6)).tip
    course = LoadCourse(times, np.tile(tip, (51, 1)), np.tile((force, 0.0, 0.0), (51, 1)))
    best = best_path(rod, LIMITS, START, STILL, course)

    assert best.largest == pytest.approx(force * length**3 / (3.0 * STIFFNESS), rel=2e-3)
    assert best.largest == pytest.approx(np.linalg.norm(best.errors[0]), rel=1e-6)


# ---- the paper's robot

POSE = np.array([0.0, math.pi / 2, -0.1])
TOP = math.radians(20.0)
PAPER = Limits(
    (
        JointLimit("outer_rotation", "rad", -2 * math.pi, 2 * math.pi, TOP, 5 * TOP),
        JointLimit("inner_rotation", "rad", -2 * math.pi, 2 * math.pi, TOP, 5 * TOP),
        JointLimit("inner_translation", "m", -0.130, -0.005, 0.020, 0.100),
    )
)


@pytest.fixture(scope="module")
def model(paper_robot):
    return Statics(paper_robot)


def ramp(model: Statics, rise: float, until: float, moments: int = 101) -> LoadCourse:
    """Return a load course with a constant target; a force of 0.5 N along x rises within `rise` [s]."""
    times = np.linspace(0.0, until, moments)
    pull = 0.5 * np.clip(times / rise, 0.0, 1.0) if rise > 0.0 else np.full(moments, 0.5)
    tip = model.solve(POSE, np.zeros(6)).tip
    return LoadCourse(times, np.tile(tip, (moments, 1)), np.outer(pull, (1.0, 0.0, 0.0)))


def deflection(model: Statics) -> float:
    """Return the deflection of the tip by 0.5 N when the joints do not move [m]."""
    loaded, rest = (model.solve(POSE, np.array([pull, 0.0, 0.0, 0.0, 0.0, 0.0])).tip for pull in (0.5, 0.0))
    return float(np.linalg.norm(loaded - rest))


def test_hindsight_bound_decreases_for_slower_loads(model):
    slow, fast, step = (
        best_path(model, PAPER, POSE, np.zeros(3), ramp(model, rise, max(2.0 * rise, 1.0), 61)).largest
        for rise in (20.0, 0.5, 0.0)
    )

    assert slow < 1e-4 < fast < step
    assert step == pytest.approx(deflection(model), rel=1e-6)


def test_best_path_keeps_the_joint_limits_and_its_errors_match_the_model(model):
    course = ramp(model, 0.7, 2.0)
    best = best_path(model, PAPER, POSE, np.zeros(3), course)
    dt = np.diff(course.times)
    velocity = np.diff(best.joints, axis=0) / dt[:, None]
    acceleration = np.diff(velocity, axis=0) / dt[1:, None]
    _, _, speed, most, _ = PAPER.packed

    assert best.joints[0] == pytest.approx(POSE)
    assert (np.abs(velocity) <= speed * (1.0 + 1e-6)).all()
    assert (np.abs(acceleration) <= most * (1.0 + 1e-4)).all()
    for k in (0, 20, 35, 60, 100):
        tip = model.solve(best.joints[k], np.r_[course.forces[k], np.zeros(3)]).tip
        assert course.targets[k] - tip == pytest.approx(best.errors[k], abs=1e-7)


def test_no_random_path_next_to_the_best_path_is_better(model):
    """Other joint paths within the same speeds have a larger error: the result is a minimum."""
    course = ramp(model, 0.7, 1.4, 71)
    best = best_path(model, PAPER, POSE, np.zeros(3), course)
    _, _, speed, most, _ = PAPER.packed
    rng, dt = np.random.default_rng(3), course.times[1]
    rates = np.diff(best.joints, axis=0) / dt
    for _ in range(12):
        # All joints get a bump that lasts a tenth to a half of the time; a path that violates a limit is not used.
        middle, width = rng.uniform(0.0, 1.0), rng.uniform(0.1, 0.5)
        bump = np.exp(-(((course.times[1:] / 1.4 - middle) / width) ** 2))
        moved = np.clip(rates + 0.2 * np.outer(bump, speed * rng.normal(size=3)), -speed, speed)
        limited, before = [], np.zeros(3)
        for k, each in enumerate(moved):
            step = most * dt * (0.5 if k == 0 else 1.0)
            before = np.clip(each, before - step, before + step)
            limited.append(before)
        joints = np.vstack((POSE, POSE + dt * np.cumsum(limited, axis=0)))
        tips = [model.solve(q, np.r_[f, 0.0, 0.0, 0.0]).tip for q, f in zip(joints, course.forces, strict=True)]
        assert np.linalg.norm(course.targets - tips, axis=1).max() >= best.largest * (1.0 - 5e-3)


@pytest.mark.parametrize("times", [[0.0], [0.0, 0.0], [1.0, 0.5]])
def test_load_course_without_increasing_times_is_refused(model, times):
    with pytest.raises(DescriptionError, match="a course needs at least two increasing times"):
        best_path(model, PAPER, POSE, np.zeros(3), LoadCourse(np.array(times), np.zeros((3, 3)), np.zeros((3, 3))))
