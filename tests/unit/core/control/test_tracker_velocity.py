"""Tip velocity that the joints do not cause, computed from tracker frames alone."""

import numpy as np
import pytest

from core.control.tracker_velocity import NO_FRAMES, differentiate

PERIOD = 0.002


def velocities(places, times, ages, ticks, by_joints=0.0):
    """Return the velocities along x at each tick, while the joints move the tip at `by_joints` [m/s].

    Frame k has the position `places[k]` [m] along x, is measured at `times[k]` [s] and arrives `ages[k]` [s] later.
    """
    seen, tip, found, waiting = NO_FRAMES, np.zeros(3), [], list(zip(places, times, ages, strict=True))
    for number in range(1, ticks + 1):
        now, frame, age = number * PERIOD, None, 0.0
        if waiting and now >= waiting[0][1] + waiting[0][2] - 1e-9:
            place, taken, _ = waiting.pop(0)
            frame, age = np.array([place, 0.0, 0.0]), now - taken
        seen = differentiate(seen, np.array([by_joints, 0.0, 0.0]), tip, frame, age, PERIOD)
        tip = tip if frame is None else frame
        found.append(seen.velocity[0])
    return found


def test_constant_tip_velocity_is_found_from_frames_with_any_latency():
    times = 0.026 * np.arange(1, 5)
    found = velocities(0.01 * times, times, [0.0, 0.010, 0.002, 0.014], 70)
    assert found[-1] == pytest.approx(0.01)
    assert {round(one, 9) for one in found} == {0.0, 0.01}


def test_tip_motion_caused_by_the_joints_is_not_attributed_to_the_load():
    times = 0.026 * np.arange(1, 5)
    found = velocities(0.01 * times, times, [0.0] * 4, 70, by_joints=0.01)
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


def test_tracker_velocity_is_constant_between_frames_and_has_their_noise_over_the_interval():
    found = velocities([0.0, 1e-4], [0.026, 0.050], [0.0, 0.0], 60)
    assert found[23] == 0.0
    assert found[24] == found[-1] == pytest.approx(1e-4 / 0.024)


def test_repeated_tracker_frame_does_not_change_the_tip_velocity():
    seen = differentiate(NO_FRAMES, np.zeros(3), np.zeros(3), np.array([1e-3, 0.0, 0.0]), 0.0, PERIOD)
    again = differentiate(seen, np.zeros(3), np.array([1e-3, 0.0, 0.0]), np.array([1e-3, 0.0, 0.0]), PERIOD, PERIOD)
    np.testing.assert_array_equal(again.velocity, seen.velocity)
    assert again.since == pytest.approx(PERIOD)
