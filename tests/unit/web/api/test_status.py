"""Messages of the page for every state of the station."""

from dataclasses import replace
from typing import Any

import pytest

from station.control.loop import Phase
from station.control.messages import DeviceStatus
from station.control.ring import Timing
from station.control.states import State
from station.devices.interfaces import Condition
from station.service.status import StationStatus
from web.api.status import Reader, state_message

RESET = "press Reset to make the station ready. Reset moves nothing."
NO_TIMING = Timing(0, 0, {}, {}, "")


def status(state: State, **changes: Any) -> StationStatus:
    plain = StationStatus(state, "", None, False, Phase.NONE, 0.0, 0.01, NO_TIMING, {}, (), (), "")
    return plain._replace(**changes)


@pytest.mark.parametrize("state", State)
def test_every_station_state_has_a_message(state: State) -> None:
    assert state_message(status(state)).message


@pytest.mark.parametrize("phase", Phase)
def test_every_phase_of_a_run_has_a_message(phase: Phase) -> None:
    assert state_message(status(State.RUNNING, phase=phase)).message


@pytest.mark.parametrize("state", [State.HOLD, State.STOPPED, State.FAULT])
def test_a_latched_state_shows_its_cause_and_reset_as_the_next_action(state: State) -> None:
    shown = state_message(status(state, cause="the tracker is gone"))
    assert shown.message.startswith("The tracker is gone")
    assert "Reset" in shown.next


def test_a_hold_states_that_the_robot_keeps_its_position() -> None:
    cause = "the tracker lost the coil for 0.25 s"
    assert state_message(status(State.HOLD, cause=cause)).message == (
        "The tracker lost the coil for 0.25 s. The robot keeps its position, and the motors are on."
    )


def test_a_stop_is_reported_to_its_sender_as_own_stop_and_to_others_with_the_name() -> None:
    stopped = status(State.STOPPED, cause="stopped by 'Anna' (10.0.0.7)")

    own = state_message(stopped, Reader(own_stop="stopped by 'Anna' (10.0.0.7)"))
    assert own.message == "You pressed STOP. Every axis is at rest."
    assert state_message(stopped).message == "Stopped by 'Anna' (10.0.0.7). Every axis is at rest."


@pytest.mark.parametrize("state", [State.HOLD, State.STOPPED, State.FAULT])
@pytest.mark.parametrize(
    ("reader", "step"),
    [
        (Reader(), f"Check the rig, then {RESET}"),
        (Reader(simulated=True), f"P{RESET[1:]}"),
        (Reader(resets=False, operator="Anna"), "'Anna' can reset the station. Take over to reset it yourself."),
        (Reader(resets=False, operator="Anna", views_only=True), "'Anna' can reset the station."),
        (Reader(resets=False, views_only=True), "An operator can reset the station."),
    ],
)
def test_next_step_of_a_latched_state_is_possible_for_its_reader(state: State, reader: Reader, step: str) -> None:
    if state is State.FAULT and reader.resets:
        step = f"Remove the cause{', then ' if reader.simulated else ' and '}{step[0].lower()}{step[1:]}"
    assert state_message(status(state, cause="the tracker is gone"), reader).next == step


@pytest.mark.parametrize("advice", ["or jog the tip away", "or jog the joints back"])
def test_hold_whose_load_the_lab_has_removed_gives_no_advice_to_take_it_off(advice: str) -> None:
    held = status(State.HOLD, cause=f"the force is above its limit: take the load off, {advice}")
    assert "take the load off" in state_message(held, Reader()).message
    message = state_message(held, Reader(simulated=True, removed_load=True)).message
    assert "take the load off" not in message
    assert "the lab has taken the load off" in message


@pytest.mark.parametrize("state", [State.READY, State.RUNNING, State.HOMING])
def test_stale_telemetry_is_reported_in_every_state(state: State) -> None:
    assert "no telemetry" in state_message(status(state, age=2.0)).message


def test_a_station_under_calibration_does_not_suggest_start() -> None:
    shown = state_message(status(State.READY, reserved="'calibrate tubes' has reserved the robot"))
    assert "'calibrate tubes'" in shown.message
    assert shown.next == "follow it in the tab Calibrate"


def test_the_homing_message_has_axis_distance_and_time_left() -> None:
    details = {
        "joint": "inner_translation", "number": 1, "of": 3, "gone": 0.0124, "way": 0.030, "exact": True, "unit": "m",
        "left_s": 41.7,
    }  # fmt: skip
    stages = DeviceStatus("stages", Condition.HOMING, 0, "", {"homing": details})
    shown = state_message(status(State.HOMING, devices=(stages,)))

    assert shown.message == "homing inner translation (1 of 3): 12 of 30 mm; about 42 s left"
    unsure = replace(stages, details={"homing": details | {"exact": False}})
    assert "12 of at most 30 mm" in state_message(status(State.HOMING, devices=(unsure,))).message


@pytest.mark.parametrize("homing", [True, "on", {}, {"joint": "a"}])
def test_unknown_homing_details_of_a_driver_are_ignored(homing: object) -> None:
    stages = DeviceStatus("stages", Condition.HOMING, 0, "", {"homing": homing})

    assert state_message(status(State.HOMING, devices=(stages,))) == state_message(status(State.HOMING))


@pytest.mark.parametrize(
    ("state", "action"),
    [
        (State.OFF, "connect"), (State.CONNECTED, "home"), (State.READY, "start"), (State.RUNNING, ""),
        (State.HOLD, "reset"), (State.STOPPED, "reset"), (State.FAULT, "reset"), (State.HOMING, ""),
    ],
)  # fmt: skip
def test_every_message_has_the_action_of_its_state(state: State, action: str) -> None:
    assert state_message(status(state)).action == action
