"""The bound of a case, compared with the deflection of the true robot."""

import numpy as np
import pytest

from core.model.cosserat import ExactRod
from station.config.loads import ConstantLoad, ContactLoad, NoLoad, RaisedCosineLoad, TrapezoidLoad
from station.config.motions import CircleMotion, Orders
from station.experiments.best_possible import BoundedCase, bound, cases_to_bound, with_bound
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
