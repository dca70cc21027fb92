"""Errors and force of each case, out of summaries of every kind."""

import pytest

from station.recording.outcome import outcomes

MEASURED = {"max_abs_error_mm": [1.0, 2.0, 2.0], "max_distance_mm": 3.0, "rms_error_mm": [0.3, 0.0, 0.4]}
TRUE = {"true_" + key: value for key, value in MEASURED.items()}


def test_the_truth_is_told_where_it_is_known_and_the_tracker_where_not() -> None:
    found = outcomes({"cases": {"lab": {**TRUE, "max_abs_error_mm": [9, 9, 9], "force_max_N": 0.2}, "bench": MEASURED}})

    assert [(name, case.against) for name, case in found.items()] == [("lab", "true"), ("bench", "measured")]
    for case in found.values():
        assert (case.largest, case.largest_distance) == ((1.0, 2.0, 2.0), 3.0)
        assert (case.rms, case.rms_distance) == ((0.3, 0.0, 0.4), 0.5)
    assert [case.force for case in found.values()] == [0.2, None]


def test_a_case_without_errors_has_no_outcome() -> None:
    assert outcomes({"cases": {"sweep": {"completed": True}, "circle": TRUE}}).keys() == {"circle"}


@pytest.mark.parametrize(
    "spoilt",
    [
        {}, {"cases": None}, {"cases": [1]}, {"cases": {"a": 3}},
        {"cases": {"a": {**TRUE, "true_rms_error_mm": "none"}}},
        {"cases": {"a": {**TRUE, "true_max_distance_mm": None}}},
        {"cases": {"a": {**TRUE, "true_max_abs_error_mm": [1.0, 2.0]}}},
        {"cases": {"a": {**TRUE, "force_max_N": []}}},
    ],
)  # fmt: skip
def test_a_spoilt_summary_has_none(spoilt: dict[str, object]) -> None:
    assert outcomes(spoilt) == {}
