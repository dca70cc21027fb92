"""On a new installation the rehearsal compiles every function that a tick can call."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.harness.root import ROOT


@pytest.mark.parametrize("robot", ["paper", "three_tubes"])
def test_no_feature_compiles_in_a_tick_on_a_new_installation(tmp_path: Path, robot: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.harness.every_feature", robot],
        cwd=ROOT, env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.stdout, done.returncode) == ("", 0), done.stderr
    assert list(tmp_path.rglob("*.nbc"))  # this installation was new
