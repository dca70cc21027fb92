import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import DescriptionError, PoseError
from core.robot import Joint, Robot, Section, Tube

TUBE = Tube("thin", (Section(0.1), Section(0.05, (4.0, 0.0))), 0.04, outer_diameter=1.8e-3, inner_diameter=1.0e-3)
WIDE = replace(TUBE, name="wide", outer_diameter=3.0e-3, inner_diameter=2.0e-3)
TURN = Joint("turn", 0, "rotation")


def test_joint_names_and_units_are_in_the_order_of_the_joints(paper_robot):
    assert paper_robot.joint_names == ("outer_rotation", "inner_rotation", "inner_translation")
    assert [joint.unit for joint in paper_robot.joints] == ["rad", "rad", "m"]


def test_each_joint_moves_its_own_tube_and_a_tube_without_joint_stays_at_the_plate(paper_robot):
    alpha, beta = paper_robot.tube_poses(np.array([0.1, 0.2, -0.3]))

    assert alpha.tolist() == [0.2, 0.1]
    assert beta.tolist() == [-0.3, 0.0]


def test_length_is_the_sum_of_the_sections(paper_robot):
    assert [tube.length for tube in paper_robot.tubes] == pytest.approx([0.303, 0.165])


def test_the_layout_is_the_description_in_numbers(paper_robot):
    layout = paper_robot.layout

    np.testing.assert_allclose(layout.ends, [[0.150, 0.303], [0.012, 0.165]])
    np.testing.assert_allclose(layout.curvatures[:, :, 0], [[0.0, 4.0], [0.0, 4.0]])
    np.testing.assert_allclose(layout.stiffness, [[0.0413, 1.30], [0.0480, 1.30]])
    assert layout.counts.tolist() == [2, 2]
    assert layout.joint_tube.tolist() == [1, 0, 0]
    assert layout.joint_slides.tolist() == [0, 0, 1]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"bending_stiffness": -0.04}, ["'thin'", "bending_stiffness", "-0.04 N m^2", "greater than 0"]),
        ({"bending_stiffness": 0.0}, ["bending_stiffness", "0 N m^2", "greater than 0"]),
        ({"bending_stiffness": math.nan}, ["bending_stiffness", "nan", "finite"]),
        ({"bending_stiffness": math.inf}, ["bending_stiffness", "inf", "finite"]),
        ({"poisson_ratio": 0.6}, ["'thin'", "poisson_ratio", "0.6", "-1 ... 0.5"]),
        ({"poisson_ratio": -1.0}, ["poisson_ratio", "-1", "-1 ... 0.5"]),
        ({"poisson_ratio": math.nan}, ["poisson_ratio", "nan", "-1 ... 0.5"]),
        ({"sections": ()}, ["'thin'", "no sections", "at least one"]),
        ({"sections": (Section(0.1), Section(-0.2))}, ["'thin'", "section 2", "-0.2 m", "greater than 0"]),
        ({"sections": (Section(0.0),)}, ["section 1", "0 m", "greater than 0"]),
        ({"sections": (Section(0.1, (math.nan, 0.0)),)}, ["'thin'", "curvature of section 1", "not finite"]),
        ({"sections": (Section(0.1, (0.0, math.inf)),)}, ["curvature of section 1", "not finite"]),
        ({"outer_diameter": -1.8e-3}, ["'thin'", "outer_diameter", "-0.0018 m", "greater than 0"]),
        ({"inner_diameter": 1.9e-3}, ["'thin'", "inner_diameter", "1.9 mm", "0 ... 1.8 mm"]),
        ({"inner_diameter": -1e-3}, ["inner_diameter", "-1 mm", "0 ... 1.8 mm"]),
        ({"inner_diameter": math.nan}, ["inner_diameter", "nan mm", "0 ... 1.8 mm"]),
    ],
)
def test_an_impossible_tube_is_refused_by_name_value_and_bound(change, words):
    with pytest.raises(DescriptionError) as refused:
        replace(TUBE, **change)

    for word in words:
        assert word in str(refused.value)


@pytest.mark.parametrize(
    ("tubes", "joints", "words"),
    [
        ((), (), ["'bad'", "no tubes", "at least one"]),
        ((WIDE, TUBE), (), ["'wide'", "3 mm", "'thin'", "1 mm"]),
        ((TUBE,), (Joint("far", 1, "rotation"),), ["'far'", "tube 1", "0 ... 0"]),
        ((TUBE,), (Joint("far", -1, "rotation"),), ["'far'", "tube -1", "0 ... 0"]),
        ((TUBE,), (TURN, Joint("again", 0, "rotation")), ["'again'", "rotation of tube 0", "twice"]),
        ((TUBE, WIDE), (TURN, Joint("turn", 1, "rotation")), ["'bad'", "same name"]),
        ((TUBE,), (Joint("odd", 0, "rotate"),), ["'odd'", "'rotate'", "rotation", "translation"]),
    ],
    ids=["no tubes", "does not fit", "no such tube", "negative tube", "moved twice", "name twice", "no such motion"],
)
def test_an_impossible_robot_is_refused_by_name_value_and_bound(tubes, joints, words):
    with pytest.raises(DescriptionError) as refused:
        Robot("bad", tubes, joints)

    for word in words:
        assert word in str(refused.value)


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ([0.0, math.nan, -0.1], ["inner_rotation", "nan", "rad"]),
        ([0.0, 0.0, math.nan], ["inner_translation", "nan", "number of m"]),
        ([math.inf, 0.0, -0.1], ["outer_rotation", "inf", "rad"]),
        ([0.0, 0.0, 0.001], ["'inner'", "1 mm", "'outer'", "0 mm"]),
        ([0.0, 0.0, -0.2], ["'inner'", "ends at 103 mm", "'outer'", "165 mm"]),
        ([0.0, 0.0, -0.138], ["'inner'", "ends at 165 mm", "'outer'", "165 mm"]),
        ([0.0, 0.0, -0.4], ["'inner'", "-97 mm", "165 mm"]),
        ([0.0, 0.0], ["(2,)", "'paper'", "(3,)"]),
        ([[0.0, 0.0, -0.1]], ["(1, 3)", "'paper'", "(3,)"]),
    ],
)
def test_a_pose_in_which_the_tubes_cannot_stand_is_refused_by_name_value_and_bound(paper_robot, joints, words):
    with pytest.raises(PoseError) as refused:
        paper_robot.check_pose(np.array(joints))

    for word in words:
        assert word in str(refused.value)


def test_a_proximal_end_in_front_of_the_plate_or_of_the_next_outer_tube_is_refused(three_tubes):
    poses = {
        "'c'.*5 mm.*the plate": [0.0, -0.03, 0.0, -0.02, 0.0, 0.005],
        "'b'.*-10 mm.*'c'.*-20 mm": [0.0, -0.03, 0.0, -0.01, 0.0, -0.02],
        "'a'.*-10 mm.*'b'.*-20 mm": [0.0, -0.01, 0.0, -0.02, 0.0, -0.01],
    }
    for words, joints in poses.items():
        with pytest.raises(PoseError, match=words):
            three_tubes.check_pose(np.array(joints))


@pytest.mark.parametrize("translation", [0.0, -0.05, -0.1379])
def test_a_pose_within_reach_is_accepted(paper_robot, translation):
    paper_robot.check_pose(np.array([0.0, 0.0, translation]))
