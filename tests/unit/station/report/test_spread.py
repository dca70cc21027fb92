"""Page of a sweep with known numbers."""

import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest

from station.report import spread, style
from station.report.page import write_report
from station.report.run import NoRun

GAINS = (1.0, 5.0)
SEEDS = range(5)


def error(gain: float, seed: int) -> list[float]:
    return [2.0 / gain + 0.1 * seed, 0.5, 0.1 * seed]


def group(gain: float) -> dict[str, Any]:
    spreads = {}
    for axis, values in zip("xyz", zip(*(error(gain, seed) for seed in SEEDS), strict=True), strict=True):
        p5, median, p95 = np.percentile(values, (5, 50, 95))
        spreads[f"true_max_abs_error_mm.{axis}"] = {"median": median, "worst": max(values), "p5": p5, "p95": p95}
    return {"setting": {"controller.k1": gain}, "case": "hold", "runs": 5, "completed": 5, "spreads": spreads}


SWEEP = {
    "experiment": "own",
    "title": "hold <it>",
    "labs": ["a lab"],
    "completed": True,
    "wall_s": 1.0,
    "seeds": list(SEEDS),
    "planned": 10,
    "settings": [group(gain) for gain in GAINS],
    "runs": [
        {
            "setting": {"controller.k1": gain},
            "case": "hold",
            "seed": seed,
            "completed": True,
            "true_max_abs_error_mm": error(gain, seed),
        }
        for gain in GAINS
        for seed in SEEDS
    ],
}


@pytest.fixture(autouse=True)
def settings():
    with matplotlib.rc_context(style.MATPLOTLIB_SETTINGS):
        yield


def test_the_sweep_figure_has_a_point_for_every_run_and_a_bar_at_every_median():
    (drawn,) = spread.draw(SWEEP)
    (axes,) = drawn.figure.axes
    points = sorted(
        float(value) for line in axes.lines if line.get_linestyle() == "None" for value in np.asarray(line.get_ydata())
    )
    bars = sorted(line.get_ydata()[0] for line in axes.lines if line.get_linewidth() == 2.0)

    assert points == pytest.approx(sorted(value for gain in GAINS for seed in SEEDS for value in error(gain, seed)))
    assert bars == pytest.approx(sorted([2.2, 0.6, 0.5, 0.5, 0.2, 0.2]))
    assert [label.get_text() for label in axes.get_xticklabels()] == ["k1 = 1.0", "k1 = 5.0"]
    assert axes.get_ylabel() == "largest true |E| [mm]"
    assert "k1 = 5.0: 0.600 / 0.500 / 0.200" in drawn.caption


def test_the_sweep_figure_does_not_show_incomplete_runs():
    runs = [{**run, "completed": run["seed"] != 4} for run in SWEEP["runs"]]
    (drawn,) = spread.draw({**SWEEP, "runs": runs})
    points = [line for line in drawn.figure.axes[0].lines if line.get_linestyle() == "None" and len(line.get_ydata())]

    assert {len(line.get_ydata()) for line in points} == {4}


def test_the_page_of_a_sweep_has_its_table_figure_and_seeds(tmp_path: Path):
    (tmp_path / "sweep.json").write_text(json.dumps(SWEEP), encoding="utf-8")
    (tmp_path / "experiment.toml").write_text("title = 'hold <it>'\n", encoding="utf-8")
    text = write_report(tmp_path).read_text(encoding="utf-8")

    assert "hold &lt;it&gt;" in text
    assert "Simulated bench. a lab; seeds 0 ... 4." in text
    assert text.count("<img ") == 1
    assert "title = &#x27;hold &lt;it&gt;&#x27;" in text
    cells = '<td>k1 = 5.0</td><td>hold</td><td>5 of 5</td><td>x</td><td class="number">0.600</td>'
    assert cells in text
    assert "Not complete" not in text


def test_the_page_of_an_incomplete_sweep_reports_missing_runs(tmp_path: Path):
    (tmp_path / "sweep.json").write_text(json.dumps({**SWEEP, "completed": False}), encoding="utf-8")

    assert "Not complete: 10 runs were planned." in write_report(tmp_path).read_text(encoding="utf-8")


def test_a_sweep_in_which_nothing_completed_has_no_figure(tmp_path: Path):
    nothing = {**SWEEP, "completed": False, "settings": [{**group(1.0), "completed": 0, "spreads": {}}], "runs": []}
    (tmp_path / "sweep.json").write_text(json.dumps(nothing), encoding="utf-8")

    assert "<img" not in write_report(tmp_path).read_text(encoding="utf-8")


def test_a_report_of_an_invalid_sweep_file_is_refused_naming_the_file(tmp_path: Path):
    (tmp_path / "sweep.json").write_text("{", encoding="utf-8")
    with pytest.raises(NoRun, match=r"sweep\.json"):
        write_report(tmp_path)
