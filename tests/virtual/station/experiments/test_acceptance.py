"""The first seconds of experiments in the virtual lab meet the required results; `tests/thorough` runs them whole."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from station.experiments.results import summarise
from tests.harness.cases import a_case, a_run


@pytest.fixture(scope="module")
def summary() -> Callable[..., dict[str, Any]]:
    """Return a function that runs a case of a preset with seed 0 and returns its summary."""

    def run(experiment: str, name: str, **changes: Any) -> dict[str, Any]:
        result = summarise(a_run(a_case(experiment, name, **changes)))
        assert result["completed"], result["cause"]
        return result

    return run


def test_fig3_the_inner_loop_compensates_the_load(summary):
    x, y, _ = summary("fig3", "c", duration=6.0)["true_max_abs_error_mm"]

    assert max(x, y) <= 0.1


def test_fig3_the_dual_layer_with_feed_forward_follows_within_a_tenth_of_a_millimetre(summary):
    assert max(summary("fig3", "d_feedforward", duration=6.0)["true_max_abs_error_mm"]) <= 0.1


def test_fig4_the_direct_effect_of_the_load_dominates_the_deflection():
    recording = a_run(a_case("fig4", "deflection", duration=6.0))
    total, delta_1, delta_2 = (
        recording.channels.of(recording.rows, group) for group in ("deflection", "delta_1", "delta_2")
    )
    largest = [np.linalg.norm(part, axis=1).max() for part in (delta_1, delta_2)]

    assert recording.completed
    assert largest[0] > 3.0 * largest[1]
    # Eq. (22): the two integrals together are the deflection, which is the difference of two solved tips.
    assert np.abs(delta_1 + delta_2 - total).max() < 1e-3 * np.abs(total).max()


def test_fig7_the_unloaded_jacobian_alone_does_not_resist_the_weight(summary):
    x, _, _ = summary("fig7", "regulation", duration=11.0)["true_max_abs_error_mm"]

    assert 14.0 <= x <= 16.0  # the paper reports 15.5 mm


def test_fig10_feed_forward_follows_within_half_a_millimetre(summary):
    result = summary("fig10", "feedforward", duration=12.0)  # the load has its maximum at 10 s

    assert max(result["true_max_abs_error_mm"]) <= 0.5
    # Error of the force estimated from the two base sensors, each of which has noise of 0.02 N.
    assert max(result["force_rms_error_N"]) < 0.05
