import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.errors import DescriptionError, PoseError
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from core.robot.robot import Base, Joint, Robot, Section, Tube, unpack

TUBE = Tube("thin", (Section(0.1), Section(0.05, (4.0, 0.0))), 0.04, outer_diameter=1.8e-3, inner_diameter=1.0e-3)
WIDE = replace(TUBE, name="wide", outer_diameter=3.0e-3, inner_diameter=2.0e-3)
LONG = replace(TUBE, name="long", sections=(Section(0.3),))
TURN = Joint("turn", 0, "rotation")


def test_each_joint_moves_its_own_tube_and_a_tube_without_joint_stays_at_the_plate(paper_robot):
    alpha, beta = paper_robot.tube_poses(np.array([0.1, 0.2, -0.3]))

    assert alpha.tolist() == [0.2, 0.1]
    assert beta.tolist() == [-0.3, 0.0]


def test_robot_layout_contains_the_numbers_of_the_description(paper_robot):
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
        ({"sections": (Section(1e6),)}, ["'thin'", "length", "1e+06 m", "5 m", "metres"]),
        ({"sections": (Section(0.001),) * 51}, ["'thin'", "51 sections", "at most 50"]),
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
        ({"translation": 0.01}, ["'thin'", "translation 10 mm", "plate at 0 mm"]),
        ({"translation": math.nan}, ["'thin'", "translation nan mm"]),
        ({"rotation": math.inf}, ["'thin'", "rotation inf rad"]),
        ({"torsional_stiffness": 0.0}, ["'thin'", "torsional_stiffness 0 N m^2"]),
    ],
)
def test_an_invalid_tube_is_refused_by_name_value_and_bound(change, words):
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
        ((TUBE,), (TURN, Joint("again", 0, "rotation")), ["'again'", "rotation of tube 0", "already has a joint"]),
        ((TUBE, WIDE), (TURN, Joint("turn", 1, "rotation")), ["'bad'", "same name"]),
        ((TUBE,), (Joint("odd", 0, "rotate"),), ["'odd'", "'rotate'", "rotation", "translation"]),
        ((TUBE,) * 9, (), ["'bad'", "9 tubes", "at most 8"]),
        ((replace(TUBE, translation=-0.16),), (), ["'thin'", "ends at -10 mm", "the plate at 0 mm"]),
        ((LONG, replace(WIDE, translation=-0.01)), (), ["'long'", "starts at 0 mm", "'wide' at -10 mm"]),
    ],
)
def test_an_invalid_robot_is_refused_by_name_value_and_bound(tubes, joints, words):
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
        ([0.0, 0.0, -0.4], ["'inner'", "-97 mm", "the plate at 0 mm"]),
        ([0.0, 0.0], ["(2,)", "'paper'", "(3,)"]),
        ([[0.0, 0.0, -0.1]], ["(1, 3)", "'paper'", "(3,)"]),
    ],
)
def test_an_invalid_pose_is_refused_by_name_value_and_bound(paper_robot, joints, words):
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


@pytest.mark.parametrize(("straight", "curved"), [(0.1, 0.2), (0.1, 0.7), (0.15, 0.15), (0.3, 0.3), (0.7, 0.1)])
def test_a_tube_may_be_retracted_to_the_plate_whatever_the_rounding_but_not_further(three_tubes, straight, curved):
    outer = replace(three_tubes.tubes[2], sections=(Section(straight), Section(curved, (1.0, 0.0))))
    robot = Robot("one", (outer,), (Joint("slide", 0, "translation"),))
    for start in (-(straight + curved), -round(straight + curved, 6), np.nextafter(-(straight + curved), 0.0)):
        robot.check_pose(np.array([start]))
        with pytest.raises(PoseError, match=r"'c' ends at .* mm, but must not end behind the plate"):
            robot.check_pose(np.array([start - 1e-8]))


@pytest.mark.parametrize("translation", [0.0, -0.05, -0.138, -0.2, -0.303])
def test_a_valid_pose_of_the_robot_is_accepted(paper_robot, translation):
    paper_robot.check_pose(np.array([0.0, 0.0, translation]))


def test_packed_robot_array_unpacks_to_the_robots_layout(paper_robot, three_tubes):
    for robot in (paper_robot, three_tubes, replace(paper_robot, base=Base((1.0, 2.0, 3.0), (0.1, 0.2, 0.3)))):
        for packed, part in zip(unpack(robot.packed), robot.layout, strict=True):
            np.testing.assert_array_equal(packed, part)
            assert packed.dtype == part.dtype


def test_torsional_stiffness_replaces_poissons_ratio():
    assert TUBE.stiffness_ratio == pytest.approx(1.30)
    assert replace(TUBE, torsional_stiffness=0.01).stiffness_ratio == pytest.approx(4.0)


def test_a_tube_without_joints_has_the_pose_of_the_robot_file():
    inner = replace(TUBE, rotation=0.7, translation=-0.02)
    robot = Robot("fixed", (inner, replace(WIDE, rotation=-0.4)), (Joint("slide", 1, "translation"),))

    alpha, beta = robot.tube_poses(np.array([-0.01]))

    assert alpha.tolist() == [0.7, -0.4]
    assert beta.tolist() == [-0.02, -0.01]
    assert not robot.is_valid_pose(np.array([-0.03]))  # in front of the outer tube


class TestBase:
    def test_the_rotation_of_a_base_matches_its_vector(self):
        vector = np.array([0.4, -1.2, 0.7])
        expected = Rotation.from_rotvec(vector).as_matrix()
        np.testing.assert_allclose(Base((0.0, 0.0, 0.0), tuple(vector)).rotation, expected, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(Base().rotation, np.eye(3))

    @pytest.mark.parametrize("bad", [(0.0, math.nan, 0.0), (0.0, 0.0)])
    def test_an_invalid_base_is_refused(self, bad):
        with pytest.raises(DescriptionError, match=r"base: position .* three finite numbers"):
            Base(position=bad)
        with pytest.raises(DescriptionError, match=r"base: rotation_vector .* three finite numbers"):
            Base(rotation_vector=bad)

    @pytest.mark.parametrize("solver", [Statics, ExactRod])
    def test_moving_the_robots_base_and_load_together_moves_tip_and_derivatives(self, paper_robot, poses, solver):
        vector, position = (0.4, -1.2, 0.7), np.array([0.1, -0.2, 0.3])
        turn = Rotation.from_rotvec(vector).as_matrix()
        both = np.kron(np.eye(2), turn)
        moved = solver(replace(paper_robot, base=Base(tuple(position), vector)))
        for joints, wrench in poses(seed=51, count=3, force=0.5, moment=0.02):
            here, there = solver(paper_robot).solve(joints, wrench), moved.solve(joints, both @ wrench)
            np.testing.assert_allclose(there.tip, turn @ here.tip + position, rtol=0, atol=1e-9)
            np.testing.assert_allclose(there.rotation, turn @ here.rotation, rtol=0, atol=1e-8)
            if solver is Statics:
                np.testing.assert_allclose(there.jacobian, both @ here.jacobian, rtol=0, atol=1e-6)
                np.testing.assert_allclose(there.compliance, both @ here.compliance @ both.T, rtol=0, atol=1e-6)
                assert there.stability == pytest.approx(here.stability, abs=1e-9)
                shape = moved.shape(there)
                np.testing.assert_allclose(shape[0, 10:13], position, rtol=0, atol=1e-15)
                np.testing.assert_allclose(shape[-1, 10:13], there.tip, rtol=0, atol=1e-9)
