"""A sweep that is killed leaves no process."""

import subprocess
import sys

import psutil

from tests.harness.children import children
from tests.harness.waiting import NET, until


def test_the_worker_processes_of_a_killed_sweep_end(write, short, environment, tmp_path):
    command = [sys.executable, "-m", "station", "sweep", str(write(short)), "--seeds", "2", "--jobs", "1"]
    parent = subprocess.Popen([*command, "--set", "duration=3600.0"], cwd=tmp_path, env=environment)
    try:
        started = until(lambda: children(parent.pid, word="spawn_main"))
        assert len(started) == 1
    finally:
        parent.kill()
        parent.wait()
    _, left = psutil.wait_procs(started, timeout=NET)
    assert left == []
