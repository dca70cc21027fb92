"""Matplotlib gives no warning in a home folder in which only the cache is writable."""

import os
import subprocess
import sys
from pathlib import Path

from tests.harness.root import ROOT

#: Message of matplotlib on a busy computer.
SLOW = "Matplotlib is building the font cache; this may take a moment.\n"


def config_folder(home: Path, **more: str) -> str:
    """Import the reports with this home folder, check that there is no warning, and return the folder of matplotlib."""
    known = {key: value for key, value in os.environ.items() if not key.startswith(("MPL", "XDG_", "HOME"))}
    command = [sys.executable, "-c", "import station.report.style, matplotlib; print(matplotlib.get_configdir())"]
    environment = known | {"HOME": str(home)} | more
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert done.stderr.replace(SLOW, "") == ""
    return done.stdout.strip()


def test_matplotlib_gives_no_warning_in_an_unwritable_home_with_a_cache_folder(tmp_path: Path):
    nobodys = tmp_path / "a file"
    nobodys.write_text("in the way of any folder, for root, too", encoding="utf-8")
    cache = tmp_path / "cache"
    assert config_folder(nobodys / "home", XDG_CACHE_HOME=str(cache)) == str(cache / "matplotlib")


def test_reports_use_the_matplotlib_folder_in_the_users_mplconfigdir(tmp_path: Path):
    assert config_folder(tmp_path, MPLCONFIGDIR=str(tmp_path / "mine")) == str(tmp_path / "mine")
