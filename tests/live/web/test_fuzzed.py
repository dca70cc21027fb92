"""Hundreds of invalid bodies: never a 5xx, and nothing moves."""

import subprocess
import sys
from pathlib import Path

from tests.fuzz.rest import fuzz
from tests.harness.serving import Served
from tests.harness.waiting import NET


def test_corrupted_rest_bodies_cause_no_server_error_and_no_motion(station: Served) -> None:
    fuzzed = fuzz(station, 150, seed=1)

    assert fuzzed.wrong == []
    assert sum(fuzzed.answers.values()) > 130
    assert fuzzed.answers[422] > 30


def test_valid_and_invalid_rest_requests_cause_no_server_error(station: Served, tmp_path: Path) -> None:
    command = [
        sys.executable, "-c", "from schemathesis.cli import schemathesis; schemathesis()",
        "run", f"{station.url}/api/openapi.json", "--checks", "not_a_server_error",
        "--phases", "examples,coverage,fuzzing", "--max-examples", "3", "--max-time", "10", "--seed", "1", "--no-color",
        "--request-timeout", str(NET),
        # the fuzzer sends no requests to the paths of viser and of the telemetry
        "--exclude-path-regex", "viser|telemetry",
    ]  # fmt: skip
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=NET, check=False)

    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
    station.ready()
