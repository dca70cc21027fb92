"""Processor time and memory of a process and its children."""

import os
import subprocess
import sys

import psutil
import pytest

from station.benchmarks.headless import share_by_folder
from station.benchmarks.rest import processes
from station.config.strict import toml_lines

BUSY = """
import sys, time
open("/proc/self/comm", "w").write("busy-child")
while time.process_time() < 0.5: pass
print("done", flush=True)
sys.stdin.read()
"""


def test_processor_time_and_memory_of_a_child_are_listed_by_its_name():
    with subprocess.Popen([sys.executable, "-c", BUSY], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"done\n"
        known = psutil.Process(child.pid)
        found = processes(os.getpid())
        assert set(found) >= {"station", "busy-child"}
        assert found["busy-child"].processor == pytest.approx(sum(known.cpu_times()[:2]), abs=0.05)
        assert found["busy-child"].processor >= 0.45
        assert found["busy-child"].memory == pytest.approx(known.memory_full_info().pss / 2**20, rel=0.05)


def test_share_of_processor_time_counts_for_the_folder_that_calls_a_library():
    settings = {f"key_{number}": f"text {number}" for number in range(200_000)}
    shares = share_by_folder(lambda: "\n".join(toml_lines(settings)))  # uses only its folder and libraries
    assert set(shares) <= {"station/config", "station/benchmarks"}
    assert shares["station/config"] > 0.5
    assert sum(shares.values()) == pytest.approx(1.0)
