"""Comparison of the paper's numbers with the measured ones."""

from pathlib import Path
from types import MappingProxyType

import pytest

from station.report.facts import all_errors, paper_comparison
from station.report.run import RecordedRun

PAPER = {"paper": {"hold": {"max_abs_error_mm": {"x": 2.0, "z": 0.8}}, "turn": {"model_error_mm": {"loaded": 1.4}}}}
ERRORS = {
    "max_abs_error_mm": [1.0, 9.0, 1.2],
    "true_max_abs_error_mm": [0.5, 8.0, 0.4],
    "rms_error_mm": [0.1, 0.2, 0.3],
}


def run(**cases: dict) -> RecordedRun:
    return RecordedRun(Path("x"), "own", {"cases": cases}, MappingProxyType(PAPER), ())


def test_a_report_compares_every_number_of_the_paper_with_the_measured_one():
    rows = list(paper_comparison(run(hold=ERRORS)))

    assert [(row.quantity, row.paper, row.measured, row.true) for row in rows] == [
        ("largest |E| in x", 2.0, 1.0, 0.5),
        ("largest |E| in z", 0.8, 1.2, 0.4),
    ]
    assert [row.ratio for row in rows] == pytest.approx([0.5, 1.5])


def test_a_case_with_a_distorted_tracker_has_separate_rows_in_the_comparison():
    rows = list(paper_comparison(run(hold=ERRORS, hold_distorted=ERRORS)))

    assert [row.case for row in rows] == ["hold", "hold", "hold_distorted", "hold_distorted"]


def test_a_report_compares_model_errors_with_those_of_the_paper():
    (row,) = paper_comparison(run(turn={"model_error_mm": {"loaded": 2.8, "unloaded": 13.0}}))

    assert (row.quantity, row.ratio, row.true) == ("mean distance of the loaded model", pytest.approx(2.0), None)


def test_a_comparison_without_ground_truth_has_no_true_errors():
    measured = {"max_abs_error_mm": [1.0, 9.0, 1.2]}

    assert [row.true for row in paper_comparison(run(hold=measured))] == [None, None]
    assert [row.kind for row in all_errors(run(hold=measured))] == ["largest |E|, measured"]


def test_an_incomplete_case_without_errors_has_no_rows_in_the_comparison():
    assert list(paper_comparison(run(hold={"completed": False}))) == []
    assert list(all_errors(run(hold={"completed": False}))) == []


def test_a_report_lists_all_tip_errors_by_kind():
    assert [(row.kind, row.values) for row in all_errors(run(hold=ERRORS))] == [
        ("largest |E|, measured", (1.0, 9.0, 1.2)),
        ("largest |E|, true", (0.5, 8.0, 0.4)),
        ("RMS E, measured", (0.1, 0.2, 0.3)),
    ]
