"""Number of threads of linear algebra libraries, measured in child processes."""

import os
import subprocess
import sys

import pytest

from station.threads import THREAD_VARIABLES, limit_to_one_thread, one_thread_during

SCRIPT = "import os, numpy; print(len(os.listdir('/proc/self/task')))"


def threads_of_a_process() -> int:
    return int(subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, check=True).stdout)


@pytest.fixture(autouse=True)
def clean_environment(monkeypatch):
    for name in THREAD_VARIABLES:
        monkeypatch.delenv(name, raising=False)


def test_child_process_has_one_thread_for_linear_algebra(monkeypatch):
    limit_to_one_thread()
    assert threads_of_a_process() == 1
    for name in THREAD_VARIABLES:
        monkeypatch.delenv(name)


def test_number_of_linear_algebra_threads_in_the_environment_is_kept(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    limit_to_one_thread()
    assert os.environ["OMP_NUM_THREADS"] == "3"
    for name in THREAD_VARIABLES:
        monkeypatch.delenv(name)


def test_thread_limit_restores_the_environment_after_its_block():
    with one_thread_during():
        assert threads_of_a_process() == 1
    assert not any(name in os.environ for name in THREAD_VARIABLES)
