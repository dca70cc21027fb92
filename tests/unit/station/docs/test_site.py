"""The site is built from the repository without a warning, and its Markdown files keep the rules of documents."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.harness.root import ROOT
from tests.harness.waiting import NET

PAGES = [
    path for path in ROOT.rglob("*.md") if not {".venv", "build", "node_modules"} & set(path.relative_to(ROOT).parts)
]
DECISIONS = ROOT / "station" / "docs" / "decisions"


@pytest.mark.skipif(importlib.util.find_spec("mkdocstrings") is None, reason="builds the site: needs the extra docs")
def test_site_is_built_without_a_warning_and_has_the_generated_reference(tmp_path: Path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-f", ROOT / "station/docs/mkdocs.yml"]
    done = subprocess.run([*command, "-d", tmp_path], capture_output=True, text=True, timeout=NET, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    generated = {"commands": "calibrate", "channels": "tip_estimated", "rest": "/api/stop", "api/model": "Statics"}
    for page, text in generated.items():
        assert text in (tmp_path / "reference" / f"{page}.html").read_text(encoding="utf-8"), page
    loaded = re.findall(r'(?:src|<link[^>]*href)="(https?://[^"]+)"', (tmp_path / "index.html").read_text("utf-8"))
    assert not loaded, "a page loads something from another address"


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_every_link_of_a_document_leads_to_a_file(path: Path):
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    for link in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        assert re.match(r"[a-z]+:", link) or (path.parent / link).exists(), link


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_prose_of_a_document_has_at_most_120_characters_a_line(path: Path):
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    if path.name != "FILES.md":  # generated from docstrings
        assert [line for line in text.splitlines() if len(line) > 120 and not line.startswith("|")] == []


def test_every_decision_is_listed_and_has_context_decision_and_consequences():
    listed = (DECISIONS / "README.md").read_text(encoding="utf-8")
    records = sorted(DECISIONS.glob("[0-9]*.md"))
    assert len(records) >= 10
    for record in records:
        assert f"({record.name})" in listed
        text = record.read_text(encoding="utf-8")
        assert [part for part in ("Context", "Decision", "Consequences") if f"**{part}.**" not in text] == []
