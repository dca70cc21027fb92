"""Linear algebra in one thread, seen in processes that load it."""

import os
import subprocess
import sys

import pytest

from station.threads import NAMES, one_thread_each, one_thread_meanwhile

SCRIPT = "import os, numpy; print(len(os.listdir('/proc/self/task')))"


def threads_of_a_process() -> int:
    return int(subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, check=True).stdout)


@pytest.fixture(autouse=True)
def as_it_was(monkeypatch):
    for name in NAMES:
        monkeypatch.delenv(name, raising=False)


def test_processes_get_no_threads_for_linear_algebra(monkeypatch):
    one_thread_each()
    assert threads_of_a_process() == 1
    for name in NAMES:
        monkeypatch.delenv(name)


def test_what_somebody_has_said_stands(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    one_thread_each()
    assert os.environ["OMP_NUM_THREADS"] == "3"
    for name in NAMES:
        monkeypatch.delenv(name)


def test_meanwhile_is_over_when_it_ends():
    with one_thread_meanwhile():
        assert threads_of_a_process() == 1
    assert not any(name in os.environ for name in NAMES)
