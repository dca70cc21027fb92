"""Which numbers of a robot may be wrong, and the robot with them changed."""

import math

import numpy as np
import pytest

from core.calibration.quantities import Quantity, changed, quantities
from core.errors import DescriptionError
from core.model.statics import Statics


def test_what_can_be_wrong_about_the_papers_robot(paper_robot):
    names = [quantity.parameter(paper_robot).name for quantity in quantities(paper_robot)]

    assert names == [
        "inner bending_stiffness", "inner curvature", "inner poisson_ratio", "inner straight_length",
        "inner zero_angle",
        "outer bending_stiffness", "outer curvature", "outer poisson_ratio", "outer end",
    ]  # fmt: skip


def test_each_change_is_the_one_that_was_asked_for(paper_robot):
    what = quantities(paper_robot)
    inner, outer = changed(paper_robot, what, np.array([0.1, -0.2, 0.05, 1e-3, 0.3, -0.1, 0.2, -0.1, -5e-3])).tubes

    assert inner.bending_stiffness == pytest.approx(1.1 * 0.0413)
    assert inner.poisson_ratio == pytest.approx(0.35)
    assert inner.sections[0].length == pytest.approx(0.151)
    assert math.hypot(*inner.sections[1].curvature) == pytest.approx(0.8 * 4.0)
    assert math.atan2(*inner.sections[1].curvature[::-1]) == pytest.approx(0.3)
    assert outer.bending_stiffness == pytest.approx(0.9 * 0.0480)
    assert outer.sections[1].curvature == pytest.approx((4.8, 0.0))
    assert [section.length for section in outer.sections] == pytest.approx([0.012, 0.148])


def test_a_zero_angle_is_a_turn_of_the_stage(paper_robot):
    """The tube that is curved another way stands like the described one at another reading."""
    joints, wrench = np.array([0.4, 1.1, -0.08]), np.array([0.2, 0.1, -0.1, 0.0, 0.0, 0.0])
    turned = changed(paper_robot, [Quantity(0, "zero_angle")], np.array([0.25]))

    found = Statics(turned).solve(joints, wrench).tip

    np.testing.assert_allclose(
        found, Statics(paper_robot).solve(joints + np.array([0.0, 0.25, 0.0]), wrench).tip, atol=1e-9
    )


def test_straight_parts_of_all_tubes_and_a_shift_along_z_are_one_and_the_same(paper_robot):
    """Why the outermost tube's straight length stays as it is."""
    joints = np.array([0.4, 1.1, -0.08])
    longer = changed(paper_robot, [Quantity(0, "straight_length"), Quantity(1, "straight_length")], np.full(2, 1e-3))

    shift = Statics(longer).solve(joints, np.zeros(6)).tip - Statics(paper_robot).solve(joints, np.zeros(6)).tip

    np.testing.assert_allclose(shift, [0.0, 0.0, 1e-3], rtol=0, atol=0.03e-3)


def test_a_straight_part_that_is_not_there_cannot_be_longer(one_tube):
    from core.robot.robot import Section

    with pytest.raises(DescriptionError, match="no straight part"):
        changed(one_tube(Section(0.1, (3.0, 0.0))), [Quantity(0, "straight_length")], np.array([1e-3]))


def test_three_tubes_have_two_zero_angles_and_two_straight_lengths_to_find(three_tubes):
    found = quantities(three_tubes)

    assert [quantity.tube for quantity in found if quantity.kind == "zero_angle"] == [0, 1]
    assert [quantity.tube for quantity in found if quantity.kind == "straight_length"] == [0, 1]
