"""Batch rows match the single solve, and failed rows state the reason."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from core.errors import DescriptionError, NoSolution, NotFinite, PoseError
from core.model.batch import CHUNK_ROWS, solve_many
from core.model.statics import Statics


@pytest.fixture(scope="module")
def model(paper_robot):
    return Statics(paper_robot)


def rows(drawn):
    joints, wrenches = zip(*drawn, strict=True)
    return np.array(joints), np.array(wrenches)


def wander(count):
    """Return closely spaced poses, and a rotating load."""
    t = np.arange(count)[:, None]
    joints = np.array([0.3, 1.2, -0.08]) + t * np.array([4e-3, -3e-3, 5e-5])
    wrenches = np.hstack((0.3 * np.cos(0.01 * t), 0.3 * np.sin(0.01 * t), np.zeros((count, 4))))
    return joints, wrenches


def same(found, alone):
    """Check that values are equal except for the last digits: code compiled into a loop may round differently."""
    np.testing.assert_allclose(found, alone, rtol=1e-7, atol=1e-11)


@pytest.mark.parametrize(("force", "moment"), [(0.3, 0.01), (6.0, 0.0)])
def test_cold_batch_rows_match_the_single_solve(model, poses, force, moment):
    """The rows include poses that may have more than one shape, because of a large force or a moment."""
    joints, wrenches = rows(poses(3, 40, force, moment))
    found = solve_many(model, joints, wrenches)

    assert found.ok.all()
    for row in range(len(found)):
        alone = model.solve(joints[row], wrenches[row])
        same(found.numbers[row], alone.numbers)
        for part in ("tip", "rotation", "jacobian", "compliance", "stability", "iterations"):
            same(getattr(found, part)[row], getattr(alone, part))
            same(getattr(found.at(row), part), getattr(alone, part))


def test_batches_match_the_single_solve_for_other_tubes_and_integrators(three_tubes, poses):
    other = Statics(three_tubes, integrator="fourth_order")
    random = np.random.default_rng(0)
    joints = np.column_stack([random.uniform(low, low + 0.1 * turn, 20) for low, turn in (
        (-3.0, 60.0), (-0.15, 0.2), (-3.0, 60.0), (-0.08, 0.2), (-3.0, 60.0), (-0.03, 0.2),
    )])  # fmt: skip
    wrenches = np.hstack((random.uniform(-0.1, 0.1, (20, 3)), np.zeros((20, 3))))
    found = solve_many(other, joints, wrenches)

    assert found.ok.all()
    for row in range(20):
        same(found.numbers[row], other.solve(joints[row], wrenches[row]).numbers)


def test_batch_rows_with_along_start_from_the_previous_row_and_chunks_start_cold(model):
    joints, wrenches = wander(CHUNK_ROWS + 30)
    found = solve_many(model, joints, wrenches, along=True)

    near = None
    for row in range(len(found)):
        near = model.solve(joints[row], wrenches[row], near if row % CHUNK_ROWS else None)
        same(found.numbers[row], near.numbers)
    assert np.median(found.iterations) == 1


def test_batch_rows_with_nearby_solutions_match_warm_solves(model):
    joints, wrenches = wander(60)
    start = solve_many(model, joints, wrenches)
    found = solve_many(model, joints + 1e-3, wrenches, near=start)

    for row in range(60):
        alone = model.solve(joints[row] + 1e-3, wrenches[row], start.at(row))
        same(found.numbers[row], alone.numbers)
    assert found.iterations.max() < start.iterations.min()


def test_batch_results_do_not_depend_on_threads(model, poses):
    joints, wrenches = rows(poses(5, 2 * CHUNK_ROWS + 7, 0.6))
    with ThreadPoolExecutor(3) as pool:
        spread = solve_many(model, joints, wrenches, spread=pool.map)

    assert np.array_equal(spread.numbers, solve_many(model, joints, wrenches).numbers)


@pytest.mark.parametrize("along", [False, True])
def test_a_batch_row_without_a_solution_is_marked_and_the_other_rows_are_solved(model, along):
    joints, wrenches = wander(9)
    good = solve_many(model, joints, wrenches)
    joints[1, 2], joints[3, 0], wrenches[5, 1], wrenches[7, 0] = 0.01, math.nan, math.inf, 1e6
    found = solve_many(model, joints, wrenches, along=along)

    assert found.ok.tolist() == [True, False] * 4 + [True]
    assert [type(found.failures[row]) for row in (1, 3, 5, 7)] == [PoseError, PoseError, NotFinite, NoSolution]
    assert np.isnan(found.numbers[~found.ok]).all()
    # A batch row after a failed row starts cold.
    assert np.array_equal(found.numbers[found.ok], good.numbers[found.ok])
    with pytest.raises(PoseError, match="in front of tube"):
        found.at(1)
    following = solve_many(model, *wander(9), near=found)
    assert np.array_equal(following.numbers[~found.ok], good.numbers[~found.ok])


def test_each_batch_row_may_have_a_different_robot(paper_robot):
    inner, outer = paper_robot.tubes
    models = [
        Statics(replace(paper_robot, tubes=(replace(inner, bending_stiffness=stiffness), outer)))
        for stiffness in (0.03, 0.04, 0.05)
    ]
    joints, wrenches = wander(3)
    joints[2, 2] = 0.01
    found = solve_many(models, joints, wrenches)

    assert found.ok.tolist() == [True, True, False]
    for row in range(2):
        same(found.numbers[row], models[row].solve(joints[row], wrenches[row]).numbers)
    for others in (models[:2], [*models[:2], Statics(paper_robot, 0.005)]):
        with pytest.raises(DescriptionError, match="one for each of 3 rows"):
            solve_many(others, joints, wrenches)


def test_an_empty_batch_has_no_solutions(model):
    assert len(solve_many(model, np.empty((0, 3)), np.empty((0, 6)))) == 0


@pytest.mark.parametrize(("joints", "wrenches"), [((4, 2), (4, 6)), ((4, 3), (3, 6)), ((4, 3), (4, 3)), ((3,), (6,))])
def test_batch_arrays_of_wrong_shape_are_refused(model, joints, wrenches):
    with pytest.raises(DescriptionError, match="for 'paper'"):
        solve_many(model, np.zeros(joints), np.zeros(wrenches))


def test_batch_nearby_solutions_of_wrong_shape_are_refused(model):
    joints, wrenches = wander(3)
    with pytest.raises(DescriptionError, match="near has"):
        solve_many(model, joints, wrenches, near=solve_many(model, joints[:2], wrenches[:2]))
