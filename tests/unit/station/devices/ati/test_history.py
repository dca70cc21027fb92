"""Samples of several sensors, interpolated linearly at one time."""

import numpy as np
import pytest

from station.devices.ati.netft import HISTORY_SAMPLES, SampleHistory

SCALE = np.array([[1.0] * 6, [0.5] * 6])


def fill(history: SampleHistory, sensor: int, times: np.ndarray) -> None:
    """Return counts that increase with time, each axis at a different rate."""
    ring = history.ring(sensor)
    for time in times:
        ring.row[:] = time, *(time * np.arange(1.0, 7.0) * 100.0)
        ring.push()


def test_sensors_are_interpolated_linearly_between_samples():
    history = SampleHistory(SCALE)
    fill(history, 0, np.arange(200) * 0.002)
    fill(history, 1, 0.0007 + np.arange(200) * 0.00186)

    for time in np.linspace(0.3, 0.36, 37):
        expected = np.outer([1.0, 0.5], time * np.arange(1.0, 7.0) * 100.0)
        assert history.at(time) == pytest.approx(expected, rel=1e-12)


def test_newest_and_oldest_sample_apply_outside_the_history():
    history = SampleHistory(SCALE)
    fill(history, 0, np.arange(1000) * 0.001)
    fill(history, 1, np.array([0.5]))

    assert history.at(5.0)[:, 0] == pytest.approx([99.9, 25.0])
    assert history.at(0.0)[:, 0] == pytest.approx([(1000 - HISTORY_SAMPLES) * 0.1, 25.0])


def test_sample_times_do_not_decrease_when_the_clock_is_corrected():
    history = SampleHistory(SCALE)
    ring = history.ring(0)
    fill(history, 1, np.array([0.0]))
    for time, counts in ((1.0, 10.0), (0.9995, 20.0), (1.01, 30.0)):
        ring.row[:] = time, *[counts] * 6
        ring.push()
        assert ring.time == max(1.0, time)

    assert history.at(1.0)[0, 0] == 20.0
    assert history.at(1.005)[0, 0] == pytest.approx(25.0)


def test_cleared_ring_has_no_samples():
    history = SampleHistory(SCALE)
    ring = history.ring(0)
    fill(history, 0, np.array([1.0, 2.0]))
    ring.clear()

    assert ring.time == -np.inf
