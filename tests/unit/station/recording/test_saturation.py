"""Joints at their limits while the tip follows a target."""

import numpy as np

from station.recording.saturation import limited_parts, saturation_warning

NAMES = ("outer_rotation", "inner_rotation")


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
