"""Figures of several cases at the size of a journal's column: size, letters, units, and lines with their labels."""

import re
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from station.cli.main import main
from station.recording.read import read_case
from station.report import overlay
from station.report.run import read_run


def test_figure_of_two_cases_has_the_width_of_a_journals_column(short_run, tmp_path, capsys):
    assert main(("figure", f"{short_run}:one", f"{short_run}:two", "-o", str(tmp_path / "both.pdf"))) == 0
    assert main(("figure", str(short_run), "-o", str(tmp_path / "both.svg"))) == 0

    assert "Distance of the true tip" in capsys.readouterr().out
    (width,) = re.findall(rb"/MediaBox \[ 0 0 ([0-9.]+) ", (tmp_path / "both.pdf").read_bytes())
    assert float(width) * 25.4 / 72.0 == pytest.approx(88.0, abs=0.01)
    assert 'width="249.448819pt"' in (tmp_path / "both.svg").read_text(encoding="utf-8")


def test_figure_of_two_cases_has_letters_of_8_points_units_and_a_line_for_each_case(short_run):
    with matplotlib.rc_context(overlay.SETTINGS):
        figure, _ = overlay.draw(read_run(short_run).cases)
        error, force = figure.axes
        labels = error.get_ylabel(), force.get_ylabel(), force.get_xlabel()
        assert labels == ("tip error [mm]", "force [N]", "time [s]")
        (legend,) = figure.legends
        assert [text.get_text() for text in legend.get_texts()] == ["feedforward false", "feedforward true"]
        texts = [*legend.get_texts(), error.yaxis.label, *error.get_yticklabels(), *force.get_xticklabels()]
        assert {text.get_fontsize() for text in texts} == {8.0}
        for line, name in zip(error.lines, ("one", "two"), strict=True):
            rows = read_case(short_run / f"{name}.mcap")
            distance = 1e3 * np.linalg.norm(rows.of("tip_desired") - rows.of("tip_true"), axis=1)
            assert np.max(line.get_ydata()) == pytest.approx(distance.max())
        inside = figure.bbox.padded(0.5)
        assert all(inside.contains(*corner) for corner in legend.get_window_extent().corners())


def test_cases_with_many_differences_are_named_by_case_and_equal_cases_by_number(short_run):
    one, two = read_run(short_run).cases
    settings = {**two.metadata["settings"], "duration": 9.0, "settling": 1.0, "title": "another"}
    changed = two.__class__(**{**two.__dict__, "metadata": {**two.metadata, "settings": settings}})

    assert overlay.labels((one, changed)) == ["one", "two"]
    assert overlay.labels((one, one)) == ["1: short <b>run</b> & more", "2: short <b>run</b> & more"]


@pytest.mark.parametrize(
    ("runs", "out", "text"),
    [
        ((":one",), "x.pdf", "at least two cases"),
        ((":one", ":three"), "x.pdf", "no case 'three' with a motion; its cases: one, two"),
        (("",), "x.png", "the file name must end with .pdf or .svg"),
        (("",), "missing/x.pdf", "cannot write the figure"),
    ],
)
def test_figure_that_is_impossible_is_refused_in_one_line(short_run: Path, tmp_path: Path, runs, out, text, capsys):
    assert main(("figure", *(f"{short_run}{case}" for case in runs), "-o", str(tmp_path / out))) == 2
    error = capsys.readouterr().err
    assert text in error
    assert len(error.splitlines()) == 1
