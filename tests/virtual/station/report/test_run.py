"""Reading of a run from its folder."""

import json
import shutil

import numpy as np
import pytest

from station.recording.read import read_case
from station.report import run as run_module
from station.report.run import NoRun, read_run


def test_cases_read_from_a_run_have_their_order_and_their_recorded_channels(short_run):
    run = read_run(short_run)

    assert [case.name for case in run.cases] == ["one", "two"]
    assert run.experiment == "short"
    assert run.simulated
    for case in run.cases:
        recorded = read_case(short_run / f"{case.name}.mcap")
        assert len(case.rows) == len(recorded.rows) == 750
        for group in ("time", "tip_true", "tip_measured", "force_filtered", "joints", "deflection_rate_exact"):
            assert np.array_equal(case.of(group), recorded.of(group))
    assert run.cases[0].names("joints") == ["outer_rotation", "inner_rotation", "inner_translation"]


def test_a_case_read_from_a_run_has_the_settings_that_it_changes(short_run):
    one, two = read_run(short_run).cases

    assert one.counted_from == two.counted_from == 0.0  # the load acts from the start on, so errors count from 0 s
    assert "controller" not in one.file
    assert two.file["controller"] == {"feedforward": True}


def test_measured_errors_use_the_setpoint_at_the_time_of_the_frame(synthetic_case):
    # The setpoint moves up at 10 mm/s. Each frame has the setpoint of 50 ms before its row, with 2 mm of error in x.
    times = np.arange(40) * 0.1
    desired = np.outer(0.010 * times, (0.0, 0.0, 1.0))
    measured = np.outer(0.010 * (times - 0.05), (0.0, 0.0, 1.0)) + np.array([0.002, 0.0, 0.0])
    case = synthetic_case(tip_desired=desired, tip_measured=measured, tip_true=desired - np.array([0.0, 0.001, 0.0]))
    at, error = case.measured_error()

    assert at == pytest.approx(times[::2] - 0.05)
    assert error[1:] == pytest.approx(np.tile((-2.0, 0.0, 0.0), (19, 1)), abs=1e-9)
    assert case.true_error() == pytest.approx(np.tile((0.0, 1.0, 0.0), (40, 1)))


def test_a_case_with_a_distorted_tracker_is_compared_with_the_same_numbers_of_the_paper(short_run):
    run = read_run(short_run)

    assert run.paper("one", "max_abs_error_mm") == {"x": 7.9, "z": 2.0}
    assert run.paper("one_distorted", "max_abs_error_mm") == {"x": 7.9, "z": 2.0}
    assert run.paper("two", "max_abs_error_mm") == {}


def test_a_very_long_recording_is_decimated_for_the_report(short_run, monkeypatch):
    monkeypatch.setattr(run_module, "MAX_ROWS", 300)
    case = read_run(short_run).cases[0]

    assert case.stride == 3
    assert np.array_equal(case.of("tip_true"), read_case(short_run / "one.mcap").of("tip_true")[::3])


def test_a_run_folder_without_a_summary_is_read_from_its_recordings(short_run, tmp_path):
    shutil.copy(short_run / "two.mcap", tmp_path)
    run = read_run(tmp_path)

    assert [case.name for case in run.cases] == ["two"]
    assert run.summary == {}


@pytest.mark.parametrize("text", [None, "", "[1, 2]", "{"])
def test_reading_a_folder_without_a_run_or_with_an_invalid_summary_is_refused(tmp_path, text):
    if text is not None:
        (tmp_path / "summary.json").write_text(text, encoding="utf-8")
    words = r"summary\.json" if text is not None else r"neither a recording \(\.mcap\) nor summary\.json"
    with pytest.raises(NoRun, match=words):
        read_run(tmp_path)


def test_reading_unknown_channels_of_a_case_is_refused_with_their_name(synthetic_case):
    with pytest.raises(NoRun, match="case 'synthetic_case' has no channels 'colour'"):
        synthetic_case().of("colour")


def test_a_run_folder_with_only_a_summary_is_a_run_without_cases(folder_of):
    run = read_run(folder_of({"experiment": "fig7", "cases": {"regulation": {"completed": False, "cause": "x"}}}))

    assert run.cases == ()
    assert run.experiment == "fig7"
    assert json.dumps(run.summary)
