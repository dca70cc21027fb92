"""A few poses of the comparison with public robots; `core/README.md` has the errors of the whole comparison."""

import pytest

from tests.measure.public_robots import compare, robots


@pytest.mark.parametrize("name", ["balanced_pair", "pedrosa"])
def test_model_of_a_public_robot_matches_boundary_value_solutions(name):
    found = compare(next(robot for robot in robots() if robot.name == name), 6)

    assert found.refused == 0 < found.retracted
    assert found.tip < 5e-5
    assert max(found.jacobian, found.compliance) < 1e-2
