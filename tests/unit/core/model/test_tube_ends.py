"""Tubes whose ends are flush or inside other tubes: the innermost tube's end is the tip, wherever the others end."""

import math
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from core.model.backbone import backbone
from core.model.cosserat import ExactRod, Loads
from core.model.statics import Statics
from core.robot.robot import Joint, Robot, Section, Tube
from tests.harness.boundary_value import Point, boundary_value

WRENCH = np.array([0.06, -0.03, 0.045, 0.003, -0.0015, 0.0012])


def at_ends(robot, rotations, ends):
    """Return the joints at which the tubes have these rotations [rad] and end at these arc lengths [m]."""
    given = {
        "rotation": rotations,
        "translation": [end - tube.length for end, tube in zip(ends, robot.tubes, strict=True)],
    }
    return np.array([given[joint.motion][joint.tube] for joint in robot.joints])


TURNS = {2: [1.9, 0.4], 3: [0.3, 1.2, -0.5]}
ENDS = [(2, (end, 0.165)) for end in (0.02, 0.1, 0.16, 0.165)]
ENDS += [(3, ends) for ends in permutations((0.045, 0.06, 0.085))]
ENDS += [(3, (0.08, 0.08, 0.08)), (3, (0.06, 0.06, 0.08)), (3, (0.06, 0.05, 0.06))]


@pytest.mark.parametrize(("tubes", "ends"), ENDS)
@pytest.mark.parametrize("load", [0.0, 1.0])
def test_tip_derivatives_and_margin_match_an_independent_boundary_value_solution(
    paper_robot, three_tubes, tubes, ends, load
):
    robot = paper_robot if tubes == 2 else three_tubes
    joints, wrench = at_ends(robot, TURNS[tubes], ends), load * WRENCH
    model = Statics(robot, 0.005, "fourth_order")
    found, truth = model.solve(joints, wrench), boundary_value(robot, joints, wrench)

    np.testing.assert_allclose(found.tip, truth.tip, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.rotation, truth.rotation, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.jacobian, truth.jacobian, rtol=0, atol=1e-5 * np.abs(truth.jacobian).max())
    for rows in (slice(0, 3), slice(3, 6)):
        for columns in (slice(0, 3), slice(3, 6)):
            block = truth.compliance[rows, columns]
            np.testing.assert_allclose(found.compliance[rows, columns], block, rtol=0, atol=1e-4 * np.abs(block).max())
    assert found.stability == pytest.approx(truth.margin, rel=1e-4)
    assert model.negative_directions(found) == 0
    np.testing.assert_allclose(ExactRod(robot).solve(joints, wrench).tip, truth.tip, rtol=0, atol=1e-8)


#: Ends of the tubes [m], and arc length of a force on the tubes beyond the tip.
BEYOND = [((0.1, 0.165), 0.13), ((0.1, 0.165), 0.16), ((0.045, 0.06, 0.085), 0.05), ((0.045, 0.06, 0.085), 0.07)]
BEYOND += [((0.06, 0.085, 0.045), 0.08), ((0.002, 0.085, 0.045), 0.06)]
FORCE_STEP_N = 1e-3


@pytest.mark.parametrize(("ends", "arc"), BEYOND)
@pytest.mark.parametrize("moment", [0.0, 1.0])
def test_force_beyond_a_retracted_tip_acts_with_its_own_lever(paper_robot, three_tubes, ends, arc, moment):
    robot = paper_robot if len(ends) == 2 else three_tubes
    joints, force = at_ends(robot, TURNS[len(ends)], ends), WRENCH[:3]
    at_tip = np.append(np.zeros(3), moment * WRENCH[3:])
    model = Statics(robot, 0.005, "fourth_order")
    found = model.solve(joints, np.append(force, at_tip[3:]), contact=arc)
    truth = boundary_value(robot, joints, at_tip, points=[Point(arc, force)])

    np.testing.assert_allclose(found.tip, truth.tip, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.rotation, truth.rotation, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.unknowns, truth.unknowns, rtol=0, atol=1e-5)
    np.testing.assert_allclose(found.jacobian, truth.jacobian, rtol=0, atol=1e-5 * np.abs(truth.jacobian).max())
    turning = truth.compliance[:, 3:]
    np.testing.assert_allclose(found.compliance[:, 3:], turning, rtol=0, atol=1e-4 * np.abs(turning).max())
    for axis, change in enumerate(FORCE_STEP_N * np.eye(3)):
        up, down = (
            boundary_value(robot, joints, at_tip, truth.unknowns, [Point(arc, force + sign * change)]).tip
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(found.compliance[:3, axis], (up - down) / (2.0 * FORCE_STEP_N), rtol=0, atol=1e-6)
    assert found.stability == pytest.approx(truth.margin, rel=1e-4)
    assert model.negative_directions(found) == 0
    exact = ExactRod(robot).solve(joints, np.append(force, at_tip[3:]), contact=arc)
    np.testing.assert_allclose(exact.tip, truth.tip, rtol=0, atol=1e-8)


def test_force_at_the_last_tube_end_is_a_point_load_there(three_tubes):
    ends = (0.045, 0.06, 0.085)
    joints = at_ends(three_tubes, TURNS[3], ends)
    contact = float(three_tubes.tube_ends(joints).max())
    found = Statics(three_tubes, 0.005, "fourth_order").solve(joints, np.append(WRENCH[:3], np.zeros(3)), None, contact)
    point = Loads([(contact, WRENCH[:3])])
    truth = ExactRod(three_tubes).solve(joints, np.zeros(6), loads=point)
    np.testing.assert_allclose(found.tip, truth.tip, rtol=0, atol=1e-8)


@pytest.mark.parametrize("rounding", [-1e-16, 1e-16])
def test_rounding_of_the_joints_does_not_change_flush_tubes(three_tubes, rounding):
    joints, model = at_ends(three_tubes, TURNS[3], (0.08, 0.08, 0.08)), Statics(three_tubes)
    rounded = joints + rounding * np.array([0, 1, 0, -1, 0, 1])
    exact, found = (model.solve(at, WRENCH) for at in (joints, rounded))
    np.testing.assert_allclose(found.jacobian, exact.jacobian, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.tip, exact.tip, rtol=0, atol=1e-12)


def test_fixed_flush_tubes_act_like_one_tube_of_their_mean_curvature():
    """Two equal tubes at a relative angle of 0.6 rad without torsion: each bends as the mean of both precurvatures.

    The tubes are curved along their whole length, so nothing twists where GJ is far above EI.
    """
    bent = Section(0.1, (8.0, 0.0))
    inner = Tube("inner", (bent,), 0.04, -0.999, 1e-3, 0.5e-3, rotation=0.6)
    outer = Tube("outer", (bent,), 0.04, -0.999, 2e-3, 1.2e-3)
    robot = Robot("two", (inner, outer), (Joint("outer_rotation", 1, "rotation"),))
    kappa = 8.0 * math.cos(0.3)
    radius, angle = 1.0 / kappa, 0.1 * kappa
    # A precurvature (1/r, 0) bends toward -y; the mean curvature is rotated by 0.3 rad.
    aside = radius * (1.0 - math.cos(angle))
    tip = [aside * math.sin(0.3), -aside * math.cos(0.3), radius * math.sin(angle)]
    solved = Statics(robot, integrator="fourth_order").solve(np.zeros(1), np.zeros(6))
    np.testing.assert_allclose(solved.tip, tip, rtol=0, atol=3e-6)


@pytest.mark.parametrize("turn", [0.4, 1.5, 3.0])
@pytest.mark.parametrize("bent", [1.0, 6.0])  # with the second factor the tubes snap
def test_without_load_the_part_of_the_outer_tube_beyond_the_tip_does_not_matter(paper_robot, turn, bent):
    """Beyond the tip nothing twists a single outer tube, so that it may as well be cut at the tip."""
    joints = np.array([0.0, turn, 0.1 - 0.303])
    inner, outer = (
        replace(tube, sections=tuple(replace(one, curvature=(bent * one.curvature[0], 0.0)) for one in tube.sections))
        for tube in paper_robot.tubes
    )
    cut = replace(
        outer, sections=(outer.sections[0], Section(0.1 - outer.sections[0].length, outer.sections[1].curvature))
    )
    whole, short = (Statics(replace(paper_robot, tubes=(inner, tube))) for tube in (outer, cut))
    found, expected = whole.solve(joints, np.zeros(6)), short.solve(joints, np.zeros(6))

    np.testing.assert_allclose(found.tip, expected.tip, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.jacobian[:, :2], expected.jacobian[:, :2], rtol=0, atol=1e-9)
    assert found.stability == pytest.approx(expected.stability, abs=1e-6 * abs(expected.stability))
    assert whole.negative_directions(found) == short.negative_directions(expected) == 0


def test_the_tip_does_not_jump_when_tube_ends_pass_each_other(three_tubes):
    model, before = Statics(three_tubes), None
    for inner in np.linspace(0.0902, 0.0198, 177):  # past the ends of both other tubes, also exactly
        near = before
        found = model.solve(at_ends(three_tubes, TURNS[3], (inner, 0.05, 0.07)), WRENCH, near)
        cold = model.solve(at_ends(three_tubes, TURNS[3], (inner, 0.05, 0.07)), WRENCH)
        np.testing.assert_allclose(found.tip, cold.tip, rtol=0, atol=1e-9)
        if before is not None:
            assert np.linalg.norm(found.tip - before.tip) < 1.5 * 0.0704 / 176
        before = found


FLUSH = [ends for ends in np.ndindex(2, 2, 2) if 0 in ends]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rounding", [0.0, 5e-17, -5e-17, 5e-10, -5e-10])
@pytest.mark.parametrize("beyond", FLUSH)
@pytest.mark.parametrize("load", [0.0, 1.0])
def test_a_tube_that_is_flush_with_the_plate_is_as_if_it_were_not_there(three_tubes, beyond, rounding, load):
    ends = np.where(beyond, (0.09, 0.05, 0.07), rounding)
    joints, model = at_ends(three_tubes, TURNS[3], ends), Statics(three_tubes)
    found = model.solve(joints, load * WRENCH)
    rod = ExactRod(three_tubes).solve(joints, load * WRENCH)
    np.testing.assert_allclose(found.tip, rod.tip, rtol=0, atol=1e-6)
    assert model.negative_directions(found) == 0
    points = backbone(model, found)
    for numbers in (found.jacobian, found.compliance, model.shape(found), model.strains(found), *points[:5]):
        assert np.isfinite(numbers).all()
    if not beyond[0]:  # the tip is at the plate, which nothing but the inner tube's stages moves
        np.testing.assert_allclose(found.tip, [0.0, 0.0, ends[0]], rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.jacobian[:3], np.outer([0.0, 0.0, 1.0], [0, 1, 0, 0, 0, 0]), rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.compliance[:3], 0.0, rtol=0, atol=1e-9)
        return
    left = [i for i in range(3) if beyond[i]]
    names = [k for k, joint in enumerate(three_tubes.joints) if joint.tube in left]
    fewer = replace(
        three_tubes, tubes=tuple(three_tubes.tubes[i] for i in left),
        joints=tuple(replace(three_tubes.joints[k], tube=left.index(three_tubes.joints[k].tube)) for k in names),
    )  # fmt: skip
    expected = Statics(fewer, model.step).solve(joints[names], load * WRENCH)
    np.testing.assert_allclose(found.tip, expected.tip, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        found.compliance, expected.compliance, rtol=1e-4, atol=1e-5 * np.abs(expected.compliance).max()
    )
