"""Figure of the error over the rate of the load, from a summary with known numbers."""

from pathlib import Path

import matplotlib
import numpy as np
import pytest

from station.config.strict import PRESETS, read_toml
from station.report import load_figures, style
from station.report.run import RecordedRun

TABLE = read_toml(PRESETS / "experiments" / "load_rate.toml")


@pytest.fixture(autouse=True)
def settings():
    with matplotlib.rc_context(style.MATPLOTLIB_SETTINGS):
        yield


def summary(value: float) -> dict:
    """Return errors of every case: the best possible is a tenth of `value`; errors double after the second change."""
    cases = {}
    for strategy, factor in (("regulation", 1.0), ("type_1", 2.0), ("held", 15.0)):
        for load in TABLE["cross"]["load"]:
            parts = {"2 s": 1.0} if load in ("rubber_band", "tap") else {"2 s": 1.0, "14 s": 2.0}
            cases[f"{strategy}-{load}"] = {
                "by_change": {
                    name: {"true_max_distance_mm": part * factor * value, "best_possible_mm": part * value / 10.0}
                    for name, part in parts.items()
                }
            }
    return {"cases": cases}


def run(cases: dict) -> RecordedRun:
    return RecordedRun(Path("x"), "load_rate", cases, TABLE, ())


def test_load_results_have_the_rate_and_the_errors_of_each_load():
    tried = {one.name: one for one in load_figures.load_results(run(summary(1.0)))}

    assert tried["ramp_10s"].rate == pytest.approx(0.05)
    assert tried["ramp_0_1s"].rate == pytest.approx(5.0)
    assert tried["step"].rate == np.inf
    assert all(np.isnan(tried[name].rate) for name in ("rubber_band", "lift_and_drop", "tap"))
    assert tried["ramp_1s"].reached["type_1"] == [2.0, 4.0]
    assert tried["ramp_1s"].best == [0.1, 0.2]
    # With stationary joints the error under the load counts for both changes, not the error after the load's removal.
    assert tried["ramp_1s"].reached["held"] == [30.0, 30.0]


def test_the_load_rate_figure_has_a_curve_for_every_strategy_and_the_best_possible_error():
    (drawn,) = load_figures.load_rate(run(summary(1.0)))
    on, off, other = drawn.figure.axes

    assert on.get_ylabel() == "largest true error [mm]"
    assert on.get_xlabel() == off.get_xlabel() == "rate of the load [N/s]"
    assert [line.get_label() for line in on.lines] == [
        "dual layer, the live default", "dual layer, as in the paper", "no joint moves", "best possible",
    ]  # fmt: skip
    for axes, part in ((on, 1.0), (off, 2.0)):
        heights = [float(np.max(line.get_ydata())) for line in axes.lines]
        assert heights == pytest.approx([part, 2.0 * part, 30.0, 0.1 * part])
        assert all(len(line.get_ydata()) == 9 for line in axes.lines)
    assert len(other.patches) == 3 * 4
    assert "rubber band" in drawn.alt
    assert "half a newton" not in drawn.caption


def test_the_load_rate_figure_of_an_aborted_run_shows_its_finished_cases():
    cases = summary(1.0)
    for name in list(cases["cases"]):
        if "step" in name or name.startswith("type_1"):
            del cases["cases"][name]
    (drawn,) = load_figures.load_rate(run(cases))

    assert len(drawn.figure.axes[0].lines) == 3
    assert list(load_figures.load_rate(run({}))) == []
    assert list(load_figures.load_rate(RecordedRun(Path("x"), "load_rate", {}, {}, ()))) == []
