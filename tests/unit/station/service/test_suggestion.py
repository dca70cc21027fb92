"""Suggestion for a refused motion: a slower motion if one works, otherwise a smaller one, otherwise none."""

import re

import numpy as np
import pytest

from core.errors import Unreachable
from station.config.controllers import DEFAULT_CONTROLLER
from station.config.motions import (
    CircleMotion,
    HelixMotion,
    Orders,
    SinusoidMotion,
    StepMotion,
    TipMotion,
    WaypointsMotion,
)
from station.config.robots import load_robot
from station.service.suggestion import suggest_motion

ROBOT = load_robot("paper")
CONTROLLER = DEFAULT_CONTROLLER.controller(ROBOT)
POSE = np.array([0.0, np.pi / 2, -0.1])
TOO_QUICK = [
    (CircleMotion(radius=0.01, period=4.0), r"a period of (\S+) s", "period"),
    (SinusoidMotion(amplitude=0.02, frequency=0.4), r"a frequency of (\S+) Hz", "frequency"),
    (HelixMotion(radius=0.01, pitch=0.003, turn=4.0, turns=3.0), r"(\S+) s for one turn", "turn"),
]


@pytest.mark.parametrize(("motion", "text", "key"), TOO_QUICK)
def test_suggested_motion_passes_the_check_of_its_path(motion: TipMotion, text: str, key: str):
    with pytest.raises(Unreachable):
        Orders(motion, ROBOT.robot()).check(CONTROLLER, POSE, 60.0)
    found = re.fullmatch(text + " would work from here", suggest_motion(motion, CONTROLLER, POSE, 60.0))
    assert found is not None
    Orders(motion.model_copy(update={key: float(found[1])}), ROBOT.robot()).check(CONTROLLER, POSE, 60.0)


def test_smaller_motion_is_suggested_if_a_slower_one_does_not_work():
    circle = CircleMotion(radius=0.05, period=20.0)
    assert suggest_motion(circle, CONTROLLER, POSE, 60.0) == "a radius of 10 mm would work from here"
    step = StepMotion(offset=(0.09, 0.0, 0.0))
    assert suggest_motion(step, CONTROLLER, POSE, 60.0) == "an offset of 18 mm, 0 mm, 0 mm would work from here"


def test_longer_times_are_suggested_for_waypoints():
    points = WaypointsMotion(points=((1.0, 0.0, 0.01, 0.0), (2.0, 0.0, 0.0, 0.0)), max_speed=0.1)
    assert suggest_motion(points, CONTROLLER, POSE, 2.0) == "times 2 times as long would work from here"


def test_suggestion_is_empty_if_no_slower_or_smaller_motion_works():
    homed = np.array(
        [0.0, 0.0, -0.13]
    )  # homed pose: the tubes are straight, and the translation is at the end of its travel
    assert suggest_motion(CircleMotion(radius=0.01, period=20.0), CONTROLLER, homed, 60.0) == ""


def test_suggested_value_is_inside_its_valid_range():
    """A period beyond the longest valid one is not suggested."""
    slow = CircleMotion(radius=0.1, period=3600.0)
    assert "period" not in suggest_motion(slow, CONTROLLER, POSE, 60.0)
