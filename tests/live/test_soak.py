"""A short soak test of a whole station; the long ones are run by hand."""

import json
import subprocess
import sys
from pathlib import Path

from tests.harness.root import ROOT
from tests.harness.waiting import NET


def test_short_soak_test_detects_no_failure(tmp_path: Path, environment: dict[str, str]) -> None:
    command = [sys.executable, "-m", "tests.measure.soak", "--minutes", "0.1", "--seed", "3"]
    environment |= {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=NET)
    summary = json.loads(done.stdout)

    assert summary["wrong"] == []
    assert summary["passed"] is True
    assert done.returncode == 0
    assert summary["seconds"] >= 6.0
    assert sum(summary["actions"].values()) > 2
    assert set(summary["memory_mb"]) == {"station", "control", "guard", "lab", "recorder"}
    assert list(tmp_path.iterdir()) == []  # the soak test deletes its recordings
