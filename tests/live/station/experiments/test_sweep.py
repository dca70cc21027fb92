"""A sweep that is ended by force leaves no process."""

import os
import signal
import subprocess
import sys
import threading
import time

import psutil
import pytest

from station.experiments.sweep import jobs, sweep
from station.experiments.sweep_settings import settings
from tests.harness.waiting import NET, until


@pytest.fixture
def own(write, short):
    """A second at rest, two cases."""
    return str(write(short + "[cases.one]\n[cases.two.controller]\nfeedforward = true\n"))


def test_ctrl_c_ends_the_runs_that_are_on_and_leaves_out_the_others(own):
    listed = jobs(own, settings(["duration=3600.0"]), range(4), "one")
    children: list[psutil.Process] = []

    def press() -> None:
        while not children:
            children[:] = workers(psutil.Process())
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    presser = threading.Thread(target=press)
    presser.start()
    outcomes = sweep(listed, 1, lambda _: None)
    presser.join()

    # the one that was on and the one that was next in the line
    assert 1 <= len(outcomes) <= 2
    assert {outcome.numbers["cause"] for outcome in outcomes} == {"interrupted"}
    assert not any(child.is_running() for child in children)


def workers(parent: psutil.Process) -> list[psutil.Process]:
    return [child for child in parent.children() if "spawn_main" in " ".join(child.cmdline())]


def test_when_the_sweep_is_killed_its_processes_end_too(own, environment, tmp_path):
    command = [sys.executable, "-m", "station", "sweep", own, "--seeds", "2", "--jobs", "1", "--set", "duration=3600.0"]
    parent = subprocess.Popen(command, cwd=tmp_path, env=environment)
    try:
        children = until(lambda: workers(psutil.Process(parent.pid)))
        assert len(children) == 1
    finally:
        parent.kill()
        parent.wait()
    _, left = psutil.wait_procs(children, timeout=NET)
    assert left == []
