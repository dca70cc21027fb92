"""Every state in words."""

from typing import Any

import pytest

from station.control.loop import Phase
from station.control.ring import Timing
from station.control.states import State
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
