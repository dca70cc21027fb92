"""The timer probe measures the lateness of the computer's timers; the tests delay the probe on purpose."""

import os
import signal
import time
from collections.abc import Callable

from station.benchmarks.loop import TimerProbe
from tests.harness.children import children


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


def test_timer_probe_counts_wakeups_and_their_lateness():
    with TimerProbe(None) as probe:
        until(lambda: probe.figures()["ticks"] > 100)
        (process,) = children(name="ctr-probe")
        probe.clear()
        os.kill(process.pid, signal.SIGSTOP)
        time.sleep(0.1)
        os.kill(process.pid, signal.SIGCONT)
        until(lambda: probe.figures()["ticks"] > 10)
        figures = probe.figures()
        assert figures["a_period_late"] >= 1
        assert figures["late_us"]["max"] >= 90e3
    assert not process.is_running()
