"""The guides and pages in station/docs: their commands are accepted, and the files and links that they name exist."""

import re
import shlex
from pathlib import Path

import pytest

import station
from station.cli.main import parser
from station.config.strict import preset_names
from station.devices.registry import plan
from station.service.station_file import load_station

DOCS = Path(station.__file__).parent / "docs"
PAGES = sorted([*DOCS.glob("*.md"), *DOCS.glob("pages/**/*.md")])
STUDENT = (DOCS / "student.md").read_text(encoding="utf-8")


def commands(page: Path) -> list[list[str]]:
    """Return every call of ctr-station on a page as a list of its arguments."""
    text = page.read_text(encoding="utf-8")
    typed = [line for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) for line in block.splitlines()]
    typed += re.findall(r"`(ctr-station [^`]+)`", text)
    calls = [part.strip() for line in typed for part in re.split(r"[|<#]|&&", line)]
    called = [shlex.split(call)[1:] for call in calls if call.startswith("ctr-station ")]
    return [["1" if len(word) == 1 and word.isupper() else word for word in words] for words in called]  # N: a number


#: Pages with commands to type.
GUIDES = [page for page in PAGES if commands(page)]


@pytest.mark.parametrize("page", GUIDES, ids=lambda page: page.stem)
def test_every_command_of_a_guide_is_accepted_by_the_command_line(page: Path):
    top, known = parser()
    for words in commands(page):
        if not words or words[0].startswith("-"):  # the default command
            words = ["serve", *words]
        if words[0] == "serve":  # the package web defines this command, so this parser does not have it
            assert set(words[1::2]) <= {"--config", "--calibration", "--lab", "--robot"}
            continue
        assert words[0] in known.choices
        top.parse_args(words)
        if words[0] in ("run", "sweep") and not words[1].endswith(".toml"):
            assert words[1] in preset_names("experiments")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_link_and_heading_of_a_guide_exists(page: Path):
    text = page.read_text(encoding="utf-8")
    for link, heading in re.findall(r"\]\(([^)#\s]+)#?([^)\s]*)\)", text):
        there = (page.parent / link).resolve()
        assert there.is_file(), link
        if not heading:  # a picture, or a whole page
            continue
        titles = [line.lstrip("#").strip() for line in there.read_text("utf-8").splitlines() if line.startswith("#")]
        headings = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}
        assert heading in headings, f"{link}#{heading}"


def test_station_files_of_the_student_guide_describe_a_bench(tmp_path: Path):
    bench, practice = (text for text in re.findall(r"```toml\n(.*?)```", STUDENT, re.DOTALL))
    sensors = [line for line in bench.splitlines() if line.startswith("tubes.")]
    assert len(sensors) == sum(line.startswith("tubes.") for line in practice.splitlines()) == 2
    for number, text in enumerate((bench, bench.replace("\n".join(sensors), practice))):
        path = tmp_path / f"{number}.toml"
        path.write_text(text, encoding="utf-8")
        told = load_station(path).bench()
        assert told.devices is not None
        assert set(plan(told.devices, told.robot)) == {"stages", "tracker", "sensors"}
