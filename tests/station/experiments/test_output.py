"""Results on disk, whole or not at all, and the table on the screen."""

import io
import json

import numpy as np
import pytest
from rich.console import Console

from station.experiments.experiment import Experiment, load_experiment
from station.experiments.output import OutputError, ResultFolder, result_table
from station.experiments.results import summarise


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return load_experiment("fig7")


@pytest.fixture(scope="module")
def recording(a_case, a_run):
    return a_run(a_case("fig7", "regulation", duration=0.5, settling=0.0))


def shown(experiment: Experiment, summary: dict, width: int = 110) -> list[str]:
    text = io.StringIO()
    Console(file=text, width=width, markup=False).print(result_table(experiment, summary))
    return text.getvalue().splitlines()


def test_a_folder_gets_its_name_only_when_everything_is_in_it(tmp_path, experiment, recording):
    folder = ResultFolder(tmp_path / "deep" / "out", "fig7", 5)
    folder.write_case(recording)
    assert not folder.path.exists()
    folder.finish(experiment, {"completed": True})

    assert [path.name for path in folder.path.parent.iterdir()] == [folder.path.name]
    assert folder.path.name.startswith("fig7-seed5-")
    assert sorted(path.name for path in folder.path.iterdir()) == [
        "experiment.toml",
        "regulation.csv",
        "summary.json",
    ]
    assert json.loads((folder.path / "summary.json").read_text(encoding="utf-8")) == {"completed": True}
    assert (folder.path / "experiment.toml").read_text(encoding="utf-8") == experiment.source


def test_the_csv_has_all_rows_with_units_in_the_column_names(tmp_path, experiment, recording):
    folder = ResultFolder(tmp_path, "fig7", 0)
    folder.write_case(recording)
    folder.finish(experiment, {})
    path = folder.path / "regulation.csv"
    header = path.read_text(encoding="ascii").splitlines()[0].split(",")
    rows = np.loadtxt(path, delimiter=",", skiprows=1)

    assert rows == pytest.approx(recording.rows, rel=1e-8, abs=1e-12)
    assert len(rows) == 250
    assert len(header) == len(set(header)) == rows.shape[1]
    for column in (
        "time [s]",
        "joints.outer_rotation [rad]",
        "joints.inner_translation [m]",
        "velocity_sent.inner_translation [m/s]",
        "wrench_raw.inner_fx [N]",
        "wrench_raw.outer_mz [N m]",
        "force.x [N]",
        "tip_measured.z [m]",
        "tip_true.x [m]",
        "delta_2.y [m]",
    ):
        assert column in header
    x = recording.channels.of(recording.rows, "tip_true")[:, 0]
    assert rows[:, header.index("tip_true.x [m]")] == pytest.approx(x)


def test_a_discarded_folder_leaves_nothing(tmp_path, recording):
    folder = ResultFolder(tmp_path, "fig7", 0)
    folder.write_case(recording)
    folder.discard()

    assert list(tmp_path.iterdir()) == []


def test_folders_made_in_the_same_second_do_not_meet(tmp_path, experiment):
    folders = [ResultFolder(tmp_path, "fig7", 0) for _ in range(4)]
    for folder in folders:
        folder.finish(experiment, {})
    folders.append(ResultFolder(tmp_path, "fig7", 0))
    folders[-1].finish(experiment, {})

    assert len(list(tmp_path.iterdir())) == 5


@pytest.mark.parametrize("name", ["taken", "taken/below", "x" * 300])
def test_a_folder_that_cannot_be_made_is_refused_by_name_before_anything_runs(tmp_path, name):
    (tmp_path / "taken").write_text("a file", encoding="utf-8")

    with pytest.raises(OutputError) as refused:
        ResultFolder(tmp_path / name, "fig7", 0)

    assert str(refused.value).startswith(f"{tmp_path / name}: cannot write results there: ")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_the_table_shows_the_papers_numbers_and_the_units_beside_ours(experiment):
    case = {
        "completed": True,
        "cause": "",
        "max_abs_error_mm": [15.25, 1.5, 3.125],
        "true_max_abs_error_mm": [15.0, 1.0, 3.0],
    }
    lines = shown(experiment, {"cases": {"regulation": case}})

    measured = next(line for line in lines if "measured" in line)
    assert "max |E| measured [mm]" in measured
    for number in ("regulation", "15.250", "1.500", "3.125", "x 15.5"):
        assert number in measured
    assert any("y 2.3" in line for line in lines)
    assert any("z 1.1" in line for line in lines)
    assert any("max |E| true [mm]" in line and "15.000" in line for line in lines)
    assert any(experiment.title in line for line in lines)


def test_the_table_of_a_real_run_shows_its_numbers(experiment, recording):
    summary = summarise(recording)
    lines = shown(experiment, {"cases": {"regulation": summary}})

    true = next(line for line in lines if "max |E| true [mm]" in line)
    for value in summary["true_max_abs_error_mm"]:
        assert f"{value:.3f}" in true


def test_a_case_that_did_not_complete_says_so_and_why(experiment):
    case = {"completed": False, "cause": "no shape found under [1, 0, 0] N [bold]"}
    text = "\n".join(shown(experiment, {"cases": {"regulation": case}}, width=200))

    assert "regulation (not completed)" in text
    assert "no shape found under [1, 0, 0] N [bold]" in text


def test_text_from_a_file_is_shown_as_it_is(experiment):
    odd = experiment._replace(title="[red]a title[/] with brackets [mm]")

    assert any("[red]a title[/] with brackets [mm]" in line for line in shown(odd, {"cases": {}}))


def test_fig6_shows_model_errors_and_fig4_the_parts_of_the_deflection():
    turn = {"completed": True, "cause": "", "model_error_mm": {"loaded": 2.5, "unloaded": 11.0}}
    lines = shown(load_experiment("fig6"), {"cases": {"turn": turn}})
    loaded = next(line for line in lines if "tip - loaded model" in line)
    assert "2.500" in loaded
    assert "1.4" in loaded

    parts = {"deflection": [6.0, 1.0, 2.0], "delta_1": [7.0, 1.5, 2.5], "delta_2": [0.5, 0.25, 0.125]}
    case = {"completed": True, "cause": "", "deflection_max_mm": parts}
    lines = shown(load_experiment("fig4"), {"cases": {"deflection": case}})
    for name, value in (("Delta_total", "6.000"), ("Delta_1", "7.000"), ("Delta_2", "0.500")):
        assert any(name in line and value in line for line in lines)
