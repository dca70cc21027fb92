"""A sweep's table on the screen, its folder on the disk, and its page with known numbers."""

import io
import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from rich.console import Console

from station.recording.run_outcome import RecordingError
from station.report import style, sweep
from station.report.page import write_report
from station.report.run import NoRun
from station.report.sweep import quantity, setting_label, sweep_table, write_sweep

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
        about
        | {"seed": seed, "completed": True, "true_max_abs_error_mm": error(about["setting"]["controller.k1"], seed)}
        for about in ({"setting": {"controller.k1": gain}, "case": "hold"} for gain in GAINS)
        for seed in SEEDS
    ],
}


@pytest.fixture(autouse=True)
def settings():
    with matplotlib.rc_context(style.MATPLOTLIB_SETTINGS):
        yield


def test_the_sweep_figure_has_a_point_for_every_run_and_a_bar_at_every_median():
    (drawn,) = sweep.draw(SWEEP)
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
    (drawn,) = sweep.draw({**SWEEP, "runs": runs})
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


def test_the_page_of_an_incomplete_sweep_reports_missing_runs_and_has_no_figure_without_completed_runs(tmp_path: Path):
    nothing = {**SWEEP, "completed": False, "settings": [{**group(1.0), "completed": 0, "spreads": {}}], "runs": []}
    (tmp_path / "sweep.json").write_text(json.dumps(nothing), encoding="utf-8")
    text = write_report(tmp_path).read_text(encoding="utf-8")

    assert "Not complete: 10 runs were planned." in text
    assert "<img" not in text


def test_a_report_of_an_invalid_sweep_file_is_refused_naming_the_file(tmp_path: Path):
    (tmp_path / "sweep.json").write_text("{", encoding="utf-8")
    with pytest.raises(NoRun, match=r"sweep\.json"):
        write_report(tmp_path)


def spread_group(k1: float, name: str, *values: float, completed: int = 3) -> dict[str, Any]:
    spreads = {
        f"{name}.{axis}": {"median": value, "worst": 2 * value, "p5": 0.5 * value, "p95": 1.5 * value}
        for axis, value in zip(("x", "y", "z") if len(values) == 3 else ("loaded", "unloaded"), values, strict=True)
    }
    return {"setting": {"controller.k1": k1}, "case": "hold", "runs": 3, "completed": completed, "spreads": spreads}


def summary(*groups: dict[str, Any]) -> dict[str, Any]:
    return {"experiment": "own", "title": "hold [it]", "completed": True, "settings": list(groups), "runs": []}


def shown(sweep: dict[str, Any]) -> list[str]:
    text = io.StringIO()
    Console(file=text, width=110, markup=False).print(sweep_table(sweep))
    return text.getvalue().splitlines()


def test_the_sweep_table_has_a_line_for_each_setting_and_axis():
    lines = shown(summary(*(spread_group(k1, "true_max_abs_error_mm", 1.0 / k1, 0.2, 0.3) for k1 in (1.0, 4.0))))

    assert any("hold [it]" in line for line in lines)
    assert any("largest true |E| [mm] over the seeds" in line for line in lines)
    x = next(line for line in lines if "k1 = 4.0" in line)
    for cell in ("hold", "3 of 3", " x ", "0.250", "0.500", "0.125", "0.375"):
        assert cell in x
    assert sum(" y " in line for line in lines) == 2


def test_the_sweep_table_shows_model_errors_if_the_runs_have_no_tip_errors():
    lines = shown(summary(spread_group(1.0, "model_error_mm", 2.5, 13.0)))

    assert any("loaded model" in line and "2.500" in line for line in lines)
    assert any("unloaded model" in line and "13.000" in line for line in lines)


def test_the_sweep_table_shows_a_setting_in_which_no_run_completed():
    lines = shown(summary({**spread_group(1.0, "rms_error_mm", 1.0, 1.0, 1.0, completed=0), "spreads": {}}))

    assert any("k1 = 1.0" in line and "0 of 3" in line for line in lines)


def test_the_sweep_table_prefers_true_errors_to_measured_ones():
    both = spread_group(1.0, "true_max_abs_error_mm", 1.0, 2.0, 3.0)
    both["spreads"] |= spread_group(1.0, "max_abs_error_mm", 4.0, 5.0, 6.0)["spreads"]

    assert quantity([both])[0] == "true_max_abs_error_mm"
    assert quantity([spread_group(1.0, "max_abs_error_mm", 4.0, 5.0, 6.0)])[0] == "max_abs_error_mm"
    assert quantity([])[3] == []


def test_a_sweep_setting_has_a_readable_label():
    assert setting_label({}) == "as it is"
    assert setting_label({"controller.k1": 2.5, "lab": "default"}) == "k1 = 2.5, lab = default"


def test_the_sweep_table_lists_runs_that_did_not_complete_with_their_reasons():
    about = {"setting": {"controller.k1": 5}, "case": "hold"}
    runs = [about | {"seed": seed, "completed": seed == 0, "cause": f"no. {seed} [x]"} for seed in range(13)]
    lines = shown({**summary(spread_group(5.0, "max_abs_error_mm", 4.0, 5.0, 6.0)), "runs": runs})

    assert any("k1 = 5, hold, seed 1: no. 1 [x]" in line for line in lines)
    assert any("seed 10: no. 10" in line for line in lines)
    assert not any("seed 0" in line or "seed 11" in line for line in lines)
    assert any("and 2 more" in line for line in lines)


def test_the_results_of_a_sweep_are_written_into_the_folder_of_its_manifest(tmp_path):
    sweep = summary(spread_group(1.0, "max_abs_error_mm", 4.0, 5.0, 6.0))
    write_sweep(tmp_path, sweep, "title = 'x'\n", 12.0)

    assert json.loads((tmp_path / "sweep.json").read_text(encoding="utf-8")) == sweep
    assert (tmp_path / "experiment.toml").read_text(encoding="utf-8") == "title = 'x'\n"
    short = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert (short["started"], short["label"]) == (12.0, "complete")
    assert "settings" not in short


def test_writing_sweep_results_into_an_unwritable_folder_fails_naming_the_folder(tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(RecordingError, match="file"):
        write_sweep(tmp_path / "file", summary(), "", 0.0)
