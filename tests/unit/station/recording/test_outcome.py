"""Errors and force of each case, from valid and invalid summaries."""

import pytest

from station.recording.outcome import case_outcomes

MEASURED = {"max_abs_error_mm": [1.0, 2.0, 2.0], "max_distance_mm": 3.0, "rms_error_mm": [0.3, 0.0, 0.4]}
TRUE = {"true_" + key: value for key, value in MEASURED.items()}


def test_the_outcome_of_a_case_uses_true_errors_if_known_and_tracker_errors_otherwise() -> None:
    found = case_outcomes(
        {"cases": {"lab": {**TRUE, "max_abs_error_mm": [9, 9, 9], "force_max_N": 0.2}, "bench": MEASURED}}
    )

    assert [(name, case.against) for name, case in found.items()] == [("lab", "true"), ("bench", "measured")]
    for case in found.values():
        assert (case.largest, case.largest_distance) == ((1.0, 2.0, 2.0), 3.0)
        assert (case.rms, case.rms_distance) == ((0.3, 0.0, 0.4), 0.5)
    assert [case.force for case in found.values()] == [0.2, None]


def test_a_case_without_errors_has_no_outcome() -> None:
    assert case_outcomes({"cases": {"sweep": {"completed": True}, "circle": TRUE}}).keys() == {"circle"}


@pytest.mark.parametrize(
    "invalid",
    [
        {}, {"cases": None}, {"cases": [1]}, {"cases": {"a": 3}},
        {"cases": {"a": {**TRUE, "true_rms_error_mm": "none"}}},
        {"cases": {"a": {**TRUE, "true_max_distance_mm": None}}},
        {"cases": {"a": {**TRUE, "true_max_abs_error_mm": [1.0, 2.0]}}},
        {"cases": {"a": {**TRUE, "force_max_N": []}}},
    ],
)  # fmt: skip
def test_an_invalid_summary_has_no_outcome(invalid: dict[str, object]) -> None:
    assert case_outcomes(invalid) == {}
