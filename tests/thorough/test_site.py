"""The site is built from the repository without a warning."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.harness.root import ROOT
from tests.harness.waiting import NET


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
