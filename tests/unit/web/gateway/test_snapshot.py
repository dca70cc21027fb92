"""Stamps of rows follow the computer's clock and do not depend on when the rows are read."""

import time

import numpy as np
import pytest

from station.control.clock import StationClock
from station.control.ring import HEARTBEAT
from tests.harness.gateway import PAPER, Shown
from web.gateway.snapshot import SnapshotReader, StationInfo

ROBOT = PAPER.robot()


@pytest.fixture
def feed():
    feed = Shown(PAPER)
    yield feed
    feed.ring.close(remove=True)


@pytest.mark.parametrize("rate", [1.0, 0.5])
def test_telemetry_stamps_increase_and_follow_the_computers_clock(feed, rate):
    clock = StationClock(rate)
    reader, stamps, number = SnapshotReader(feed.ring, ROBOT, feed.channels, clock), list[int](), 0
    random = np.random.default_rng(2)
    for _ in range(40):  # at most 0.4 s of rows: a larger jump counts as a restart of the loop
        for _ in range(random.integers(1, 10)):
            feed.ring.write(feed.row(number))
            number += 1
        feed.ring.numbers[HEARTBEAT] = clock.now() - 0.1 * random.random()
        snapshot = reader.read(StationInfo(), with_scene=False)
        assert snapshot.scene is None
        assert len(snapshot.stamps) == len(snapshot.rows)
        stamps += snapshot.stamps.tolist()
    assert len(stamps) == number
    gaps = np.diff(stamps)
    assert np.all(gaps > 0)
    assert np.median(gaps) == pytest.approx(2e6 / rate, rel=0.01)


def test_telemetry_stamps_follow_the_clock_after_a_restart_of_the_control_loop(feed):
    clock = StationClock()
    reader = SnapshotReader(feed.ring, ROBOT, feed.channels, clock)
    for first in (100_000, 0):
        feed.ring.write(feed.row(first))
        feed.ring.numbers[HEARTBEAT] = clock.now()
        snapshot = reader.read(StationInfo(), with_scene=True)
        assert snapshot.scene is not None
        assert abs(time.time_ns() - snapshot.scene.stamp) < 30e9


class SteadyClock:
    """A clock of the station that the test sets."""

    time, rate = 0.0, 1.0

    def now(self) -> float:
        return self.time

    def real(self, seconds: float) -> float:
        return seconds


@pytest.mark.parametrize("step", [0.05, -0.05, 0.7, -0.7, 30.0])
def test_stamps_follow_a_clock_that_was_set_within_a_second(feed, monkeypatch, step):
    clock, since = SteadyClock(), 1.7e9
    monkeypatch.setattr("web.gateway.snapshot.time.time", lambda: since + clock.time)
    reader, number, errors = SnapshotReader(feed.ring, ROBOT, feed.channels, clock), 0, list[float]()
    for reading in range(200):
        for _ in range(10):
            feed.ring.write(feed.row(number))
            number += 1
        clock.time += 0.02
        if reading == 100:
            since += step
        feed.ring.numbers[HEARTBEAT] = clock.time
        newest = reader.read(StationInfo(), with_scene=False).stamps[-1]
        errors.append(1e-9 * newest - (since + clock.time))
    assert np.abs(errors[:100]).max() < 1e-3
    assert np.abs(errors[150:]).max() < 1e-3


def test_a_gateway_snapshot_without_rows_is_empty(feed):
    reader = SnapshotReader(feed.ring, ROBOT, feed.channels, StationClock())
    snapshot = reader.read(StationInfo(), with_scene=True)
    assert snapshot.scene is None
    assert len(snapshot.rows) == 0
