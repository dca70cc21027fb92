"""A line that falls behind is noticed by its late replies and given the time to catch up."""

import pytest

from station.devices.zaber.backlog import REPLIES, Backlog
from station.devices.zaber.protocol import MESSAGE_TIME
from tests.harness.zaber_host import Host, changing


def heard(backlog: Backlog, late: float, times: int = REPLIES, idle: bool = False) -> float:
    return max(backlog.heard(late, idle) for _ in range(times))


@pytest.fixture
def backlog() -> Backlog:
    backlog = Backlog()
    heard(backlog, 0.001, idle=True)
    return backlog


def test_replies_that_are_late_one_after_the_other_are_a_backlog(backlog):
    assert heard(backlog, 0.010, REPLIES - 1) == 0.0
    assert backlog.heard(0.010, idle=False) == pytest.approx(0.009)


def test_a_little_is_not_worth_a_pause(backlog):
    assert heard(backlog, 0.004, 10 * REPLIES) == 0.0


def test_single_replies_that_an_adapter_holds_back_are_none(backlog):
    for number in range(10 * REPLIES):
        assert backlog.heard(0.001 if number % 8 == 0 else 0.016, idle=False) == 0.0


def test_what_a_pause_does_not_make_better_is_no_backlog(backlog):
    assert heard(backlog, 0.040) > 0.0
    assert heard(backlog, 0.040, 20 * REPLIES) == 0.0
    # What comes on top of it is one.
    assert heard(backlog, 0.060) == pytest.approx(0.020, abs=1e-6)


def test_before_a_line_was_ever_idle_nothing_can_be_said():
    assert heard(Backlog(), 0.040) == 0.0


@pytest.fixture
def moving() -> Host:
    host = Host()
    host.run(0.5)
    host.run(1.0, changing(host))
    return host


def test_a_line_that_was_held_up_once_has_caught_up_a_second_later(moving):
    moving.held_up(0.030)
    assert moving.behind > 0.025
    moving.run(1.0, changing(moving))
    assert moving.behind < 0.006
    assert not moving.chain.lost


def test_a_line_that_runs_a_little_slower_than_the_host_counts_never_falls_far_behind(moving):
    moving.message_time = 1.003 * MESSAGE_TIME
    worst, sent = 0.0, len(moving.sent)
    for _ in range(60):
        moving.run(1.0, changing(moving))
        worst = max(worst, moving.behind)
    assert worst < 0.010
    assert not moving.chain.lost
    assert len(moving.sent) - sent > 0.98 * 60.0 * 160
