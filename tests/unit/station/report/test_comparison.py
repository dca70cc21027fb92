"""The paper's number, ours, their ratio."""

from pathlib import Path
from types import MappingProxyType

import pytest

from station.report.comparison import all_errors, beside_the_paper
from station.report.run import Run

PAPER = {"paper": {"hold": {"max_abs_error_mm": {"x": 2.0, "z": 0.8}}, "turn": {"model_error_mm": {"loaded": 1.4}}}}
ERRORS = {
    "max_abs_error_mm": [1.0, 9.0, 1.2],
    "true_max_abs_error_mm": [0.5, 8.0, 0.4],
    "rms_error_mm": [0.1, 0.2, 0.3],
}


def run(**cases: dict) -> Run:
    return Run(Path("x"), "own", {"cases": cases}, MappingProxyType(PAPER), ())


def test_every_number_of_the_paper_stands_beside_ours():
    rows = list(beside_the_paper(run(hold=ERRORS)))

    assert [(row.quantity, row.paper, row.measured, row.true) for row in rows] == [
        ("largest |E| in x", 2.0, 1.0, 0.5),
        ("largest |E| in z", 0.8, 1.2, 0.4),
    ]
    assert [row.ratio for row in rows] == pytest.approx([0.5, 1.5])


def test_a_distorted_companion_has_rows_of_its_own():
    rows = list(beside_the_paper(run(hold=ERRORS, hold_distorted=ERRORS)))

    assert [row.case for row in rows] == ["hold", "hold", "hold_distorted", "hold_distorted"]


def test_model_errors_stand_beside_the_papers():
    (row,) = beside_the_paper(run(turn={"model_error_mm": {"loaded": 2.8, "unloaded": 13.0}}))

    assert (row.quantity, row.ratio, row.true) == ("mean distance of the loaded model", pytest.approx(2.0), None)


def test_without_a_truth_there_is_none():
    measured = {"max_abs_error_mm": [1.0, 9.0, 1.2]}

    assert [row.true for row in beside_the_paper(run(hold=measured))] == [None, None]
    assert [row.kind for row in all_errors(run(hold=measured))] == ["largest |E|, measured"]


def test_what_did_not_get_far_enough_has_no_numbers():
    assert list(beside_the_paper(run(hold={"completed": False}))) == []
    assert list(all_errors(run(hold={"completed": False}))) == []


def test_all_errors_by_kind():
    assert [(row.kind, row.values) for row in all_errors(run(hold=ERRORS))] == [
        ("largest |E|, measured", (1.0, 9.0, 1.2)),
        ("largest |E|, true", (0.5, 8.0, 0.4)),
        ("RMS E, measured", (0.1, 0.2, 0.3)),
    ]
