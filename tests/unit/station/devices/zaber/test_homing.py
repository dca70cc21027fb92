"""How far homing has come, from where the stages stand and how fast they home."""

import math

import pytest

from station.config.robots import RobotFile
from station.devices.zaber.homing import Homing, leg
from station.devices.zaber.setup import StageSetup


@pytest.fixture
def stages(paper: RobotFile) -> dict[str, StageSetup]:
    return {joint.name: StageSetup.of(joint, number) for number, joint in enumerate(paper.joints, start=1)}


def test_a_translation_goes_back_to_where_it_counts_zero(stages: dict[str, StageSetup]) -> None:
    slide = stages["inner_translation"]
    way = leg(slide, 0.030 / slide.joint.microstep)

    assert (way.joint, way.unit, way.exact) == ("inner_translation", "m", True)
    assert way.way == pytest.approx(0.030)


def test_a_rotation_below_its_zero_goes_down_a_turn_further_and_back(stages: dict[str, StageSetup]) -> None:
    turner = stages["outer_rotation"]
    quarter = 0.5 * math.pi / turner.joint.microstep

    assert leg(turner, turner.home_count + quarter).way == pytest.approx(0.5 * math.pi)
    # down to the sensor three quarters of a turn below, then up a whole turn
    assert leg(turner, turner.home_count - quarter).way == pytest.approx(1.5 * math.pi + 2.0 * math.pi)


def test_a_stage_that_nobody_knows_of_may_have_all_its_travel_before_it(stages: dict[str, StageSetup]) -> None:
    slide = leg(stages["inner_translation"], None)

    assert not slide.exact
    assert slide.way == pytest.approx(0.125, abs=1e-6)


def test_what_is_left_is_the_rest_of_this_way_and_all_that_follow(stages: dict[str, StageSetup]) -> None:
    slide, turner = stages["inner_translation"], stages["outer_rotation"]
    legs = [leg(slide, 0.030 / slide.joint.microstep), leg(turner, turner.home_count + 1.0 / turner.joint.microstep)]
    homing = Homing(legs)
    homing.begin(0, 100.0)
    told = homing.told(101.0)

    assert (told["joint"], told["number"], told["of"]) == ("inner_translation", 1, 2)
    assert told["gone"] == pytest.approx(slide.home_speed)
    assert told["left_s"] == pytest.approx(0.030 / slide.home_speed - 1.0 + 1.0 / turner.home_speed)
    homing.begin(1, 200.0)
    assert homing.told(1e6)["gone"] == pytest.approx(1.0)
    assert homing.told(1e6)["left_s"] == 0.0
