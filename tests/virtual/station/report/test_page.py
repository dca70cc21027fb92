"""The page of a report: one self-contained file with the numbers of the run."""

import base64
import json
import re
import shutil
from xml.etree import ElementTree

import imageio.v3 as iio
import pytest

from station.report.page import ReportError, write_report
from station.report.run import NoRun, read_run
from tests.harness.report_page import Page


@pytest.fixture(scope="module")
def report(short_run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / short_run.name
    shutil.copytree(short_run, folder)
    return write_report(folder)


@pytest.fixture(scope="module")
def page(report) -> Page:
    return Page(report.read_text(encoding="utf-8"))


def test_a_report_is_one_self_contained_file(report, page):
    text = report.read_text(encoding="utf-8")

    assert not re.findall(r"https?:|//[a-z]|url\(|@import|src=\"(?!data:)", re.sub(r"base64,[^\"]*", "", text))
    assert (report.name, (report.parent / "one.mcap").exists()) == ("report.html", True)
    assert not list(report.parent.glob("*.partial"))
    assert "@page { size: A4" in text  # for prints
    assert "break-inside: avoid" in text
    assert "script" not in page.tags
    assert "link" not in page.tags
    assert len(page.pictures) == 8
    for picture in page.pictures:
        kind, data = picture["src"].split(",", 1)
        assert kind == "data:image/svg+xml;base64"
        # Letters are drawn as shapes; a comment in the SVG has their text, which states the origin of the data.
        assert b"<!-- simulated bench, seed 0 -->" in base64.b64decode(data)
        image = ElementTree.fromstring(base64.b64decode(data))
        assert image.tag == "{http://www.w3.org/2000/svg}svg"
        links = [value for part in image.iter() for key, value in part.attrib.items() if key.endswith("href")]
        assert links
        assert all(link.startswith("#") for link in links)
        # Letters are drawn as shapes, so that the figure needs no font.
        assert not [part for part in image.iter() if part.tag.endswith("}text")]
        assert len(picture["alt"]) > 40


def test_a_report_names_the_simulated_parts(page, short_run):
    title = json.loads((short_run / "summary.json").read_text(encoding="utf-8"))["lab"]

    assert "Simulated bench, seed 0" in page.text
    assert title in page.text
    assert "The paper's numbers come from a real bench" in page.text


def test_a_report_has_the_line_rates_of_each_axis(page, short_run):
    rates = json.loads((short_run / "summary.json").read_text(encoding="utf-8"))["cases"]["two"]["line_rates"]
    rows = [row for row in page.rows if len(row) == 4 and row[1] in rates]

    assert len(rows) == 6
    assert rows[3] == ["two", "outer_rotation", *(f"{rate:.1f}" for rate in rates["outer_rotation"].values())]
    assert 20.0 < float(rows[3][2]) < 60.0


def test_a_report_has_configuration_and_versions_once(page, short_run):
    assert (short_run / "experiment.toml").read_text(encoding="utf-8") in page.text
    assert page.text.count("versions.numpy = ") == 1
    assert page.text.count("robot.tubes[0].bending_stiffness = 0.0413") == 1
    # The configuration of the second case lists only its differences from the first.
    second = page.text.split("(case two): differences from the first case")[1]
    assert "settings.controller.feedforward = true" in second
    assert "settings.duration" not in second


def test_a_report_escapes_text_from_files(page):
    assert "short <b>run</b> & more" in page.text
    assert "b" not in page.tags[: page.tags.index("figure")]


def test_figures_are_written_as_png_and_pdf_and_the_same_run_gives_the_same_report(preset_run, tmp_path):
    run = preset_run("fig7", 1.5, 0.5)
    path = write_report(run, tmp_path)

    assert path == tmp_path / "report.html"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["fig7.pdf", "fig7.png", "report.html"]
    picture = iio.imread(tmp_path / "fig7.png")
    assert picture.shape[1] == 1400
    assert picture.std() > 5.0
    assert (tmp_path / "fig7.pdf").read_bytes().startswith(b"%PDF-")
    assert write_report(run, tmp_path / "again").read_bytes() == path.read_bytes()


def test_a_report_has_the_cause_of_an_incomplete_case(folder_of):
    cases = {"one": {"completed": False, "cause": "no shape <found>"}}
    text = write_report(folder_of({"experiment": "fig7", "cases": cases})).read_text(encoding="utf-8")

    assert "did not complete: no shape &lt;found&gt;" in text
    assert "Nothing was recorded." in text


def test_a_report_of_a_case_with_a_distorted_tracker_names_its_lab(preset_run, tmp_path):
    folder = preset_run("fig10", 1.5, 0.5, ("feedforward",))
    shutil.copytree(folder, tmp_path / "run")
    text = Page(write_report(tmp_path / "run").read_text(encoding="utf-8")).text

    assert "Case 'paper_distorted': virtual lab with a distorted tracker" in text
    assert "Distorted: the tracker's field is distorted" in text
    assert read_run(folder).case("paper_distorted").metadata["lab"]["tracker"]["distortion"] == 0.48e-3


def test_a_report_of_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(NoRun, match="no run in this folder"):
        write_report(tmp_path)


def test_a_report_that_cannot_be_written_fails_naming_the_path(short_run, tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(ReportError, match="file/out: cannot write the report"):
        write_report(short_run, tmp_path / "file" / "out")
