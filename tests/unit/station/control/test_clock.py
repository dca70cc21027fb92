"""Clocks: virtual time never waits, real time keeps absolute deadlines, and a station's clock may be slower."""

import time

import pytest

from station.control.clock import REAL_TIME_CLOCK, RealClock, StationClock, VirtualClock


class WallTime:
    """A wall clock that advances only by sleep or work."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.slept: list[float] = []

    def tells(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


@pytest.fixture
def wall(monkeypatch) -> WallTime:
    wall = WallTime()
    for name in ("perf_counter", "monotonic"):
        monkeypatch.setattr(time, name, wall.tells)
    monkeypatch.setattr(time, "sleep", wall.sleep)
    return wall


def test_virtual_time_never_sleeps(wall):
    clock = VirtualClock()
    for due in (0.0, 1.0, 1e6):
        clock.wait_until(due)

    assert wall.slept == []


def test_real_time_sleeps_until_each_deadline(wall):
    clock = RealClock()
    for tick in range(4):
        clock.wait_until(0.002 * tick)

    assert wall.slept == pytest.approx([0.002] * 3)


def test_real_clock_sleeps_less_after_work_and_its_lateness_does_not_add_up(wall):
    clock = RealClock()
    clock.wait_until(0.0)
    wall.now += 0.0015
    clock.wait_until(0.002)
    wall.now += 0.005  # this work lasts beyond the deadlines at 4 and 6 ms
    clock.wait_until(0.004)
    clock.wait_until(0.006)
    clock.wait_until(0.008)

    assert wall.slept == pytest.approx([0.0005, 0.001])
    assert wall.now == pytest.approx(1000.008)


def test_first_wait_of_a_real_clock_sets_its_start_for_any_deadline(wall):
    clock = RealClock()
    clock.wait_until(5.0)
    clock.wait_until(5.002)

    assert wall.slept == pytest.approx([0.002])


def test_second_of_a_slow_station_clock_lasts_longer_than_a_real_second(wall):
    clock = StationClock(0.2)
    start = clock.now()
    clock.sleep(1.0)

    assert wall.slept == [5.0]
    assert clock.now() - start == pytest.approx(1.0)
    assert clock.real(1.0) == 5.0


@pytest.mark.parametrize("reading", [0.1, 12345.678901234567, 9.87654321e8])
def test_station_clock_with_rate_one_equals_the_computers_clock(wall, reading):
    wall.now = reading
    assert REAL_TIME_CLOCK.now() == reading
    assert REAL_TIME_CLOCK.real(reading) == reading
