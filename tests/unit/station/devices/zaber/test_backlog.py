"""A backlog of the line is detected by late replies and removed by a pause."""

import pytest

from station.devices.zaber.backlog import LATE_REPLIES, Backlog
from station.devices.zaber.protocol import MESSAGE_TIME_S
from tests.harness.zaber_host import Host, changing


def backlog_after(backlog: Backlog, late: float, times: int = LATE_REPLIES, idle: bool = False) -> float:
    return max(backlog.observe(late, idle) for _ in range(times))


@pytest.fixture
def backlog() -> Backlog:
    backlog = Backlog()
    backlog_after(backlog, 0.001, idle=True)
    return backlog


def test_late_replies_in_a_row_are_a_backlog(backlog):
    assert backlog_after(backlog, 0.010, LATE_REPLIES - 1) == 0.0
    assert backlog.observe(0.010, idle=False) == pytest.approx(0.009)


def test_small_backlog_causes_no_pause(backlog):
    assert backlog_after(backlog, 0.004, 10 * LATE_REPLIES) == 0.0


def test_single_late_replies_are_no_backlog(backlog):
    for number in range(10 * LATE_REPLIES):
        assert backlog.observe(0.001 if number % 8 == 0 else 0.016, idle=False) == 0.0


def test_delay_that_a_pause_does_not_reduce_is_no_backlog(backlog):
    assert backlog_after(backlog, 0.040) > 0.0
    assert backlog_after(backlog, 0.040, 20 * LATE_REPLIES) == 0.0
    # Of a delay of 60 ms, the part above the accepted delay of 40 ms is a backlog.
    assert backlog_after(backlog, 0.060) == pytest.approx(0.020, abs=1e-6)


def test_backlog_is_zero_before_the_line_was_idle():
    assert backlog_after(Backlog(), 0.040) == 0.0


@pytest.fixture
def moving() -> Host:
    host = Host()
    host.run(0.5)
    host.run(1.0, changing(host))
    return host


def test_delayed_line_has_no_backlog_one_second_later(moving):
    moving.held_up(0.030)
    assert moving.behind > 0.025
    moving.run(1.0, changing(moving))
    assert moving.behind < 0.006
    assert not moving.chain.axes.lost


def test_backlog_of_a_slightly_slow_line_stays_small(moving):
    moving.message_time = 1.003 * MESSAGE_TIME_S
    worst, sent = 0.0, len(moving.sent)
    for _ in range(20):
        moving.run(1.0, changing(moving))
        worst = max(worst, moving.behind)
    assert worst < 0.010
    assert not moving.chain.axes.lost
    assert len(moving.sent) - sent > 0.98 * 20.0 * 160
