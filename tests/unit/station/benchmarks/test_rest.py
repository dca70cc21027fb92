"""Processor time and memory of a process and its children."""

import os
import subprocess
import sys

import psutil
import pytest

from station.benchmarks.bench import share_by_folder
from station.benchmarks.rest import processes
from station.config.robots import load_robot

BUSY = "import sys, time\nwhile time.process_time() < 0.5: pass\nprint('done', flush=True)\nsys.stdin.read()"


def test_processor_time_and_memory_of_a_child_are_listed_by_its_name():
    with subprocess.Popen([sys.executable, "-c", BUSY], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"done\n"
        known = psutil.Process(child.pid)
        found = processes(os.getpid())
        assert set(found) >= {"station", known.name()}
        assert found[known.name()].processor == pytest.approx(sum(known.cpu_times()[:2]), abs=0.05)
        assert found[known.name()].processor >= 0.45
        assert found[known.name()].memory == pytest.approx(known.memory_full_info().pss / 2**20, rel=0.05)


def test_share_of_processor_time_counts_for_the_folder_that_calls_a_library():
    load_robot("paper")  # loads compiled code
    shares = share_by_folder(lambda: [load_robot("paper") for _ in range(30)])
    assert next(iter(shares)) == "station/config"
    assert sum(shares.values()) == pytest.approx(1.0)
