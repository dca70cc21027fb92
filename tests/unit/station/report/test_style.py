"""Thinned lines keep their peaks, and line styles stay distinguishable."""

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from station.report import style


def test_thinning_a_long_line_keeps_its_ends_and_every_peak():
    rng = np.random.default_rng(1)
    values = rng.standard_normal(100_000)
    values[54_321], values[77_777] = 30.0, -40.0
    times, thin = style.thinned(np.arange(100_000) * 0.002, values)

    assert len(thin) < 2.2 * style.LINE_BINS
    assert (thin.max(), thin.min()) == (30.0, -40.0)
    assert times[thin.argmax()] == pytest.approx(54_321 * 0.002)
    assert (np.diff(times) > 0.0).all()
    assert (times[0], times[-1]) == (0.0, pytest.approx(99_999 * 0.002))
    # Every dropped point is on the straight line between two points that were kept.
    assert np.interp(times, np.arange(100_000) * 0.002, values) == pytest.approx(thin)
    assert np.array_equal(style.thinned(np.arange(2000.0), values[:2000])[1], values[:2000])  # short enough


@pytest.mark.parametrize("length", [0, 1, 2801, 2999])
def test_lines_of_any_length_can_be_thinned(length):
    times = np.arange(float(length))
    assert len(style.thinned(times, times)[0]) <= length


def test_averaged_returns_means_over_equal_time_intervals():
    times, values = style.averaged(np.arange(10) * 0.1, np.arange(10.0), 0.5)

    assert values == pytest.approx([2.0, 7.0])
    assert times == pytest.approx([0.2, 0.7])
    assert len(style.averaged(np.arange(3) * 0.1, np.arange(3.0), 0.5)[0]) == 0  # shorter than one interval


def grey(colour: str) -> float:
    return float(np.dot(to_rgb(colour), (0.2126, 0.7152, 0.0722)))


@pytest.mark.parametrize(
    "styles",
    [
        style.SERIES,
        (style.MEASURED, style.LOADED, style.UNLOADED),
        (style.SAMPLES, style.FILTERED, style.TRUE),
        (style.MEASURED, style.TRUE, style.BOUND),
    ],
)
def test_the_lines_of_a_figure_are_distinguishable_in_grey_prints(styles):
    for one, other in itertools.combinations(styles, 2):
        assert one.dash != other.dash or one.width != other.width or abs(grey(one.colour) - grey(other.colour)) > 0.15
