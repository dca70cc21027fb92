"""Errors of a motion, counted by hand."""

import numpy as np
import pytest

from station.recording.tracking_errors import counted_from, errors, motion_errors, settling_time, which_count

#: A motion that begins at 10 s: the tip runs along x at 1 mm/s, 2 mm behind in x and 1 mm aside in y.
TIME = np.arange(9.0, 20.0, 0.002)


def columns(late: float = 0.0, known: bool = True) -> dict[str, np.ndarray]:
    desired = np.outer(1e-3 * (TIME - 10.0), (1.0, 0.0, 0.0))
    frame = (np.arange(len(TIME)) % 13 == 0).astype(float)
    true = desired - np.array([2e-3, -1e-3, 0.0])
    # What a frame shows is the tip of when it was taken.
    measured = true - np.outer(np.full(len(TIME), 1e-3 * late), (1.0, 0.0, 0.0))
    return {
        "time": TIME[:, None],
        "tip_desired": desired,
        "tip_true": true,
        "tip_measured": measured,
        "tip_new": frame[:, None],
        "tip_time": (TIME - late)[:, None],
        "truth_known": np.full((len(TIME), 1), float(known)),
        # 0.5 N, and more before it counts.
        "force_filtered": np.outer(np.where(TIME < 11.0, 2.0, 1.0), (0.3, 0.0, 0.4)),
        "target_followed": np.zeros((len(TIME), 1)),
        "target_measured": np.zeros((len(TIME), 3)),
        "target_true": np.zeros((len(TIME), 3)),
        "target_offset": np.zeros((len(TIME), 3)),
    }


def test_errors_are_per_axis_in_millimetres():
    found = errors("true_", np.array([[1e-3, -2e-3, 0.0], [-3e-3, 2e-3, 0.0]]))

    assert found["true_max_abs_error_mm"] == [3.0, 2.0, 0.0]
    assert found["true_rms_error_mm"] == pytest.approx([np.sqrt(5.0), 2.0, 0.0], abs=1e-4)
    assert found["true_mean_error_mm"] == pytest.approx((np.sqrt(5.0) + np.sqrt(13.0)) / 2, abs=1e-4)


def test_a_frame_is_compared_with_the_setpoint_of_the_moment_it_was_taken():
    found = motion_errors(columns(late=0.5).__getitem__, 10.0, 2.0)

    assert found["force_max_N"] == 0.5

    assert found["max_abs_error_mm"] == pytest.approx([2.0, 1.0, 0.0], abs=1e-6)
    assert found["true_max_abs_error_mm"] == pytest.approx([2.0, 1.0, 0.0], abs=1e-6)


def test_beside_a_target_the_setpoint_does_not_count():
    """The tip is 3 mm from where it should be beside the true target, and 4 mm from where the same frame saw it."""
    values = columns(late=0.5)
    values["target_followed"][:] = 1.0
    values["target_offset"][:] = (0.0, 0.0, 0.01)
    values["target_true"] = values["tip_true"] + np.array([0.0, 3e-3, -0.01])
    values["target_measured"] = values["tip_measured"] + np.array([0.0, -4e-3, -0.01])

    found = motion_errors(values.__getitem__, 10.0, 2.0)

    assert found["true_max_abs_error_mm"] == pytest.approx([0.0, 3.0, 0.0], abs=1e-6)
    assert found["max_abs_error_mm"] == pytest.approx([0.0, 4.0, 0.0], abs=1e-6)


def test_errors_count_after_the_settling_time_only():
    values = columns()
    values["tip_measured"][TIME < 12.0] += 1.0

    assert motion_errors(values.__getitem__, 10.0, 2.1)["max_abs_error_mm"][0] == pytest.approx(2.0, abs=1e-6)
    assert motion_errors(values.__getitem__, 10.0, 1.0)["max_abs_error_mm"][0] > 900.0


def test_a_load_counts_from_its_onset_however_long_the_motion_takes_to_settle():
    assert counted_from(20.0, 3.0) == 3.0
    assert counted_from(2.0, 3.0) == 2.0
    assert counted_from(2.0, float("inf")) == 2.0


def test_a_table_says_which_moments_count():
    assert which_count({"a": {"counted_from_s": 2.0}, "b": {"counted_from_s": 2.0}}) == (
        "Errors count from 2 s after the motion's start on."
    )
    assert "a 0 s, b 2.5 s" in which_count({"a": {"counted_from_s": 0.0}, "b": {"counted_from_s": 2.5}})


def test_nothing_is_said_of_a_motion_that_has_not_settled_nor_of_a_truth_that_nobody_knows():
    assert motion_errors(columns().__getitem__, 10.0, 60.0) == {}
    assert not any(name.startswith("true_") for name in motion_errors(columns(known=False).__getitem__, 10.0, 2.0))


def test_a_free_motion_settles_in_twenty_seconds_or_half_of_its_time():
    assert settling_time(200.0) == 20.0
    assert settling_time(10.0) == 5.0
