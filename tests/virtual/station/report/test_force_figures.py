"""The figures of a motion that presses show its force, its contact and its stiffness map."""

import re
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from station.report import force_figures, style
from station.report.document import picture
from station.report.page import figures
from station.report.run import RecordedRun, read_run

FORCE = {"trajectory": {"kind": "force", "direction": [1.0, 0.0, 0.0], "force": 0.2}}
TIME = np.arange(40) * 0.1
#: The tip touches the obstacle at 1 s, and then presses with 0.21 N; truly with 0.19 N.
SIZE = np.where(TIME < 1.0 - 1e-9, 0.0, 0.21)


@pytest.fixture(autouse=True)
def settings():
    with matplotlib.rc_context(style.MATPLOTLIB_SETTINGS):
        yield


def pressing_case(synthetic_case, **groups):
    force = {"force_filtered": np.outer(-SIZE, (1.0, 0.0, 0.0)), "force_variance": np.full((40, 3), 1e-6)}
    true = {"force_true": np.outer(-np.minimum(SIZE, 0.19), (1.0, 0.0, 0.0)), "truth_known": np.ones(40)}
    return synthetic_case(file=FORCE, **{**force, **true, **groups})


def test_force_figure_shows_forces_and_contact_with_units(synthetic_case):
    (drawn,) = force_figures.presses(RecordedRun(Path("x"), "own", {}, {}, (pressing_case(synthetic_case),)))
    force, tip = drawn.figure.axes
    lines = {line.get_label(): np.asarray(line.get_ydata()) for line in force.lines}

    assert ("[N]" in force.get_ylabel(), "[mm]" in tip.get_ylabel(), "[s]" in tip.get_xlabel()) == (True, True, True)
    assert lines["desired"] == pytest.approx(0.2)
    assert lines["estimated"] == pytest.approx(SIZE)
    assert lines["true (simulated)"].max() == pytest.approx(0.19)
    (span,) = force.patches
    assert (span.get_x(), span.get_x() + span.get_width()) == pytest.approx((1.0, 3.9))
    assert "First contact at 1.00 s" in drawn.caption
    assert "estimated mean 10.0 mN, RMS 10.0 mN; true mean -10.0 mN, RMS 10.0 mN" in drawn.caption
    assert drawn.figure.legends


def test_force_below_its_standard_deviation_is_no_contact(synthetic_case):
    case = pressing_case(synthetic_case, force_variance=np.full((40, 3), 0.1**2))
    (drawn,) = force_figures.presses(RecordedRun(Path("x"), "own", {}, {}, (case,)))

    assert "No contact was found" in drawn.caption
    assert not drawn.figure.axes[0].patches


def test_force_figure_of_a_bench_has_no_true_force(synthetic_case):
    case = pressing_case(synthetic_case, truth_known=np.zeros(40))
    (drawn,) = force_figures.presses(RecordedRun(Path("x"), "own", {}, {}, (case,)))

    assert "true" not in [line.get_label() for line in drawn.figure.axes[0].lines]
    assert "true" not in drawn.caption + drawn.alt


def test_report_of_a_motion_without_a_press_has_no_figure_of_a_held_force(synthetic_case):
    assert list(force_figures.presses(RecordedRun(Path("x"), "own", {}, {}, (synthetic_case(),)))) == []


def test_stiffness_map_shows_the_numbers_of_the_summary(run_of, palpation, tmp_path):
    run = read_run(run_of("two_places", palpation))
    drawn = {one.name: one for one in figures(run)}["stiffness_two_places"]
    estimated, truth, bar = drawn.figure.axes
    numbers = run.summary["cases"]["two_places"]["palpation"]

    assert (estimated.get_title(), truth.get_title()) == ("estimated", "simulated truth")
    assert numbers["true_stiffness_N_per_m"] == [[200.0, 200.0]]
    assert [text.get_text() for text in truth.texts] == ["200", "200"]
    for text, value in zip(estimated.texts, numbers["stiffness_N_per_m"][0], strict=True):
        assert float(text.get_text()) == pytest.approx(value, abs=1.0)
        assert value == pytest.approx(200.0, rel=0.12)
    assert "[N/m]" in bar.get_ylabel()
    assert all("[mm]" in axes.get_xlabel() + axes.get_ylabel() for axes in (estimated, truth))
    assert re.search(r"2 of 2 places have an estimate", drawn.caption)
    assert "data:image/svg+xml" in picture(drawn, "simulated bench", tmp_path)
    assert (tmp_path / "stiffness_two_places.png").is_file()
