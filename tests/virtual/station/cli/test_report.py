"""The commands `report` and `replay`."""

import json
import shutil
from pathlib import Path

import pytest

from station.cli.main import main
from tests.harness.cases import SHORT


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with one short run under `runs`."""
    place = tmp_path_factory.mktemp("place")
    path = place / "own.toml"
    path.write_text(SHORT.replace("duration = 1.0", "duration = 0.3"), encoding="utf-8")
    assert main(("run", str(path), "--jobs", "1", "--json", "--out", str(place / "runs"))) == 0
    return place


@pytest.fixture
def run(place, monkeypatch, capsys) -> Path:
    """The one run."""
    monkeypatch.chdir(place)
    capsys.readouterr()
    (run,) = (place / "runs").iterdir()
    return run


def test_they_take_the_latest_a_name_or_a_folder(run, capsys):
    for command, which in (("report", "latest"), ("replay", run.name), ("report", str(run)), ("replay", "latest")):
        assert main((command, which)) == 0
        made = run / f"{command}.html"
        assert Path(capsys.readouterr().out.strip()).resolve() == made
        assert made.stat().st_size > 20_000
        made.unlink()


@pytest.mark.parametrize("where", [("--data", "other", "report", "latest"), ("report", "latest", "--data", "other")])
def test_the_latest_is_that_of_the_folder_of_data(run, place, capsys, where):
    other = place / "other" / "elsewhere"
    shutil.copytree(run, other, dirs_exist_ok=True)

    assert main(where) == 0
    assert Path(capsys.readouterr().out.strip()).resolve() == other / "report.html"


def test_results_go_into_the_folder_of_data(place, monkeypatch, capsys):
    monkeypatch.chdir(place)
    assert main(("run", "own.toml", "--jobs", "1", "--json", "--data", "kept")) == 0

    (folder,) = (place / "kept").iterdir()
    assert json.loads(capsys.readouterr().out)["recording"] == str(Path("kept", folder.name))


def test_out_is_where_everything_goes(run, capsys, place):
    assert main(("report", "latest", "--out", "made")) == 0
    assert main(("replay", "latest", "--out", "made/own.html")) == 0
    assert capsys.readouterr().out.split() == ["made/report.html", "made/own.html"]
    names = {path.name for path in (place / "made").iterdir()}

    assert {"report.html", "own.html", "path_own.png", "path_own.pdf"} <= names
    assert not (run / "report.html").exists()


@pytest.mark.parametrize("command", ["report", "replay"])
def test_a_run_that_is_not_there_gets_one_line(command, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    for which in ("latest", "fig99"):
        assert main((command, which)) == 2
        error = capsys.readouterr().err
        assert len(error.splitlines()) == 1
        assert "runs" in error
