"""Virtual time never waits; real time keeps absolute deadlines."""

import time

import pytest

from station.clock import RealClock, VirtualClock


class WallTime:
    """A wall clock that only goes on when somebody sleeps or works."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.slept: list[float] = []

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


@pytest.fixture
def wall(monkeypatch) -> WallTime:
    wall = WallTime()
    monkeypatch.setattr(time, "perf_counter", wall.perf_counter)
    monkeypatch.setattr(time, "sleep", wall.sleep)
    return wall


def test_virtual_time_never_sleeps(wall):
    clock = VirtualClock()
    for due in (0.0, 1.0, 1e6):
        clock.wait_until(due)

    assert wall.slept == []


def test_real_time_sleeps_up_to_each_deadline(wall):
    clock = RealClock()
    for tick in range(4):
        clock.wait_until(0.002 * tick)

    assert wall.slept == pytest.approx([0.002] * 3)


def test_work_in_a_tick_shortens_the_sleep_and_lateness_does_not_add_up(wall):
    clock = RealClock()
    clock.wait_until(0.0)
    wall.now += 0.0015
    clock.wait_until(0.002)
    wall.now += 0.005  # past the deadlines at 4 and 6 ms
    clock.wait_until(0.004)
    clock.wait_until(0.006)
    clock.wait_until(0.008)

    assert wall.slept == pytest.approx([0.0005, 0.001])
    assert wall.now == pytest.approx(1000.008)


def test_the_first_wait_sets_the_start_whatever_time_it_is_for(wall):
    clock = RealClock()
    clock.wait_until(5.0)
    clock.wait_until(5.002)

    assert wall.slept == pytest.approx([0.002])
