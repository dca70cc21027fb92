"""Bodies that make no sense, by the hundred: never a 5xx, and nothing moves."""

import subprocess
import sys
from pathlib import Path

from tests.fuzz.rest import fuzz
from tests.harness.serving import Served
from tests.harness.waiting import NET


def test_damaged_bodies_break_nothing_and_move_nothing(station: Served) -> None:
    fuzzed = fuzz(station, 150, seed=1)

    assert fuzzed.wrong == []
    assert sum(fuzzed.answers.values()) > 130
    assert fuzzed.answers[422] > 30


def test_what_the_schema_allows_and_forbids_is_answered_without_a_server_error(station: Served, tmp_path: Path) -> None:
    command = [
        Path(sys.executable).parent / "st", "run", f"{station.url}/api/openapi.json", "--checks", "not_a_server_error",
        "--phases", "examples,coverage,fuzzing", "--max-examples", "3", "--max-time", "10", "--seed", "1", "--no-color",
        "--request-timeout", str(NET),
        # a report of a run that does not exist is not looked for by name
        "--exclude-path-regex", "viser|telemetry",
    ]  # fmt: skip
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=NET, check=False)

    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
    station.ready()
