"""The commands `report` and `replay`."""

from pathlib import Path

import pytest

from station.cli import main


@pytest.fixture
def runs(monkeypatch, write, short, tmp_path) -> Path:
    """A folder with one short run under `runs`."""
    monkeypatch.chdir(tmp_path)
    path = write(short.replace("duration = 1.0", "duration = 0.3"))
    assert main(("run", str(path), "--jobs", "1", "--json")) == 0
    return tmp_path / "runs"


def test_report_and_replay_of_the_latest_of_a_name_and_of_a_folder(runs, capsys):
    capsys.readouterr()
    (run,) = runs.iterdir()
    for which in ("latest", run.name, str(run)):
        assert main(("report", which)) == 0
        assert Path(capsys.readouterr().out.strip()).resolve() == run / "report.html"
    assert main(("replay", "latest")) == 0
    assert Path(capsys.readouterr().out.strip()).resolve() == run / "replay.html"
    for name in ("report.html", "replay.html"):
        assert (run / name).stat().st_size > 20_000


def test_out_is_where_everything_goes(runs, capsys, tmp_path):
    capsys.readouterr()
    assert main(("report", "latest", "--out", "made")) == 0
    assert main(("replay", "latest", "--out", "made/own.html")) == 0
    assert capsys.readouterr().out.split() == ["made/report.html", "made/own.html"]
    names = {path.name for path in (tmp_path / "made").iterdir()}

    assert {"report.html", "own.html", "path_own.png", "path_own.pdf"} <= names
    (run,) = runs.iterdir()
    assert not (run / "report.html").exists()


@pytest.mark.parametrize("command", ["report", "replay"])
def test_a_run_that_is_not_there_gets_one_line(command, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    for which in ("latest", "fig99"):
        assert main((command, which)) == 2
        error = capsys.readouterr().err
        assert len(error.splitlines()) == 1
        assert "runs" in error
