"""One hundredth of the model's verification; `station/docs/pages/explanations/solver.md` has the whole."""

import numpy as np
import pytest

from station.benchmarks.accuracy import cases, cold_starts, cost, derivatives, telescope


@pytest.mark.parametrize(("integrator", "mean"), [("paper", 0.05), ("fourth_order", 0.0005)])
def test_cold_starts_always_find_a_correct_solution(integrator, mean):
    done = []
    result = cold_starts(200, seed=1, integrator=integrator, done=done.append)

    assert (result["starts"], result["wrong"], result["failed"]) == (200, 0, 0)
    assert result["accuracy_mm"]["mean"] < mean
    assert result["residual"] <= 1e-9
    assert done == sorted(done)


@pytest.mark.parametrize(("integrator", "largest"), [("paper", 1e-3), ("fourth_order", 2e-5)])
def test_derivatives_and_stability_margin_match_the_exact_rod(integrator, largest):
    result = derivatives(5, seed=1, integrator=integrator)

    assert list(result) == list(cases())
    for robot in result.values():
        assert robot["poses"] == 5
        for what in ("jacobian", "compliance", "stability"):
            assert robot[what]["median"] <= robot[what]["max"] < largest
    for what in ("jacobian", "compliance", "stability"):
        assert result["paper"][what]["max"] < 3e-4


def test_telescopes_of_one_to_five_tubes_have_valid_poses():
    for count in range(1, 6):
        robot = telescope(count)
        assert len(robot.tubes) == count
        joints = np.array(
            [0.0 if joint.motion == "rotation" else -0.01 * (count - joint.tube) for joint in robot.joints]
        )
        robot.check_pose(joints)


def test_cost_table_has_every_row():
    table = cost(solves=3, max_tubes=3)
    assert [row for row in table if row[0].isdigit()] == [f"{count} tubes" for count in range(1, 4)]
    assert all(cell > 0.0 for row in table.values() for cell in row.values())
