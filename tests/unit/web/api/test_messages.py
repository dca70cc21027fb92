"""Every state in words."""

from dataclasses import replace
from typing import Any

import pytest

from station.control.loop import Phase
from station.control.messages import DeviceStatus
from station.control.ring import Timing
from station.control.states import State
from station.devices.interfaces import Condition
from station.service.status import Status
from web.api.messages import words

NO_TIMING = Timing(0, 0, {}, {}, "")


def status(state: State, **changes: Any) -> Status:
    plain = Status(state, "", None, False, Phase.NONE, 0.0, 0.01, NO_TIMING, {}, (), (), "")
    return plain._replace(**changes)


@pytest.mark.parametrize("state", State)
def test_every_state_has_words(state: State) -> None:
    assert words(status(state)).what


@pytest.mark.parametrize("phase", Phase)
def test_every_phase_has_words(phase: Phase) -> None:
    assert words(status(State.RUNNING, phase=phase)).what


@pytest.mark.parametrize("state", [State.HOLD, State.STOPPED, State.FAULT])
def test_a_latched_state_says_why_and_that_reset_is_next(state: State) -> None:
    said = words(status(state, cause="the tracker is gone"))
    assert said.what == "the tracker is gone"
    assert "Reset" in said.next


@pytest.mark.parametrize("state", [State.READY, State.RUNNING, State.HOMING])
def test_old_telemetry_is_never_called_good(state: State) -> None:
    assert "no telemetry" in words(status(state, age=2.0)).what


def test_a_station_that_is_being_calibrated_asks_nobody_to_press_start() -> None:
    said = words(status(State.READY, reserved="'calibrate tubes' has the robot to itself; abort it first"))
    assert "'calibrate tubes'" in said.what
    assert said.next == "see the tab Calibrate"


def test_homing_tells_which_axis_how_far_and_how_long() -> None:
    told = {
        "joint": "inner_translation", "number": 1, "of": 3, "gone": 0.0124, "way": 0.030, "exact": True, "unit": "m",
        "left_s": 41.7,
    }  # fmt: skip
    stages = DeviceStatus("stages", Condition.HOMING, 0, "", {"homing": told})
    said = words(status(State.HOMING, devices=(stages,)))

    assert said.what == "homing inner translation (1 of 3): 12 of 30 mm; about 42 s left"
    unsure = replace(stages, details={"homing": told | {"exact": False}})
    assert "12 of at most 30 mm" in words(status(State.HOMING, devices=(unsure,))).what


@pytest.mark.parametrize("homing", [True, "on", {}, {"joint": "a"}])
def test_a_driver_that_tells_of_homing_in_its_own_way_is_no_trouble(homing: object) -> None:
    stages = DeviceStatus("stages", Condition.HOMING, 0, "", {"homing": homing})

    assert words(status(State.HOMING, devices=(stages,))) == words(status(State.HOMING))


@pytest.mark.parametrize(
    ("state", "act"),
    [
        (State.OFF, "connect"), (State.CONNECTED, "home"), (State.READY, "start"), (State.RUNNING, ""),
        (State.HOLD, "reset"), (State.STOPPED, "reset"), (State.FAULT, "reset"), (State.HOMING, ""),
    ],
)  # fmt: skip
def test_what_a_message_asks_for_has_its_command(state: State, act: str) -> None:
    assert words(status(state)).act == act
