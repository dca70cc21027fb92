"""Progress of homing, from the stages' positions and homing speeds."""

import math

import pytest

from station.config.robots import RobotFile
from station.devices.kernel.startup import Homing, homing_step
from station.devices.zaber.setup import StageSetup


@pytest.fixture
def stages(paper: RobotFile) -> dict[str, StageSetup]:
    return {joint.name: StageSetup.of(joint, number) for number, joint in enumerate(paper.joints, start=1)}


def test_translation_homes_to_its_zero_count(stages: dict[str, StageSetup]) -> None:
    slide = stages["inner_translation"]
    step = homing_step(slide, 0.030 / slide.joint.microstep)

    assert (step.joint, step.unit, step.exact) == ("inner_translation", "m", True)
    assert step.way == pytest.approx(0.030)


def test_rotation_below_its_zero_homes_one_turn_lower_and_returns(stages: dict[str, StageSetup]) -> None:
    turner = stages["outer_rotation"]
    quarter = 0.5 * math.pi / turner.joint.microstep

    assert homing_step(turner, turner.home_count + quarter).way == pytest.approx(0.5 * math.pi)
    # The stage moves down by three quarters of a turn to the sensor, then up by a whole turn.
    assert homing_step(turner, turner.home_count - quarter).way == pytest.approx(1.5 * math.pi + 2.0 * math.pi)


def test_stage_at_an_unknown_position_may_need_its_whole_travel(stages: dict[str, StageSetup]) -> None:
    slide = homing_step(stages["inner_translation"], None)

    assert not slide.exact
    assert slide.way == pytest.approx(0.125, abs=1e-6)


def test_remaining_time_is_the_rest_of_this_step_and_all_later_ones(stages: dict[str, StageSetup]) -> None:
    slide, turner = stages["inner_translation"], stages["outer_rotation"]
    legs = [
        homing_step(slide, 0.030 / slide.joint.microstep),
        homing_step(turner, turner.home_count + 1.0 / turner.joint.microstep),
    ]
    homing = Homing(legs)
    homing.start(0, 100.0)
    progress = homing.progress(101.0)

    assert (progress["joint"], progress["number"], progress["of"]) == ("inner_translation", 1, 2)
    assert progress["gone"] == pytest.approx(slide.home_speed)
    assert progress["left_s"] == pytest.approx(0.030 / slide.home_speed - 1.0 + 1.0 / turner.home_speed)
    homing.start(1, 200.0)
    assert homing.progress(1e6)["gone"] == pytest.approx(1.0)
    assert homing.progress(1e6)["left_s"] == 0.0
