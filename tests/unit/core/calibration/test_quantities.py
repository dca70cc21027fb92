"""Calibrated parameters of a robot, and the robot with changed parameters."""

import math

import numpy as np
import pytest

from core.calibration.quantities import Quantity, quantities, with_changes
from core.errors import DescriptionError
from core.model.statics import Statics
from core.robot.robot import Section


def test_quantities_to_find_are_listed(paper_robot, three_tubes):
    names = [quantity.parameter(paper_robot).name for quantity in quantities(paper_robot)]

    assert names == [
        "inner bending_stiffness", "inner curvature", "inner poisson_ratio", "inner straight_length",
        "inner zero_angle",
        "outer bending_stiffness", "outer curvature", "outer poisson_ratio", "outer end",
    ]  # fmt: skip
    for kind in ("zero_angle", "straight_length"):
        assert [quantity.tube for quantity in quantities(three_tubes) if quantity.kind == kind] == [0, 1]


def test_each_calibrated_quantity_changes_only_its_own_tube_parameter(paper_robot):
    what = quantities(paper_robot)
    inner, outer = with_changes(paper_robot, what, np.array([0.1, -0.2, 0.05, 1e-3, 0.3, -0.1, 0.2, -0.1, -5e-3])).tubes

    assert inner.bending_stiffness == pytest.approx(1.1 * 0.0413)
    assert inner.poisson_ratio == pytest.approx(0.35)
    assert inner.sections[0].length == pytest.approx(0.151)
    assert math.hypot(*inner.sections[1].curvature) == pytest.approx(0.8 * 4.0)
    assert math.atan2(*inner.sections[1].curvature[::-1]) == pytest.approx(0.3)
    assert outer.bending_stiffness == pytest.approx(0.9 * 0.0480)
    assert outer.sections[1].curvature == pytest.approx((4.8, 0.0))
    assert [section.length for section in outer.sections] == pytest.approx([0.012, 0.148])


def test_a_zero_angle_is_equivalent_to_a_rotation_of_the_stage(paper_robot):
    """A tube that is curved in another direction has the described pose at another angle of the stage."""
    joints, wrench = np.array([0.4, 1.1, -0.08]), np.array([0.2, 0.1, -0.1, 0.0, 0.0, 0.0])
    turned = with_changes(paper_robot, [Quantity(0, "zero_angle")], np.array([0.25]))

    found = Statics(turned).solve(joints, wrench).tip

    np.testing.assert_allclose(
        found, Statics(paper_robot).solve(joints + np.array([0.0, 0.25, 0.0]), wrench).tip, atol=1e-9
    )


def test_longer_straight_parts_of_all_tubes_are_equivalent_to_a_shift_along_z(paper_robot):
    """This equivalence is the reason why calibration keeps the outermost tube's straight length fixed."""
    joints = np.array([0.4, 1.1, -0.08])
    longer = with_changes(
        paper_robot, [Quantity(0, "straight_length"), Quantity(1, "straight_length")], np.full(2, 1e-3)
    )

    shift = Statics(longer).solve(joints, np.zeros(6)).tip - Statics(paper_robot).solve(joints, np.zeros(6)).tip

    np.testing.assert_allclose(shift, [0.0, 0.0, 1e-3], rtol=0, atol=0.03e-3)


def test_a_straight_length_of_a_tube_without_straight_part_is_refused(one_tube):
    with pytest.raises(DescriptionError, match="no straight part"):
        with_changes(one_tube(Section(0.1, (3.0, 0.0))), [Quantity(0, "straight_length")], np.array([1e-3]))
