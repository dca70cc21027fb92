"""A home folder that takes nothing but a cache is no reason for a word from matplotlib."""

import os
import subprocess
import sys
from pathlib import Path

from tests.harness.root import ROOT


def said(home: Path, **more: str) -> str:
    """What is said when reports are imported by somebody with that home."""
    known = {key: value for key, value in os.environ.items() if not key.startswith(("MPL", "XDG_", "HOME"))}
    command = [sys.executable, "-c", "import station.report.style, matplotlib; print(matplotlib.get_configdir())"]
    environment = known | {"HOME": str(home)} | more
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert done.stderr == ""
    return done.stdout.strip()


def test_a_home_that_cannot_be_written_is_not_complained_of_beside_a_cache(tmp_path: Path):
    nobodys = tmp_path / "a file"
    nobodys.write_text("in the way of any folder, for root, too", encoding="utf-8")
    cache = tmp_path / "cache"
    assert said(nobodys / "home", XDG_CACHE_HOME=str(cache)) == str(cache / "matplotlib")


def test_somebody_who_says_where_matplotlib_looks_is_heeded(tmp_path: Path):
    assert said(tmp_path, MPLCONFIGDIR=str(tmp_path / "mine")) == str(tmp_path / "mine")
