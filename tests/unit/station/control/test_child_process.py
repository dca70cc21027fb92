"""The station process is alive if its heartbeat changes, or if the kernel has counted processor time for it."""

import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from station.control.child_process import StationLife
from station.control.clock import REAL_TIME_CLOCK
from station.control.ring import STATION_HEARTBEAT, Ring
from tests.harness.waiting import until


@pytest.fixture
def ring() -> Iterator[Ring]:
    ring = Ring(1)
    ring.numbers[STATION_HEARTBEAT] = REAL_TIME_CLOCK.now()
    yield ring
    ring.close(remove=True)


def test_silent_station_process_that_uses_processor_time_is_alive_until_it_is_suspended(ring: Ring) -> None:
    works = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        life = StationLife(ring, REAL_TIME_CLOCK, works.pid)
        until(lambda: life.standstill() < 0.5 and life.silence > 2.0)
        works.send_signal(signal.SIGSTOP)
        until(lambda: life.standstill() > 1.0)
        works.send_signal(signal.SIGCONT)
        until(lambda: life.standstill() < 0.5)
    finally:
        works.kill()
        works.wait()


def test_silent_station_process_without_processor_time_is_stalled(ring: Ring) -> None:
    waits = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        life = StationLife(ring, REAL_TIME_CLOCK, waits.pid)
        until(lambda: life.standstill() > 1.0)
        ring.numbers[STATION_HEARTBEAT] = REAL_TIME_CLOCK.now()
        assert life.standstill() < 1.0
    finally:
        waits.communicate()


def test_only_the_heartbeat_counts_if_the_kernel_reports_no_processor_time(ring: Ring) -> None:
    life = StationLife(ring, REAL_TIME_CLOCK, 2**22 + 1)  # no process has this pid
    until(lambda: life.standstill() > 1.0)
