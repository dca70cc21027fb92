"""Curves for a page have few points and keep all peaks of the recording."""

import numpy as np
import pytest

from station.cli.main import main
from station.report.curves import CURVE_BINS, CURVES_FILE, peaks, read_curves
from station.report.run import read_run


def test_a_curve_keeps_the_largest_value_of_every_piece_with_its_time():
    values = np.random.default_rng(0).random(10_001)
    times = 0.002 * np.arange(10_001)
    line = peaks(times, values)

    assert len(line.time) == len(line.value) <= CURVE_BINS
    assert max(line.value) == pytest.approx(values.max(), abs=1e-4)
    assert line.time[int(np.argmax(line.value))] == pytest.approx(times[values.argmax()], abs=1e-3)
    assert list(line.time) == sorted(line.time)
    assert peaks(times[:5], values[:5]).value == pytest.approx(values[:5], abs=1e-4)


def test_every_case_has_a_curve_with_the_largest_error_of_the_summary(short_run, capsys):
    assert main(("curves", str(short_run))) == 0
    assert capsys.readouterr().out.strip() == str(short_run / CURVES_FILE)
    found, run = read_curves(short_run), read_run(short_run)
    assert found is not None
    assert list(found) == ["one", "two"]
    for case in run.cases:
        curve = found[case.name]
        assert (curve.against, curve.counted_from) == ("true", 0.0)
        assert curve.error is not None
        assert max(curve.error.value) == pytest.approx(case.numbers["true_max_distance_mm"], abs=2e-4)
        assert max(curve.force.value) == pytest.approx(case.numbers["force_max_N"], abs=2e-4)


def test_an_invalid_curves_file_is_read_as_none(tmp_path):
    assert read_curves(tmp_path) is None
    for text in ("{", "[]", '{"one": 3}'):
        (tmp_path / CURVES_FILE).write_text(text, encoding="utf-8")
        assert read_curves(tmp_path) is None
