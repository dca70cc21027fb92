"""Times of samples from their numbers and arrivals: jitter, drift, losses, restarts, wrap-around, and wrong rates."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from core.compiled import PREPARED
from core.robot.robot import Array, Indices
from station.devices.kernel.sampled import SampleClock, latest, observe

DRIFT = 1e-3
#: Error of a time by the rounding of the clock's numbers, and smallest distance of two times [s].
ROUNDING_S = 5e-6

seeds = st.integers(0, 2**32 - 1)
rates = st.sampled_from([30.0, 40.0, 500.0])
jitters = st.floats(0.0, 0.015)


def arrivals(seed: int, rate: float, seconds: float, jitter: float, lost: float = 0.0) -> tuple[Indices, Array, Array]:
    """Return numbers, times and arrivals of samples in the order of their arrival; some are delayed for long."""
    random = np.random.default_rng(seed)
    counts = np.arange(round(seconds * rate))
    counts = counts[random.random(len(counts)) >= lost]
    delays = random.exponential(jitter, len(counts)).clip(0.0, 0.03)
    times = counts / rate
    return counts, times, np.maximum.accumulate(times + delays)


@given(seeds, rates, st.floats(-DRIFT, DRIFT), jitters, st.floats(0.0, 0.5))
def test_times_are_never_early_and_late_by_at_most_the_smallest_delay_in_a_second(seed, rate, drift, jitter, lost):
    clock = SampleClock(rate, DRIFT)
    counts, times, received = arrivals(seed, rate * (1.0 + drift), 8.0, jitter, lost)
    found = np.array([clock.measured(int(n), float(t)) for n, t in zip(counts, received, strict=True)])

    assert (found - times).min() >= -ROUNDING_S
    for i in range(len(times)):
        window = received > received[i] - 1.0
        smallest = (received - times)[window][: np.count_nonzero(window[: i + 1])].min()
        assert found[i] - times[i] <= smallest + 2.1 * DRIFT + ROUNDING_S
    assert all(a < b for a, b in pairwise(found))
    assert clock.wrong_rate is None


@given(seeds, st.floats(-DRIFT, DRIFT), st.integers(0, 200))
def test_compiled_clock_gives_the_times_of_the_plain_one(seed, drift, first):
    plain, fast = SampleClock(500.0, DRIFT, 0.001), SampleClock(500.0, DRIFT, 0.001)
    counts, _, received = arrivals(seed, 500.0 * (1.0 + drift), 3.0, 0.001)
    for n, t in zip((counts + first).tolist(), received.tolist(), strict=True):
        assert observe(fast.state, n, t) == pytest.approx(plain.observe(n, t), abs=1e-12)
        assert latest(fast.state, t) == pytest.approx(plain.latest(t), abs=1e-6)


@given(seeds, st.integers(1, 2000), st.sampled_from([8, 16, 32]))
def test_counter_that_wraps_around_changes_no_time(seed, before, bits):
    counts, times, received = arrivals(seed, 40.0, 20.0, 0.005, 0.2)
    clock, wrap = SampleClock(40.0, DRIFT, wrap=1 << bits), 1 << bits
    for n, time, arrival in zip(counts.tolist(), times.tolist(), received.tolist(), strict=True):
        found = clock.measured((wrap - before + n) % wrap, arrival)
        assert found is not None
        assert -ROUNDING_S <= found - time <= 0.031


@given(seeds, st.floats(0.5, 20.0), st.integers(0, 10**6), st.floats(-DRIFT, DRIFT))
def test_restarted_counter_is_accepted_within_five_samples_and_gives_no_early_time(seed, pause, first, drift):
    clock, rate = SampleClock(40.0, DRIFT), 40.0 * (1.0 + drift)
    counts, times, received = arrivals(seed, rate, 4.0, 0.003)
    for n, arrival in zip((counts + 10**6 + 300).tolist(), received.tolist(), strict=True):
        clock.measured(n, arrival)
    start = received[-1] + pause
    found = [clock.measured(n + first, start + t) for n, t in zip(counts.tolist(), received.tolist(), strict=True)]

    assert found.count(None) <= 5
    assert all(time is None or time >= start + true - ROUNDING_S for time, true in zip(found, times, strict=True))
    assert clock.wrong_rate is None


@given(seeds, st.floats(np.log(0.02), np.log(50.0)).map(np.exp).filter(lambda f: not 0.97 < f < 1.03), jitters)
@example(0, np.exp(-0.4375), 0.0078125)
def test_wrong_rate_is_named_and_later_times_are_never_early(seed, factor, jitter):
    clock, rate = SampleClock(40.0, 5e-4), 40.0 * float(factor)
    counts, times, received = arrivals(seed, rate, max(20.0, 12.0 / rate), jitter)
    # The computer requests at most 40 samples a second.
    step = max(1, round(factor))
    named = False
    for n, time, arrival in zip(counts[::step].tolist(), times[::step], received[::step].tolist(), strict=True):
        named = named or clock.wrong_rate is not None
        found = clock.measured(n, arrival)
        assert not named or found is None or time - ROUNDING_S <= found <= arrival + ROUNDING_S

    assert clock.wrong_rate == pytest.approx(rate, rel=0.05)


@pytest.mark.parametrize("rate", [39.0, 39.8, 39.9, 40.1, 40.8])
def test_small_error_of_the_rate_never_makes_a_time_early_by_more_than_a_tenth_of_a_second(rate):
    clock = SampleClock(40.0, 5e-4)
    counts, times, received = arrivals(1, rate, 300.0, 0.004)
    found = np.array([clock.measured(int(n), float(t)) for n, t in zip(counts, received, strict=True)])

    assert (found - times).min() > -0.15
    assert (found - times)[len(found) // 2 :].min() > -0.05
    assert (clock.wrong_rate is not None) == (abs(rate / 40.0 - 1.0) > 0.01)


def test_messages_that_are_late_for_some_seconds_keep_the_times_of_their_samples():
    clock = SampleClock(40.0, 5e-4)
    for n in range(4000):
        late = 0.015 if 1000 < n < 1100 else 0.3 if 2000 < n < 2100 else 0.0
        found = clock.measured(n, n / 40.0 + late)
        assert found == pytest.approx(n / 40.0, abs=3e-3)
    assert clock.wrong_rate is None


def test_late_first_message_does_not_shift_later_times():
    clock = SampleClock(40.0, 5e-4)
    clock.measured(0, 0.9)
    assert [clock.measured(n, n / 40.0) for n in range(40, 60)][-1] == pytest.approx(59 / 40.0)


def test_counter_that_pauses_shifts_the_clock_within_some_seconds():
    clock = SampleClock(40.0, 5e-4)
    found = [clock.measured(n, n / 40.0 + (0.4 if n > 200 else 0.0)) for n in range(800)]
    assert found[-1] == pytest.approx(799 / 40.0 + 0.4, abs=1e-3)


def test_a_delay_that_stays_is_a_shift_until_it_ends():
    clock, random = SampleClock(40.0, 5e-4), np.random.default_rng(2)
    shifts = []
    for n in range(16_000):
        delay = 0.06 if 4_000 < n < 12_000 else 0.0
        clock.measured(n, 1.0001 * n / 40.0 + delay + random.exponential(0.003))
        shifts.append(clock.shift)
    assert max(shifts[:4_000]) == 0.0
    assert shifts[4_000 + 40 * 10 : 12_000] == pytest.approx([0.06] * len(shifts[4_400:12_000]), abs=0.015)
    assert max(shifts[12_000 + 40 * 2 :]) < 0.015


@pytest.mark.parametrize("wrong", [5, 99, 104, 2**31])
def test_impossible_count_is_refused_without_effect(wrong):
    clock = SampleClock(40.0, 5e-4, wrap=1 << 32)
    for n in range(100):
        clock.measured(n, n / 40.0)
    assert clock.measured(wrong, 2.501) is None
    assert clock.measured(101, 101 / 40.0) == pytest.approx(101 / 40.0, abs=1e-4)


def test_latency_is_subtracted():
    clock = SampleClock(40.0, 5e-4, latency=0.02)
    assert [clock.measured(n, n / 40.0) for n in (0, 1)] == pytest.approx([-0.02, 0.005])


def test_largest_count_includes_the_drift_since_the_last_least_delayed_sample():
    clock = SampleClock(100.0, 0.01)
    clock.observe(100, 1.0)
    assert clock.latest(2.0) == pytest.approx(200.0 + 2.0)
    assert clock.doubt(2.0) == pytest.approx(0.02)


@pytest.mark.parametrize("kind", [int, float])
def test_no_code_is_loaded_after_a_clock_was_created(kind):
    """Loading takes longer than a tick of the control loop."""
    clock, wrapped = SampleClock(40.0, 1e-4), SampleClock(40.0, 1e-4, wrap=1 << 16)
    known = len(PREPARED)
    for sample in range(2000):
        for one in (clock, wrapped):
            one.observe(kind(sample), sample / 40.0)
            one.latest(sample / 40.0)
    assert PREPARED[known:] == []
