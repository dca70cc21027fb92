"""Virtual time never waits; real time keeps absolute deadlines; a station's time may be slower."""

import time

import pytest

from station.control.clock import REAL_TIME, RealClock, StationClock, VirtualClock


class WallTime:
    """A wall clock that only goes on when somebody sleeps or works."""

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


def test_a_slow_stations_seconds_are_longer(wall):
    clock = StationClock(0.2)
    begin = clock.now()
    clock.sleep(1.0)

    assert wall.slept == [5.0]
    assert clock.now() - begin == pytest.approx(1.0)
    assert clock.real(1.0) == 5.0


@pytest.mark.parametrize("reading", [0.1, 12345.678901234567, 9.87654321e8])
def test_a_station_in_real_time_has_the_computers_own_clock_to_the_last_bit(wall, reading):
    wall.now = reading
    assert REAL_TIME.now() == reading
    assert REAL_TIME.real(reading) == reading
