"""Samples of several sensors brought to one time, by straight lines between them."""

import numpy as np
import pytest

from station.devices.netft.history import DEPTH, History

SCALE = np.array([[1.0] * 6, [0.5] * 6])


def fill(history: History, sensor: int, times: np.ndarray) -> None:
    """Counts that rise with time, each axis at its own rate."""
    ring = history.ring(sensor)
    for time in times:
        ring.row[:] = time, *(time * np.arange(1.0, 7.0) * 100.0)
        ring.push()


def test_between_two_samples_each_sensor_is_read_on_the_line():
    history = History(SCALE)
    fill(history, 0, np.arange(200) * 0.002)
    fill(history, 1, 0.0007 + np.arange(200) * 0.00186)

    for time in np.linspace(0.3, 0.36, 37):
        expected = np.outer([1.0, 0.5], time * np.arange(1.0, 7.0) * 100.0)
        assert history.at(time) == pytest.approx(expected, rel=1e-12)


def test_beyond_the_newest_and_before_the_oldest_kept_sample_these_stand():
    history = History(SCALE)
    fill(history, 0, np.arange(1000) * 0.001)
    fill(history, 1, np.array([0.5]))

    assert history.at(5.0)[:, 0] == pytest.approx([99.9, 25.0])
    assert history.at(0.0)[:, 0] == pytest.approx([(1000 - DEPTH) * 0.1, 25.0])


def test_a_clock_that_is_set_back_does_not_turn_time_round():
    history = History(SCALE)
    ring = history.ring(0)
    fill(history, 1, np.array([0.0]))
    for time, counts in ((1.0, 10.0), (0.9995, 20.0), (1.01, 30.0)):
        ring.row[:] = time, *[counts] * 6
        ring.push()
        assert ring.time == max(1.0, time)

    assert history.at(1.0)[0, 0] == 20.0
    assert history.at(1.005)[0, 0] == pytest.approx(25.0)


def test_a_ring_that_was_cleared_has_nothing():
    history = History(SCALE)
    ring = history.ring(0)
    fill(history, 0, np.array([1.0, 2.0]))
    ring.clear()

    assert ring.time == -np.inf
