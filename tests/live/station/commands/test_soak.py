"""A short soak of the whole station; the long ones are run by hand (`ctr-station soak`)."""

import json
import subprocess
import sys
from pathlib import Path

from station.commands.soak import rows


def test_less_than_half_a_minute_leaves_nothing_unexplained(tmp_path: Path, environment: dict[str, str]) -> None:
    command = [sys.executable, "-m", "station", "soak", "--minutes", "0.4", "--seed", "3", "--json"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=280)
    summary = json.loads(done.stdout)

    assert summary["wrong"] == []
    assert summary["passed"] is True
    assert done.returncode == 0
    assert summary["seconds"] >= 45.0
    assert sum(summary["actions"].values()) > 10
    assert set(summary["memory_mb"]) == {"station", "control", "lab", "recorder"}
    assert [what for what, _ in rows(summary)][-1] == "wrong"
    assert list(tmp_path.iterdir()) == []  # what it records is thrown away
