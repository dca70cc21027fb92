"""Times of frames from the lower envelope of their arrival times; rejection of impossible positions."""

import numpy as np
import pytest

from station.devices.aurora.session import FrameClock
from station.devices.jump_gate import JumpGate


def test_late_replies_do_not_move_the_time_of_a_frame():
    rng = np.random.default_rng(0)
    clock = FrameClock(40.0)
    late = rng.exponential(0.004, 4000)
    times = [clock.soonest(n, 5.0 + n / 40.0 + late[n]) for n in range(4000)]
    errors = [time - (5.0 + n / 40.0) for n, time in enumerate(times) if time is not None]

    assert len(errors) == 4000
    # The estimate rises by the allowed drift of 0.5 ms/s, which is little between two early replies (some 20 frames).
    assert 0.0 <= np.median(errors[100:]) < 0.5e-3
    assert max(errors[100:]) < 2e-3


@pytest.mark.parametrize("drift", [-2e-4, 2e-4])
def test_frame_clock_follows_the_drift_of_the_clocks(drift):
    clock = FrameClock(40.0)
    for n in range(40000):
        arrival = n / 40.0 * (1.0 + drift)
        time = clock.soonest(n, arrival)
    assert time == pytest.approx(arrival, abs=1e-3)


def test_frame_times_never_decrease():
    rng = np.random.default_rng(1)
    clock = FrameClock(40.0)
    times = [clock.soonest(n, n / 40.0 + rng.uniform(0.0, 0.030)) for n in range(500)]
    known = [time for time in times if time is not None]
    assert np.diff(known).min() > 0.0


@pytest.mark.parametrize("wrong", [5, 99, 104, 2**31])
def test_impossible_frame_number_is_refused_without_effect(wrong):
    clock = FrameClock(40.0)
    for n in range(100):
        clock.soonest(n, n / 40.0)
    assert clock.soonest(wrong, 2.501) is None
    assert clock.soonest(101, 101 / 40.0) == pytest.approx(101 / 40.0, abs=1e-4)


def test_restarted_frame_count_is_accepted_after_five_consistent_frames():
    clock = FrameClock(40.0)
    for n in range(1000, 1100):
        clock.soonest(n, n / 40.0)
    answers = [clock.soonest(n, 30.0 + n / 40.0) for n in (0, 0, 1, 2, 2, 3, 4, 5)]  # some frames are received twice

    assert answers[:6] == [None] * 6
    assert answers[6:] == pytest.approx([30.1, 30.125], abs=1e-3)


def test_late_first_reply_does_not_shift_later_times():
    clock = FrameClock(40.0)
    clock.soonest(0, 0.9)  # frame 0 arrives 0.9 s late
    answers = [clock.soonest(n, n / 40.0) for n in range(30, 50)]
    assert answers[-1] == pytest.approx(49 / 40.0)


def test_jump_gate_passes_a_slow_motion_and_rejects_a_jump():
    gate = JumpGate()

    assert all(gate.passes(n / 40.0, (0.3 * n, 0.0, 0.0)) for n in range(100))
    assert not gate.passes(2.5, (60.0, 0.0, 0.0))
    assert gate.passes(2.525, (30.0, 0.0, 0.0))


def test_jump_is_accepted_after_ten_consistent_frames():
    gate = JumpGate()
    gate.passes(0.0, (0.0, 0.0, 0.0))

    assert [gate.passes(n / 40.0, (100.0, 0.0, 0.0)) for n in range(1, 12)] == [False] * 9 + [True] * 2


def test_scattered_jumps_are_never_accepted():
    gate = JumpGate()
    gate.passes(0.0, (0.0, 0.0, 0.0))
    for n in range(1, 6):
        assert not gate.passes(n / 40.0, (100.0 + 80.0 * (n % 2), 0.0, 0.0))
