"""A short soak of the whole station; the long ones are run by hand (`ctr-station soak`)."""

import json
import subprocess
import sys
from pathlib import Path

from station.benchmarks.soak import rows
from tests.harness.waiting import NET


def test_short_soak_test_detects_no_failure(tmp_path: Path, environment: dict[str, str]) -> None:
    command = [sys.executable, "-m", "station", "soak", "--minutes", "0.1", "--seed", "3", "--json"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=NET)
    summary = json.loads(done.stdout)

    assert summary["wrong"] == []
    assert summary["passed"] is True
    assert done.returncode == 0
    assert summary["seconds"] >= 6.0
    assert sum(summary["actions"].values()) > 2
    assert set(summary["memory_mb"]) == {"station", "control", "lab", "recorder"}
    assert [what for what, _ in rows(summary)][-1] == "wrong"
    assert list(tmp_path.iterdir()) == []  # the soak test deletes its recordings
