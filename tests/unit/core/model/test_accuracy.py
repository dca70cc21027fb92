"""A hundredth of the verification of the model; `station/docs/pages/explanations/solver.md` describes all of it."""

import pytest

from tests.measure.accuracy import cases, cold_starts, derivatives


@pytest.mark.parametrize(("integrator", "mean"), [("paper", 0.05), ("fourth_order", 0.0005)])
def test_cold_starts_always_find_a_correct_solution(integrator, mean):
    done = []
    result = cold_starts(60, seed=1, integrator=integrator, done=done.append)

    assert (result["starts"], result["wrong"], result["failed"]) == (60, 0, 0)
    assert result["accuracy_mm"]["mean"] < mean
    assert result["residual"] <= 1e-9
    assert done == sorted(done)


@pytest.mark.parametrize(("integrator", "largest"), [("paper", 1e-3), ("fourth_order", 2e-5)])
def test_derivatives_and_stability_margin_match_the_exact_rod(integrator, largest):
    result = derivatives(2, seed=1, integrator=integrator)

    assert list(result) == list(cases())
    for robot in result.values():
        assert robot["poses"] == 2
        for what in ("jacobian", "compliance", "stability"):
            assert robot[what]["median"] <= robot[what]["max"] < largest
    for what in ("jacobian", "compliance", "stability"):
        assert result["paper"][what]["max"] < 3e-4
