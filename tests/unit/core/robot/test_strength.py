"""The largest tip force that tubes and sensors withstand."""

from dataclasses import replace

import pytest

from core.robot.strength import LOAD_PART, force_bound
from station.config.robots import load_robot


@pytest.fixture
def paper():
    return load_robot("paper")


def test_the_moment_range_of_the_base_sensors_bounds_the_force_on_the_paper_s_robot(paper):
    robot, joints = paper.robot(), paper.limits().joints
    bound = force_bound(robot, joints)

    # The 0.303 m tube starts at least 5 mm behind the plate; the outer tube has 0.0480 of 0.0893 N m^2 stiffness.
    assert bound.newton == pytest.approx(LOAD_PART * 0.25 / (0.298 * 0.0480 / 0.0893))
    assert bound.reason == "the moment range of a base sensor"
    assert force_bound(robot, joints, (18.0, 0.125)).newton == pytest.approx(0.5 * bound.newton)
    assert force_bound(robot, joints, (0.1, 0.25)).reason == "the force range of a base sensor"


def test_the_strain_of_a_thick_inner_tube_bounds_the_force_before_the_sensors(paper):
    robot = paper.robot()
    inner, outer = robot.tubes
    thick = replace(robot, tubes=(replace(inner, outer_diameter=5e-3), replace(outer, inner_diameter=5e-3,
                                                                               outer_diameter=6e-3)))  # fmt: skip
    bound = force_bound(thick, paper.limits().joints)

    assert bound.reason == "the strain of tube 'inner'"
    assert bound.newton < 0.6


def test_a_robot_without_max_force_has_an_overload_bound_that_limits_no_velocity(paper):
    limits = paper.limits()
    own = paper.model_copy(update={"max_force": 0.4})

    assert limits.overload is not None
    assert limits.overload.newton == pytest.approx(0.94, abs=0.01)
    assert "force" not in str([limit.names for limit in limits.others])
    assert own.limits().overload is None
    assert own.largest_force().newton == 0.4
