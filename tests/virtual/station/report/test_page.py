"""The page of a report: one self-contained file with the numbers of the run."""

import base64
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import imageio.v3 as iio
import pytest

from station.report.page import ReportError, write_report
from station.report.run import NoRun, read_run


class Page(HTMLParser):
    """Pictures, cells and texts of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.pictures: list[dict[str, str]] = []
        self.rows: list[list[str]] = []
        self.tags: list[str] = []
        self.text = ""
        self._in = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self._in = tag
        if tag == "img":
            self.pictures.append(dict(attrs))
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_data(self, data):
        if self._in in ("td", "th") and self.rows:
            self.rows[-1][-1] += data
        if self._in != "style":
            self.text += data


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
    assert "script" not in page.tags
    assert "link" not in page.tags
    assert len(page.pictures) == 8
    for picture in page.pictures:
        kind, data = picture["src"].split(",", 1)
        assert kind == "data:image/svg+xml;base64"
        image = ElementTree.fromstring(base64.b64decode(data))
        assert image.tag == "{http://www.w3.org/2000/svg}svg"
        links = [value for part in image.iter() for key, value in part.attrib.items() if key.endswith("href")]
        assert links
        assert all(link.startswith("#") for link in links)
        # Letters are drawn as shapes, so that the figure needs no font.
        assert not [part for part in image.iter() if part.tag.endswith("}text")]
        assert len(picture["alt"]) > 40


def test_a_report_is_written_into_the_folder_of_the_run(report):
    assert report.name == "report.html"
    assert (report.parent / "one.mcap").exists()
    assert not list(report.parent.glob("*.partial"))


def test_a_report_names_the_simulated_parts(page, short_run):
    title = json.loads((short_run / "summary.json").read_text(encoding="utf-8"))["lab"]

    assert "Simulated bench, seed 0" in page.text
    assert title in page.text
    assert "The paper's numbers come from a real bench" in page.text


def test_every_figure_of_a_report_states_the_origin_of_its_data(page):
    for picture in page.pictures:
        # Letters are drawn as shapes; a comment in the SVG has their text.
        assert b"<!-- simulated bench, seed 0 -->" in base64.b64decode(picture["src"].split(",", 1)[1])


def test_a_row_of_the_comparison_table_has_the_papers_number_the_measured_one_and_the_ratio(page, short_run):
    numbers = json.loads((short_run / "summary.json").read_text(encoding="utf-8"))["cases"]["one"]
    measured, true = numbers["max_abs_error_mm"], numbers["true_max_abs_error_mm"]
    rows = [row for row in page.rows if len(row) == 6]

    assert rows[0] == ["case", "quantity", "paper", "here, measured", "here, true", "ratio"]
    assert rows[1] == [
        "one", "largest |E| in x", "7.9", f"{measured[0]:.2f}", f"{true[0]:.2f}", f"{measured[0] / 7.9:.2f}",
    ]  # fmt: skip
    assert rows[2][1:3] == ["largest |E| in z", "2"]
    errors = [row for row in page.rows if len(row) == 5 and row[1] == "RMS E, true"]
    assert errors[0][2:] == [f"{value:.3f}" for value in numbers["true_rms_error_mm"]]


def test_the_result_is_the_first_part_of_a_report(page, short_run):
    numbers = json.loads((short_run / "summary.json").read_text(encoding="utf-8"))["cases"]["two"]
    before = page.text.split("The paper's numbers and ours")[0]

    assert "Ended: complete." in before
    assert f"The true tip (case two) was at most {numbers['true_max_distance_mm']:.2f} mm" in before
    assert f"the force on it was at most {numbers['force_max_N']:.2f} N" in before


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
    assert "Distorted: the tracker's field is bent" in text
    assert read_run(folder).case("paper_distorted").metadata["lab"]["tracker"]["distortion"] == 0.48e-3


def test_a_report_of_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(NoRun, match="no run in this folder"):
        write_report(tmp_path)


def test_a_report_that_cannot_be_written_fails_naming_the_path(short_run, tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(ReportError, match="file/out: cannot write the report"):
        write_report(short_run, tmp_path / "file" / "out")


def test_the_style_sheet_of_a_report_supports_printing(report: Path):
    text = report.read_text(encoding="utf-8")

    assert "@page { size: A4" in text
    assert "break-inside: avoid" in text
