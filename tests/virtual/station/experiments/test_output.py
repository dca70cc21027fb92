"""Results on the disk are complete or absent; the table of results on the screen."""

import io
import json
import time

import numpy as np
import pytest
from rich.console import Console

from station.config.robots import RobotFile
from station.experiments.experiment import Experiment, offered_experiment
from station.experiments.output import ResultFolder, SummaryRows, result_table, run_recorded
from station.experiments.results import summarise
from station.recording.read import read_case
from station.recording.run_outcome import RecordingError, RunOutcome
from tests.harness.cases import a_case, a_run
from tests.harness.recordings import as_recorded


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return offered_experiment("fig7")


@pytest.fixture(scope="module")
def recording():
    return a_run(a_case("fig7", "regulation", duration=0.5, settling=0.0))


def record(folder: ResultFolder, recording, label: RunOutcome = RunOutcome.COMPLETE, cause: str = "") -> None:
    """Record rows one by one, as a run does."""
    writer = folder.assignment(recording.case).writer()
    writer.write(recording.rows)
    writer.close(label, cause)


def shown(experiment: Experiment, summary: dict, width: int = 110) -> list[str]:
    text = io.StringIO()
    Console(file=text, width=width, markup=False).print(result_table(experiment, summary))
    return text.getvalue().splitlines()


def test_a_results_folder_gets_its_name_only_when_the_run_is_complete(tmp_path, experiment, recording):
    folder = ResultFolder(tmp_path / "deep" / "out", experiment, 5)
    record(folder, recording)
    assert not folder.path.exists()
    folder.finish({"completed": True, "cases": {"regulation": {"cause": ""}}})

    assert [path.name for path in folder.path.parent.iterdir()] == [folder.path.name]
    assert folder.path.name.startswith("fig7-seed5-")
    assert sorted(path.name for path in folder.path.iterdir()) == ["experiment.toml", "regulation.mcap", "summary.json"]
    summary = json.loads((folder.path / "summary.json").read_text(encoding="utf-8"))
    assert summary["completed"] is True
    assert summary["label"] == "complete"
    assert summary["title"] == experiment.title
    assert summary["started"] == pytest.approx(time.time(), abs=60.0)
    assert (folder.path / "experiment.toml").read_text(encoding="utf-8") == experiment.source


def test_a_recording_has_all_rows_and_all_settings(tmp_path, experiment, recording):
    folder = ResultFolder(tmp_path, experiment, 3)
    record(folder, recording)
    folder.finish({"completed": True})
    read = read_case(folder.path / "regulation.mcap")

    assert (read.rows == as_recorded(recording.rows, read.channels)).all()
    assert len(read.rows) == 250
    assert read.channels == recording.channels.all
    assert read.label is RunOutcome.COMPLETE
    assert read.metadata["seed"] == 3
    assert read.metadata["case"] == "regulation"
    assert read.metadata["source"] == experiment.source
    assert read.metadata["settings"]["duration"] == 0.5
    assert RobotFile.model_validate_json(json.dumps(read.metadata["robot"])) == recording.case.robot
    assert type(recording.case.lab).model_validate_json(json.dumps(read.metadata["lab"])) == recording.case.lab
    assert read.metadata["versions"]["numpy"]


def test_recording_and_summary_have_the_outcome_of_a_run(tmp_path, experiment, recording):
    folder = ResultFolder(tmp_path, experiment, 0)
    record(folder, recording, RunOutcome.STOPPED, "stopped by the operator")
    folder.finish({"completed": False, "cases": {"regulation": {"cause": "stopped by the operator"}}})
    read = read_case(folder.path / "regulation.mcap")

    assert (read.label, read.cause) == (RunOutcome.STOPPED, "stopped by the operator")
    assert json.loads((folder.path / "summary.json").read_text(encoding="utf-8"))["label"] == "stopped"


def test_an_abandoned_results_folder_without_a_recording_is_removed(tmp_path, experiment):
    ResultFolder(tmp_path, experiment, 0).abandon()

    assert list(tmp_path.iterdir()) == []


def test_an_abandoned_results_folder_keeps_the_recorded_rows(tmp_path, experiment, recording):
    folder = ResultFolder(tmp_path, experiment, 0)
    record(folder, recording)
    folder.abandon()

    assert list(tmp_path.iterdir()) == [folder.path]
    read = read_case(folder.path / "regulation.mcap")
    assert (read.rows == as_recorded(recording.rows, read.channels)).all()
    summary = json.loads((folder.path / "summary.json").read_text(encoding="utf-8"))
    assert (summary["label"], summary["completed"], summary["experiment"]) == ("interrupted", False, "fig7")


def test_a_case_that_raises_an_exception_is_recorded_as_interrupted(tmp_path, experiment, recording):
    folder = ResultFolder(tmp_path, experiment, 0)
    assignment = folder.assignment(recording.case)

    def fails(part: float) -> None:
        if part > 0.0:
            raise MemoryError

    with pytest.raises(MemoryError):
        run_recorded(assignment, fails)
    folder.abandon()
    read = read_case(folder.path / "regulation.mcap")

    assert read.label is RunOutcome.INTERRUPTED
    assert (read.rows == as_recorded(recording.rows[: len(read.rows)], read.channels)).all()
    assert len(read.rows) > 0


def test_a_recorded_case_has_the_rows_and_numbers_of_the_same_case_in_memory(tmp_path, experiment, recording):
    folder = ResultFolder(tmp_path, experiment, 0)
    done = run_recorded(folder.assignment(recording.case), lambda _: None)
    folder.finish({"completed": True}, [done.label])

    read = read_case(folder.path / "regulation.mcap")
    assert (read.rows == as_recorded(recording.rows, read.channels)).all()
    assert {**done.numbers, "wall_s": 0.0} == {**summarise(recording), "wall_s": 0.0}
    assert (done.name, done.completed, done.label) == ("regulation", True, RunOutcome.COMPLETE)


def test_a_recording_ended_by_a_full_disk_makes_the_run_incomplete(tmp_path, experiment, recording):
    folder = ResultFolder(tmp_path, experiment, 0)
    record(folder, recording)
    folder.finish({"completed": True}, [RunOutcome.COMPLETE, RunOutcome.INCOMPLETE])

    assert json.loads((folder.path / "summary.json").read_text(encoding="utf-8"))["label"] == "incomplete"


def test_results_folders_created_in_the_same_second_have_different_names(tmp_path, experiment):
    folders = [ResultFolder(tmp_path, experiment, 0) for _ in range(4)]
    for folder in folders:
        folder.finish({})
    folders.append(ResultFolder(tmp_path, experiment, 0))
    folders[-1].finish({})

    assert len(list(tmp_path.iterdir())) == 5


@pytest.mark.parametrize("name", ["taken", "taken/below", "x" * 300])
def test_a_results_folder_that_cannot_be_created_is_refused_before_anything_runs(tmp_path, experiment, name):
    (tmp_path / "taken").write_text("a file", encoding="utf-8")

    with pytest.raises(RecordingError) as refused:
        ResultFolder(tmp_path / name, experiment, 0)

    assert str(refused.value).startswith(f"{tmp_path / name}: cannot write results: ")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_the_results_table_shows_why_a_case_did_not_complete(experiment):
    case = {"completed": False, "cause": "no shape found under [1, 0, 0] N [bold]"}
    text = "\n".join(shown(experiment, {"cases": {"regulation": case}}, width=200))

    assert "regulation (not completed)" in text
    assert "no shape found under [1, 0, 0] N [bold]" in text


def test_the_results_table_shows_markup_in_a_title_verbatim(experiment):
    odd = experiment._replace(title="[red]a title[/] with brackets [mm]")

    assert any("[red]a title[/] with brackets [mm]" in line for line in shown(odd, {"cases": {}}))


def test_the_results_table_of_fig6_shows_model_errors_and_that_of_fig4_the_deflection():
    turn = {"completed": True, "cause": "", "model_error_mm": {"loaded": 2.5, "unloaded": 11.0}}
    lines = shown(offered_experiment("fig6"), {"cases": {"turn": turn}})
    loaded = next(line for line in lines if "tip - loaded model" in line)
    assert "2.500" in loaded
    assert "1.4" in loaded

    parts = {"deflection": [6.0, 1.0, 2.0], "delta_1": [7.0, 1.5, 2.5], "delta_2": [0.5, 0.25, 0.125]}
    case = {"completed": True, "cause": "", "deflection_max_mm": parts}
    lines = shown(offered_experiment("fig4"), {"cases": {"deflection": case}})
    for name, value in (("Delta_total", "6.000"), ("Delta_1", "7.000"), ("Delta_2", "0.500")):
        assert any(name in line and value in line for line in lines)


def test_the_summary_of_a_long_run_is_computed_from_every_nth_row():
    kept = SummaryRows(10)
    for number in range(41):
        kept.add(np.array([float(number)]))
    assert [float(row[0]) for row in kept.rows] == [0.0, 8.0, 16.0, 24.0, 32.0, 40.0]
