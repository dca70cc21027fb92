"""Many more random sequences of requests than the default tests try."""

import os
import subprocess
import sys

import pytest

from tests.harness.root import ROOT


@pytest.mark.parametrize("file", ["test_old_command.py", "test_queue_in_any_order.py"])
def test_hundred_sequences_of_requests_move_nothing_against_a_stop(file: str) -> None:
    command = [sys.executable, "-m", "pytest", "-n", "0", "-q", f"tests/virtual/faults/{file}"]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, "EXAMPLES": "100"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
