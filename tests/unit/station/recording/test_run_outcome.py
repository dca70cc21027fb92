"""Outcome of a run: errors count as in the paper; outcomes are read from any summary; joints at a limit are named."""

import numpy as np
import pytest

from station.devices.interfaces import ABSENT
from station.recording.run_outcome import (
    case_outcomes,
    counted_from,
    errors,
    limited_parts,
    motion_errors,
    saturation_warning,
)

#: Times of a motion that starts at 10 s [s]. The setpoint moves along x at 1 mm/s; the tip is 2 mm behind it in x and
#: 1 mm off in y.
TIME = np.arange(9.0, 20.0, 0.002)
MEASURED = {"max_abs_error_mm": [1.0, 2.0, 2.0], "max_distance_mm": 3.0, "rms_error_mm": [0.3, 0.0, 0.4]}
TRUE = {"true_" + key: value for key, value in MEASURED.items()}
NAMES = ("outer_rotation", "inner_rotation")


def columns(late: float = 0.0, known: bool = True) -> dict[str, np.ndarray]:
    desired = np.outer(1e-3 * (TIME - 10.0), (1.0, 0.0, 0.0))
    frame = (np.arange(len(TIME)) % 13 == 0).astype(float)
    true = desired - np.array([2e-3, -1e-3, 0.0])
    # A frame has the tip position at the time of its measurement.
    measured = true - np.outer(np.full(len(TIME), 1e-3 * late), (1.0, 0.0, 0.0))
    return {
        "time": TIME[:, None],
        "tip_desired": desired,
        "tip_true": true,
        "tip_measured": measured,
        "tip_new": frame[:, None],
        "tip_time": (TIME - late)[:, None],
        "truth_known": np.full((len(TIME), 1), float(known)),
        "trouble": np.zeros((len(TIME), 3)),
        # 4 N before the motion, then 1 N until 11 s and 0.5 N from then on, also while errors do not count.
        "force_filtered": np.outer(np.select([TIME < 10.0, TIME < 11.0], [8.0, 2.0], 1.0), (0.3, 0.0, 0.4)),
        "force_variance": np.zeros((len(TIME), 3)),
        "target_followed": np.zeros((len(TIME), 1)),
        "target_measured": np.zeros((len(TIME), 3)),
        "target_true": np.zeros((len(TIME), 3)),
        "target_offset": np.zeros((len(TIME), 3)),
    }


def test_tracking_errors_are_per_axis_in_millimetres():
    found = errors("true_", np.array([[1e-3, -2e-3, 0.0], [-3e-3, 2e-3, 0.0]]), np.array([5.0, 7.5]))

    assert found["true_max_abs_error_mm"] == [3.0, 2.0, 0.0]
    assert found["true_rms_error_mm"] == pytest.approx([np.sqrt(5.0), 2.0, 0.0], abs=1e-4)
    assert found["true_max_distance_at_s"] == 7.5
    assert found["true_mean_error_mm"] == pytest.approx((np.sqrt(5.0) + np.sqrt(13.0)) / 2, abs=1e-4)


def test_a_frame_is_compared_with_the_setpoint_at_its_measurement_time():
    found = motion_errors(columns(late=0.5).__getitem__, 10.0, 2.0)

    assert found["force_max_N"] == 1.0

    assert found["max_abs_error_mm"] == pytest.approx([2.0, 1.0, 0.0], abs=1e-6)
    assert found["true_max_abs_error_mm"] == pytest.approx([2.0, 1.0, 0.0], abs=1e-6)


def test_the_time_of_the_largest_error_is_that_of_its_measurement_after_the_start():
    values = columns(late=0.5)
    values["tip_measured"][np.searchsorted(TIME, 12.5)] += 1.0  # between two frames: it is not counted
    frame = np.flatnonzero(values["tip_new"][:, 0])[40]
    values["tip_measured"][frame] += 1.0

    found = motion_errors(values.__getitem__, 10.0, 0.0)

    assert found["max_distance_at_s"] == pytest.approx(TIME[frame] - 0.5 - 10.0, abs=1e-3)


def test_without_a_tracker_the_true_errors_remain_and_without_force_sensors_no_force():
    values = columns()
    values["tip_new"][:] = 0.0
    values["trouble"][:, 1:] = ABSENT

    found = motion_errors(values.__getitem__, 10.0, 2.0)

    assert found["true_max_abs_error_mm"] == pytest.approx([2.0, 1.0, 0.0], abs=1e-6)
    assert not found.keys() & {"max_abs_error_mm", "force_max_N"}


def test_tracking_errors_of_a_run_that_follows_a_target_use_the_target_and_not_the_setpoint():
    """The tip is 3 mm from its desired offset to the true target, and 4 mm from that to the measured one."""
    values = columns(late=0.5)
    values["target_followed"][:] = 1.0
    values["target_offset"][:] = (0.0, 0.0, 0.01)
    values["target_true"] = values["tip_true"] + np.array([0.0, 3e-3, -0.01])
    values["target_measured"] = values["tip_measured"] + np.array([0.0, -4e-3, -0.01])

    found = motion_errors(values.__getitem__, 10.0, 2.0)

    assert found["true_max_abs_error_mm"] == pytest.approx([0.0, 3.0, 0.0], abs=1e-6)
    assert found["max_abs_error_mm"] == pytest.approx([0.0, 4.0, 0.0], abs=1e-6)


def test_tracking_errors_count_only_after_the_settling_time():
    values = columns()
    values["tip_measured"][TIME < 12.0] += 1.0

    assert motion_errors(values.__getitem__, 10.0, 2.1)["max_abs_error_mm"][0] == pytest.approx(2.0, abs=1e-6)
    assert motion_errors(values.__getitem__, 10.0, 1.0)["max_abs_error_mm"][0] > 900.0


def test_tracking_errors_count_from_the_onset_of_a_load_during_the_settling_time():
    assert counted_from(20.0, 3.0) == 3.0
    assert counted_from(2.0, 3.0) == 2.0
    assert counted_from(2.0, float("inf")) == 2.0


def test_a_motion_that_has_not_settled_has_no_tracking_errors():
    assert motion_errors(columns().__getitem__, 10.0, 60.0) == {}
    assert not any(name.startswith("true_") for name in motion_errors(columns(known=False).__getitem__, 10.0, 2.0))


def test_the_outcome_of_a_case_uses_true_errors_if_known_and_tracker_errors_otherwise() -> None:
    found = case_outcomes(
        {
            "cases": {
                "lab": {**TRUE, "max_distance_mm": 9.0, "rms_error_mm": [2.0, 1.0, 2.0], "force_max_N": 0.2},
                "bench": MEASURED,
            }
        }
    )

    assert [(name, case.against) for name, case in found.items()] == [("lab", "true"), ("bench", "measured")]
    for case in found.values():
        assert (case.largest, case.largest_distance) == ((1.0, 2.0, 2.0), 3.0)
        assert (case.rms, case.rms_distance) == ((0.3, 0.0, 0.4), 0.5)
    assert [case.force for case in found.values()] == [0.2, None]
    assert [(case.measured_largest, case.measured_rms) for case in found.values()] == [(9.0, 3.0), (None, None)]


@pytest.mark.parametrize(
    "invalid",
    [
        {}, {"cases": None}, {"cases": [1]}, {"cases": {"a": 3}},
        {"cases": {"a": {**TRUE, "true_rms_error_mm": "none"}}},
        {"cases": {"a": {**TRUE, "true_max_distance_mm": None}}},
        {"cases": {"a": {**TRUE, "true_max_abs_error_mm": [1.0, 2.0]}}},
        {"cases": {"a": {**TRUE, "force_max_N": []}}},
    ],
)  # fmt: skip
def test_an_invalid_summary_has_no_outcome(invalid: dict[str, object]) -> None:
    assert case_outcomes(invalid) == {}


def test_fractions_of_time_at_a_limit_count_only_ticks_that_follow_a_target():
    at_bound = np.array([[0.0, 1.0], [0.0, -1.0], [0.0, 0.0], [1.0, 1.0]])

    assert limited_parts(NAMES, at_bound, np.array([1.0, 1.0, 1.0, 0.0])) == {
        "outer_rotation": 0.0, "inner_rotation": 2.0 / 3.0,
    }  # fmt: skip
    assert limited_parts(NAMES, at_bound, np.zeros(4)) == dict.fromkeys(NAMES, 0.0)


def test_the_saturation_warning_names_joints_that_are_often_at_a_limit():
    assert "inner_rotation 31 % of the time" in saturation_warning({"outer_rotation": 0.01, "inner_rotation": 0.31})
    assert "outer_rotation" not in saturation_warning({"outer_rotation": 0.01, "inner_rotation": 0.31})
    assert saturation_warning(dict.fromkeys(NAMES, 0.01)) == ""
