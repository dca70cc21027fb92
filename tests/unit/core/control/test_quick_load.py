"""The force's filter opens for a load that moves and for nothing else."""

import math

import numpy as np
import pytest

from core.control.deflection import RateFilter, filtered
from core.control.quick_load import Opening, opened
from core.errors import DescriptionError

PERIOD = 0.002
OPENING = Opening(widest=16.0)


def follow(force: np.ndarray, opening: Opening = OPENING, bandwidth: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """How wide it was (k,), and the filtered force along the first axis (k,), for forces (k, 3) [N]."""
    k_value, k_rate = RateFilter(PERIOD, bandwidth).gain
    wide, surprise, value, rate = 1.0, np.zeros(3), force[0].copy(), np.zeros(3)
    widths, values = [], []
    for measured in force:
        now = np.empty(3)
        wide = opened(wide, surprise, measured, value, rate, now, PERIOD, *opening.settings(PERIOD))
        surprise, new_value, new_rate = now, np.empty(3), np.empty(3)
        filtered(value, rate, measured, new_value, new_rate, PERIOD, wide * k_value, wide**2 * k_rate)
        value, rate = new_value, new_rate
        widths.append(wide)
        values.append(value[0])
    return np.array(widths), np.array(values)


def noise(seconds: float, size: float = OPENING.noise, seed: int = 3) -> np.ndarray:
    return size * np.random.default_rng(seed).normal(size=(round(seconds / PERIOD), 3))


def ramp(seconds: float, start: float, rise: float, height: float = 0.5) -> np.ndarray:
    """(k,) [N]."""
    return height * np.clip((PERIOD * np.arange(round(seconds / PERIOD)) - start) / rise, 0.0, 1.0)


def test_noise_alone_opens_it_less_than_once_in_ten_seconds():
    widths, _ = follow(noise(100.0))
    openings = np.flatnonzero((widths[1:] > 1.0) & (widths[:-1] == 1.0))
    assert len(openings) < 10


def test_a_slow_load_leaves_it_closed():
    """A raised cosine of 0.5 N in 20 s, as in the paper's experiments."""
    force = noise(20.0, 0.0)
    force[:, 0] = 0.25 * (1.0 - np.cos(2.0 * math.pi * PERIOD * np.arange(len(force)) / 20.0))
    widths, _ = follow(force)
    assert widths.max() == 1.0


@pytest.mark.parametrize("rise", [0.05, 0.5, 1.0])
def test_a_quick_load_is_followed_and_it_closes_again(rise):
    force = noise(6.0)
    force[:, 0] += ramp(6.0, 1.0, rise)
    widths, values = follow(force)
    _, slow = follow(force, Opening(widest=1.0))
    true = ramp(6.0, 1.0, rise)
    end = round((1.0 + rise) / PERIOD)
    assert np.abs(values - true)[end + 100 :].max() < 0.1  # from 0.2 s after its end on
    assert np.abs(values - true).max() <= np.abs(slow - true).max()
    assert np.abs(values - true)[round(1.0 / PERIOD) :].mean() < 0.5 * np.abs(slow - true)[round(1.0 / PERIOD) :].mean()
    assert widths.max() > 4.0
    assert widths[-500:].max() < 1.5


def test_where_it_never_opens_it_is_the_steady_filter():
    force = noise(3.0)
    force[:, 0] += ramp(3.0, 1.0, 0.1)
    widths, values = follow(force, Opening(widest=1.0))
    steady, last = RateFilter(PERIOD, 0.5), None
    for measured in force:
        last = steady.start(measured) if last is None else steady.update(last, measured)
    assert last is not None
    assert (widths == 1.0).all()
    assert values[-1] == pytest.approx(last.value[0], abs=1e-12)


def test_an_open_filter_is_nearly_the_kalman_filter_of_that_bandwidth():
    """Its gains grow with the bandwidth and its square; filterpy's are computed for the bandwidth itself."""
    closed, wide = RateFilter(PERIOD, 0.5).gain, RateFilter(PERIOD, 4.0).gain
    assert 8.0 * closed[0] == pytest.approx(wide[0], rel=0.05)
    assert 64.0 * closed[1] == pytest.approx(wide[1], rel=0.05)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"noise": 0.0}, "noise 0 N"),
        ({"widest": 0.5}, "widest 0.5 times"),
        ({"widest": math.nan}, "widest nan times"),
        ({"release": 0.0}, "release 0 s"),
    ],
)
def test_an_impossible_opening_is_refused_by_name_value_and_unit(change, words):
    with pytest.raises(DescriptionError, match=f"force filter: {words} must be finite and at least"):
        Opening(**change)
