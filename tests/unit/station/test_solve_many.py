"""`solve_many` solves the model at many poses on all processors; `tests.tools.many_rows` checks more poses."""

import numpy as np
import pytest

from core.model import batch
from core.model.statics import Statics
from station.solve_many import solve_many
from tests.measure.batch import random_rows
from tests.tools.many_rows import checked


@pytest.mark.parametrize("near", [False, True])
def test_solutions_of_solve_many_agree_with_the_exact_rod(near):
    result = checked(1000, 20, seed=1, near=near)

    assert (result["rows"], result["failed"], result["sample"], result["wrong"]) == (1000, 0, 20, 0)
    assert 0.0 < result["mean_mm"] < 0.05


@pytest.mark.parametrize("threads", [2, None])
def test_result_of_solve_many_does_not_depend_on_the_number_of_threads(paper_robot, threads):
    model, (joints, wrenches) = Statics(paper_robot), random_rows(batch.CHUNK_ROWS + 20)
    found = solve_many(model, joints, wrenches, threads=threads)

    assert np.array_equal(found.numbers, batch.solve_many(model, joints, wrenches).numbers)
