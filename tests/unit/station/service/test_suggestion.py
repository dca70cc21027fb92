"""A refused motion comes with one that works: slower where that helps, else smaller, else nothing is claimed."""

import re

import numpy as np
import pytest

from core.errors import Unreachable
from station.config.controllers import BEST
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
from station.service.suggestion import suggestion

ROBOT = load_robot("paper")
CONTROLLER = BEST.controller(ROBOT)
POSE = np.array([0.0, np.pi / 2, -0.1])
TOO_QUICK = [
    (CircleMotion(radius=0.01, period=4.0), r"a period of (\S+) s", "period"),
    (SinusoidMotion(amplitude=0.02, frequency=0.4), r"a frequency of (\S+) Hz", "frequency"),
    (HelixMotion(radius=0.01, pitch=0.003, turn=4.0, turns=3.0), r"(\S+) s for one turn", "turn"),
]


@pytest.mark.parametrize(("motion", "said", "key"), TOO_QUICK)
def test_what_is_suggested_really_works(motion: TipMotion, said: str, key: str):
    with pytest.raises(Unreachable):
        Orders(motion, ROBOT.robot()).check(CONTROLLER, POSE, 60.0)
    found = re.fullmatch(said + " would work from here", suggestion(motion, CONTROLLER, POSE, 60.0))
    assert found is not None
    Orders(motion.model_copy(update={key: float(found[1])}), ROBOT.robot()).check(CONTROLLER, POSE, 60.0)


def test_what_is_too_large_is_made_smaller():
    circle = CircleMotion(radius=0.05, period=20.0)
    assert suggestion(circle, CONTROLLER, POSE, 60.0) == "a radius of 10 mm would work from here"
    step = StepMotion(offset=(0.09, 0.0, 0.0))
    assert suggestion(step, CONTROLLER, POSE, 60.0) == "an offset of 18 mm, 0 mm, 0 mm would work from here"


def test_waypoints_get_more_time():
    points = WaypointsMotion(points=((1.0, 0.0, 0.01, 0.0), (2.0, 0.0, 0.0, 0.0)), max_speed=0.1)
    assert suggestion(points, CONTROLLER, POSE, 2.0) == "times 2 times as long would work from here"


def test_where_nothing_works_nothing_is_claimed():
    homed = np.array([0.0, 0.0, -0.13])  # straight, at the end of the travel
    assert suggestion(CircleMotion(radius=0.01, period=20.0), CONTROLLER, homed, 60.0) == ""


def test_a_suggestion_is_a_value_that_is_taken():
    """Slower than the slowest circle is not suggested."""
    slow = CircleMotion(radius=0.1, period=3600.0)
    assert "period" not in suggestion(slow, CONTROLLER, POSE, 60.0)
