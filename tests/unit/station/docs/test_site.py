"""The Markdown files keep the rules of documents; `tests/thorough` builds the site."""

import re
from pathlib import Path

import pytest

from tests.harness.root import ROOT

PAGES = [
    path
    for path in ROOT.rglob("*.md")
    if not {".venv", ".pytest_cache", "build", "node_modules"} & set(path.relative_to(ROOT).parts)
]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_every_link_of_a_document_leads_to_a_file(path: Path):
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    for link in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        assert re.match(r"[a-z]+:", link) or (path.parent / link).exists(), link


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_prose_of_a_document_has_at_most_120_characters_a_line(path: Path):
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    assert [line for line in text.splitlines() if len(line) > 120 and not line.startswith("|")] == []


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_paths_in_a_document_exist_and_its_tables_are_whole(path: Path):
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    bases = (path.parent, ROOT, ROOT / "station", ROOT / "tests")
    named = re.findall(r"`([\w.-]+(?:/[\w.-]+)+\.(?:py|js|md|toml|csv|svg)|(?:core|station|tests|web)/[\w./]+)`", text)
    assert [name for name in named if not any((base / name).exists() for base in bases)] == []
    for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        bars = [len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()]
        assert len(set(bars)) == 1, table.splitlines()[0]
        assert re.fullmatch(r"[-|]+", table.splitlines()[1]), table.splitlines()[0]
