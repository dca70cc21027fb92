"""When rows happened, by the computer's clock, however late they are looked at."""

import time

import numpy as np
import pytest

from station.control.clock import StationClock
from station.control.ring import HEARTBEAT
from tests.harness.gateway import PAPER, Shown
from web.gateway.seen import Eyes, Told

ROBOT = PAPER.robot()


@pytest.fixture
def feed():
    feed = Shown(PAPER)
    yield feed
    feed.ring.close(remove=True)


@pytest.mark.parametrize("rate", [1.0, 0.5])
def test_stamps_never_go_back_and_are_of_now(feed, rate):
    clock = StationClock(rate)
    eyes, stamps, number = Eyes(feed.ring, ROBOT, feed.channels, clock), list[int](), 0
    random = np.random.default_rng(2)
    for _ in range(40):  # 0.4 s of rows at once: more would be another loop
        for _ in range(random.integers(1, 10)):
            feed.ring.write(feed.row(number))
            number += 1
        feed.ring.numbers[HEARTBEAT] = clock.now() - 0.1 * random.random()
        look = eyes.look(Told(), wanted=False)
        assert look.seen is None
        assert len(look.stamps) == len(look.rows)
        stamps += look.stamps.tolist()
    assert len(stamps) == number
    gaps = np.diff(stamps)
    assert np.all(gaps > 0)
    assert np.median(gaps) == pytest.approx(2e6 / rate, rel=0.01)


def test_another_loop_counts_from_its_own_beginning(feed):
    clock = StationClock()
    eyes = Eyes(feed.ring, ROBOT, feed.channels, clock)
    for first in (100_000, 0):
        feed.ring.write(feed.row(first))
        feed.ring.numbers[HEARTBEAT] = clock.now()
        look = eyes.look(Told(), wanted=True)
        assert look.seen is not None
        assert abs(time.time_ns() - look.seen.stamp) < 30e9


def test_without_rows_there_is_nothing(feed):
    eyes = Eyes(feed.ring, ROBOT, feed.channels, StationClock())
    look = eyes.look(Told(), wanted=True)
    assert look.seen is None
    assert len(look.rows) == 0
