"""The margin of the worst tubes reaches 0 before any tubes within the uncertainty snap, but not much earlier."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import CtrError
from core.model.fold import margin_of_worst_tubes
from core.model.statics import Statics
from core.robot.robot import Array, Joint, Robot, Section, Tube

UNLOADED = np.zeros(6)
UNCERTAINTY = 0.05
#: Step of the rotation [rad], and rest pose of a pair.
STEP_RAD, REST = 0.02, np.array([2.8, 0.0, -0.12, -0.11])


def pair(curvature: float) -> Robot:
    """Return two tubes of equal curvature [1/m], which snap without load if it is above about 7.5."""
    bent = Section(0.12, (curvature, 0.0))
    inner = Tube("inner", (Section(0.15), bent), 0.02, outer_diameter=1e-3, inner_diameter=0.5e-3)
    outer = Tube("outer", (Section(0.13), bent), 0.04, outer_diameter=2e-3, inner_diameter=1.5e-3)
    joints = [Joint(f"{motion} {i}", i, motion) for motion in ("rotation", "translation") for i in range(2)]
    return Robot("pair", (inner, outer), tuple(joints))


def varied(robot: Robot, rng: np.random.Generator) -> Robot:
    tubes = []
    for tube in robot.tubes:
        stiffness, curvature = 1.0 + rng.uniform(-UNCERTAINTY, UNCERTAINTY, 2)
        sections = tuple(replace(s, curvature=tuple(curvature * u for u in s.curvature)) for s in tube.sections)
        tubes.append(replace(tube, sections=sections, bending_stiffness=stiffness * tube.bending_stiffness))
    return replace(robot, tubes=tuple(tubes))


def at_turn(number: int) -> Array:
    return REST + np.array([number * STEP_RAD, 0.0, 0.0, 0.0])


def steps_to_snap(robot: Robot) -> int:
    """Return the number of steps after which the tip jumps."""
    model, number = Statics(robot), 0
    at = model.solve(at_turn(0), UNLOADED)
    while number < 400:
        after = model.solve(at_turn(number + 1), UNLOADED, at)
        if np.linalg.norm(after.tip - at.tip) > 5e-3:
            return number
        at, number = after, number + 1
    raise AssertionError("no snap")


@pytest.mark.parametrize("curvature", [8.0, 9.0, 10.0, 12.0])
def test_the_worst_tubes_snap_before_any_others_and_not_much_earlier(curvature):
    robot, rng = pair(curvature), np.random.default_rng(int(curvature))
    model, number = Statics(robot), 0
    at = model.solve(at_turn(0), UNLOADED)
    while margin_of_worst_tubes(model, at, at.joints, UNCERTAINTY)[1] > 0.0:
        number += 1
        at = model.solve(at_turn(number), UNLOADED, at)

    others = [steps_to_snap(varied(robot, rng)) for _ in range(10)]
    assert number <= min(others)
    assert number > min(others) - 15
    assert steps_to_snap(robot) > number


def test_without_uncertainty_the_margin_ahead_is_that_of_the_model_there():
    model = Statics(pair(9.0))
    at = model.solve(at_turn(0), UNLOADED)

    described, worst = margin_of_worst_tubes(model, at, at_turn(10), 0.0)

    there = model.solve(at_turn(10), UNLOADED, at)
    assert described == pytest.approx(there.stability, rel=1e-6)
    assert worst == pytest.approx(there.stability, rel=1e-6)


def test_tubes_that_cannot_snap_have_no_bound():
    model = Statics(pair(4.0))
    at = model.solve(np.array([math.pi, 0.0, -0.12, -0.11]), UNLOADED)

    assert margin_of_worst_tubes(model, at, at.joints, UNCERTAINTY) == (at.stability, math.inf)


def test_a_load_brings_the_worst_tubes_to_their_snap():
    model = Statics(pair(9.0))
    free = model.solve(at_turn(44), UNLOADED)
    assert margin_of_worst_tubes(model, free, free.joints, UNCERTAINTY)[1] > 0.0
    rng, snapped = np.random.default_rng(0), 0
    for _ in range(20):
        direction, at = rng.normal(size=3), free
        for newton in np.linspace(0.1, 8.0, 80):
            wrench = np.append(newton * direction / np.linalg.norm(direction), np.zeros(3))
            try:
                after = model.solve(at.joints, wrench, at)
            except CtrError:
                break
            if np.linalg.norm(after.tip - at.tip) > 0.02:
                # The tubes as described snap in this step: the worst tubes have done so before.
                snapped += 1
                assert margin_of_worst_tubes(model, at, at.joints, UNCERTAINTY)[1] == 0.0
                break
            at = after
    assert snapped > 3
