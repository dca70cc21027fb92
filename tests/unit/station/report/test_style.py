"""Lines that keep their peaks, and looks that stay apart."""

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from station.report import style


def test_a_long_line_keeps_its_ends_and_every_peak():
    rng = np.random.default_rng(1)
    values = rng.standard_normal(100_000)
    values[54_321], values[77_777] = 30.0, -40.0
    times, thin = style.thinned(np.arange(100_000) * 0.002, values)

    assert len(thin) < 2.2 * style.PIECES
    assert (thin.max(), thin.min()) == (30.0, -40.0)
    assert times[thin.argmax()] == pytest.approx(54_321 * 0.002)
    assert (np.diff(times) > 0.0).all()
    assert (times[0], times[-1]) == (0.0, pytest.approx(99_999 * 0.002))
    # whatever was thrown away lies between two neighbours that were kept
    assert np.interp(times, np.arange(100_000) * 0.002, values) == pytest.approx(thin)


def test_a_short_line_stays_whole():
    times, values = np.arange(2000.0), np.arange(2000.0) ** 2
    assert np.array_equal(style.thinned(times, values)[1], values)


@pytest.mark.parametrize("length", [0, 1, 2801, 2999])
def test_any_length_can_be_thinned(length):
    times = np.arange(float(length))
    assert len(style.thinned(times, times)[0]) <= length


def test_means_over_pieces():
    times, values = style.averaged(np.arange(10) * 0.1, np.arange(10.0), 0.5)

    assert values == pytest.approx([2.0, 7.0])
    assert times == pytest.approx([0.2, 0.7])


def test_a_line_shorter_than_a_piece_has_no_mean():
    assert len(style.averaged(np.arange(3) * 0.1, np.arange(3.0), 0.5)[0]) == 0


def grey(colour: str) -> float:
    return float(np.dot(to_rgb(colour), (0.2126, 0.7152, 0.0722)))


@pytest.mark.parametrize(
    "looks",
    [
        style.SERIES,
        (style.MEASURED, style.LOADED, style.UNLOADED),
        (style.SAMPLES, style.FILTERED, style.TRUE),
        (style.MEASURED, style.TRUE, style.BOUND),
    ],
)
def test_lines_of_one_figure_differ_without_their_colours(looks):
    for one, other in itertools.combinations(looks, 2):
        assert one.dash != other.dash or one.width != other.width or abs(grey(one.colour) - grey(other.colour)) > 0.15
