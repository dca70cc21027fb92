"""Many poses on all processors: a small part of `python -m tests.harness.many_rows`."""

import numpy as np
import pytest

from core.model import many
from core.model.statics import Statics
from station.bench.many import random_rows
from station.solve_many import solve_many
from tests.harness.many_rows import checked


@pytest.mark.parametrize("near", [False, True])
def test_no_row_is_wrong_against_the_exact_rod(near):
    result = checked(3000, 60, seed=1, near=near)

    assert (result["rows"], result["failed"], result["sample"], result["wrong"]) == (3000, 0, 60, 0)
    assert 0.0 < result["mean_mm"] < 0.05


@pytest.mark.parametrize("threads", [1, 2, None])
def test_the_number_of_threads_changes_nothing(paper_robot, threads):
    model, (joints, wrenches) = Statics(paper_robot), random_rows(many.CHUNK + 20)
    found = solve_many(model, joints, wrenches, threads=threads)

    assert np.array_equal(found.numbers, many.solve_many(model, joints, wrenches).numbers)
