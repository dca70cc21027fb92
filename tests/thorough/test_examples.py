"""Each example package is built and installed without a network, and its own tests pass."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.harness.root import ROOT
from tests.harness.waiting import NET

EXAMPLES = ROOT / "station" / "docs" / "examples"
FOLDERS = sorted(path.parent for path in EXAMPLES.glob("*/pyproject.toml"))
MISSING = [name for name in ("hatchling", "pip") if importlib.util.find_spec(name) is None]


@pytest.mark.skipif(bool(MISSING), reason=f"installs packages: needs {', '.join(MISSING)}")
@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_example_is_installed_and_passes_its_tests(folder: Path, tmp_path: Path):
    source, site = tmp_path / "source", tmp_path / "site"
    shutil.copytree(folder, source, ignore=shutil.ignore_patterns("__pycache__"))
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-index", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", site, source], check=True, capture_output=True, timeout=NET)
    (tmp_path / "tests").mkdir()
    for test in folder.glob("test_*.py"):
        shutil.copy(test, tmp_path / "tests")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "--import-mode=importlib", "tests"],
        capture_output=True, text=True, timeout=NET, cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": f"{site}{os.pathsep}{ROOT}"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
