"""A sweep's table on the screen and its folder on the disk."""

import io
import json
from typing import Any

import pytest
from rich.console import Console

from station.experiments.sweep_output import quantity, setting_label, sweep_table, write_sweep
from station.recording.run_outcome import RecordingError


def group(k1: float, name: str, *values: float, completed: int = 3) -> dict[str, Any]:
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
    lines = shown(summary(*(group(k1, "true_max_abs_error_mm", 1.0 / k1, 0.2, 0.3) for k1 in (1.0, 4.0))))

    assert any("hold [it]" in line for line in lines)
    assert any("largest true |E| [mm] over the seeds" in line for line in lines)
    x = next(line for line in lines if "k1 = 4.0" in line)
    for cell in ("hold", "3 of 3", " x ", "0.250", "0.500", "0.125", "0.375"):
        assert cell in x
    assert sum(" y " in line for line in lines) == 2


def test_the_sweep_table_shows_model_errors_if_the_runs_have_no_tip_errors():
    lines = shown(summary(group(1.0, "model_error_mm", 2.5, 13.0)))

    assert any("loaded model" in line and "2.500" in line for line in lines)
    assert any("unloaded model" in line and "13.000" in line for line in lines)


def test_the_sweep_table_shows_a_setting_in_which_no_run_completed():
    lines = shown(summary({**group(1.0, "rms_error_mm", 1.0, 1.0, 1.0, completed=0), "spreads": {}}))

    assert any("k1 = 1.0" in line and "0 of 3" in line for line in lines)


def test_the_sweep_table_prefers_true_errors_to_measured_ones():
    both = group(1.0, "true_max_abs_error_mm", 1.0, 2.0, 3.0)
    both["spreads"] |= group(1.0, "max_abs_error_mm", 4.0, 5.0, 6.0)["spreads"]

    assert quantity([both])[0] == "true_max_abs_error_mm"
    assert quantity([group(1.0, "max_abs_error_mm", 4.0, 5.0, 6.0)])[0] == "max_abs_error_mm"
    assert quantity([])[3] == []


def test_a_sweep_setting_has_a_readable_label():
    assert setting_label({}) == "as it is"
    assert setting_label({"controller.k1": 2.5, "lab": "default"}) == "k1 = 2.5, lab = default"


def test_the_sweep_table_lists_runs_that_did_not_complete_with_their_reasons():
    runs = [
        {
            "setting": {"controller.k1": 5},
            "case": "hold",
            "seed": seed,
            "completed": seed == 0,
            "cause": f"no. {seed} [x]",
        }
        for seed in range(13)
    ]
    lines = shown({**summary(group(5.0, "max_abs_error_mm", 4.0, 5.0, 6.0)), "runs": runs})

    assert any("k1 = 5, hold, seed 1: no. 1 [x]" in line for line in lines)
    assert any("seed 10: no. 10" in line for line in lines)
    assert not any("seed 0" in line or "seed 11" in line for line in lines)
    assert any("and 2 more" in line for line in lines)


def test_the_results_of_a_sweep_are_written_into_the_folder_of_its_manifest(tmp_path):
    sweep = summary(group(1.0, "max_abs_error_mm", 4.0, 5.0, 6.0))
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
