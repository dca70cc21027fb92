"""The commands `report` and `replay`: which run they read, and where they write their files."""

import json
import shutil
from pathlib import Path

import pytest

from station.cli.main import main
from tests.harness.cases import SHORT


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Return a folder with one short run under `runs`."""
    folder = tmp_path_factory.mktemp("folder")
    path = folder / "own.toml"
    path.write_text(SHORT.replace("duration = 1.0", "duration = 0.3"), encoding="utf-8")
    assert main(("run", str(path), "--jobs", "1", "--json", "--out", str(folder / "runs"))) == 0
    return folder


@pytest.fixture
def run(folder, monkeypatch, capsys) -> Path:
    """Return the folder of the run."""
    monkeypatch.chdir(folder)
    capsys.readouterr()
    (run,) = (folder / "runs").iterdir()
    return run


def test_report_and_replay_accept_a_name_or_a_folder(run, capsys):
    for command, which in (("report", run.name), ("replay", str(run))):
        assert main((command, which)) == 0
        made = run / f"{command}.html"
        assert Path(capsys.readouterr().out.strip()).resolve() == made
        assert made.stat().st_size > 20_000
        made.unlink()


def test_report_of_the_latest_run_uses_the_data_folder(run, folder, capsys):
    other = folder / "other" / "elsewhere"
    shutil.copytree(run, other, dirs_exist_ok=True)

    assert main(("report", "latest", "--data", "other")) == 0
    assert Path(capsys.readouterr().out.strip()).resolve() == other / "report.html"


def test_run_writes_its_results_to_the_data_folder(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(("run", "own.toml", "--jobs", "1", "--json", "--data", "kept")) == 0

    (run,) = (folder / "kept").iterdir()
    assert json.loads(capsys.readouterr().out)["recording"] == str(Path("kept", run.name))


def test_option_out_of_report_and_replay_sets_the_destination_of_all_files(run, capsys, folder):
    assert main(("report", "latest", "--out", "made")) == 0
    assert main(("replay", "latest", "--out", "made/own.html")) == 0
    assert capsys.readouterr().out.split() == ["made/report.html", "made/own.html"]
    names = {path.name for path in (folder / "made").iterdir()}

    assert {"report.html", "own.html", "path_own.png", "path_own.pdf"} <= names
    assert not (run / "report.html").exists()


@pytest.mark.parametrize("command", ["report", "replay"])
def test_report_of_a_missing_run_prints_one_line_of_error(command, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    for which in ("latest", "fig99"):
        assert main((command, which)) == 2
        error = capsys.readouterr().err
        assert len(error.splitlines()) == 1
        assert "runs" in error
