"""A sweep that is killed or interrupted leaves no process."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence

import psutil
import pytest

from station.experiments.manifest import Row
from station.experiments.sweep import on_processes
from station.experiments.sweep_plan import jobs, settings
from tests.harness.children import children
from tests.harness.waiting import NET, until


@pytest.fixture
def own(write, short):
    """Return an experiment of one second at rest with two cases."""
    return str(write(short + "[cases.one]\n[cases.two.controller]\nfeedforward = true\n"))


def test_ctrl_c_ends_the_active_runs_of_a_sweep_and_starts_no_other(own):
    listed = jobs(own, settings(["duration=3600.0"]), range(4), "one")
    others, ended = workers(), list[psutil.Process]()

    def press() -> None:
        while not ended:
            ended[:] = workers(others=others)
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    presser = threading.Thread(target=press)
    presser.start()
    rows: list[Row] = []
    on_processes(listed, 1, rows.append, lambda _: None)
    presser.join()

    assert rows == []  # an interrupted run is not reported as finished
    assert not any(child.is_running() for child in ended)


def test_the_sweep_run_of_a_killed_process_is_repeated_once(own):
    listed, killed = jobs(own, settings(["duration=2.0"]), range(4), "one"), list[int]()
    others, rows = workers(), list[Row]()

    def report_done(done: float) -> None:
        if done > 1.0 and not killed:
            killed.append(workers(others=others)[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    on_processes(listed, 2, rows.append, report_done)
    assert len(killed) == 1
    assert sorted((row["run"], row["completed"]) for row in rows) == [(run, True) for run in range(4)]


def workers(parent: int | None = None, others: Sequence[psutil.Process] = ()) -> list[psutil.Process]:
    """Return the processes that a parent has started, without `others` of earlier tests."""
    return [child for child in children(parent, word="spawn_main") if child not in others]


def test_the_worker_processes_of_a_killed_sweep_end(own, environment, tmp_path):
    command = [sys.executable, "-m", "station", "sweep", own, "--seeds", "2", "--jobs", "1", "--set", "duration=3600.0"]
    parent = subprocess.Popen(command, cwd=tmp_path, env=environment)
    try:
        started = until(lambda: workers(parent.pid))
        assert len(started) == 1
    finally:
        parent.kill()
        parent.wait()
    _, left = psutil.wait_procs(started, timeout=NET)
    assert left == []
