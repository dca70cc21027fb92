"""Validity of telemetry for drawing: only current measurements."""

from typing import NamedTuple

import numpy as np
import pytest

from core.robot.robot import Array, Robot
from station.control.ring import Timing
from station.control.states import State
from station.control.task import Phase
from station.control.telemetry import Channels
from station.devices.interfaces import Severity
from station.service.stale_channels import stale_groups
from station.service.status import STALE_AFTER_S, StationStatus
from web.scene.history import TipTrace
from web.scene.validity import MAX_TIP_AGE_S, Validity, validity_of

ALL = Validity(row=True, joints=True, tip=True, force=True)


class ReceivedRows(NamedTuple):
    """Received rows, and the station's state."""

    channels: Channels
    history: TipTrace
    rows: Array

    def validity(self, state: State = State.RUNNING, age: float = 0.0) -> Validity:
        row = self.rows[-1]
        values = {name: self.channels.of(row, name) for name in self.channels.groups}
        timing, old = Timing(0, 0, {}, {}, ""), stale_groups(self.channels, row)
        status = StationStatus(state, "", None, False, Phase.NONE, 0.0, age, timing, values, (), (), "", old)
        return validity_of(status, self.history)


def telemetry(robot: Robot, *, held: float = 0.0, sensors: int = 0, stages: int = 0) -> ReceivedRows:
    """Return a second of telemetry rows; in the last `held` [s] the estimates are frozen while raw values continue."""
    channels, random = Channels(robot), np.random.default_rng(0)
    rows = np.zeros((500, len(channels)))
    times = 10.0 + 0.002 * np.arange(500)
    channels.of(rows, "time")[:, 0] = times
    channels.of(rows, "tip_new")[::12] = 1.0
    raw = channels.of(rows, "wrench_raw")
    raw[:] = 1e-3 * random.standard_normal(raw.shape)
    channels.of(rows, "force")[:] = (0.2, 0.0, 0.0) + raw[:, :3]
    still = times > times[-1] - held
    if held:
        channels.of(rows, "tip_new")[still] = 0.0
        channels.of(rows, "estimates_frozen")[still] = 1.0
    channels.of(rows, "trouble")[:] = (stages, 0, sensors)
    history = TipTrace(channels)
    history.take(rows)
    return ReceivedRows(channels, history, rows)


def test_every_measured_value_is_valid(paper_robot: Robot) -> None:
    received = telemetry(paper_robot)
    assert received.validity() == ALL
    assert received.validity().message == ""
    assert received.validity(age=STALE_AFTER_S + 0.1) == Validity(row=False, joints=False, tip=False, force=False)


@pytest.mark.parametrize("state", [State.HOMING, State.FAULT, State.CONNECTED])
def test_frozen_tip_and_force_are_stale_while_telemetry_rows_continue(paper_robot: Robot, state: State) -> None:
    now = telemetry(paper_robot, held=MAX_TIP_AGE_S + 0.05).validity(state)
    assert now == Validity(row=True, joints=True, tip=False, force=False)
    assert now.message == "not measured now: tip, force"


def test_a_fault_with_current_measurements_hides_nothing(paper_robot: Robot) -> None:
    assert telemetry(paper_robot).validity(State.FAULT) == ALL


def test_the_tip_is_current_between_two_frames_of_the_tracker(paper_robot: Robot) -> None:
    assert telemetry(paper_robot, held=0.5 * MAX_TIP_AGE_S).validity().tip


def test_the_values_of_a_faulty_device_are_stale(paper_robot: Robot) -> None:
    assert telemetry(paper_robot, sensors=Severity.HOLD).validity() == ALL._replace(force=False)
    assert telemetry(paper_robot, stages=Severity.FAULT).validity() == ALL._replace(joints=False)
    assert telemetry(paper_robot, sensors=Severity.WARN).validity() == ALL


def test_the_tip_trace_is_empty_where_nothing_is_measured(paper_robot: Robot) -> None:
    assert len(telemetry(paper_robot).history.trace) == 9
    assert len(telemetry(paper_robot, held=0.5).history.trace) == 5


def test_no_value_is_valid_before_the_first_telemetry_row(paper_robot: Robot) -> None:
    history = TipTrace(Channels(paper_robot))
    status = StationStatus(State.OFF, "", None, False, Phase.NONE, 0.0, 9.0, Timing(0, 0, {}, {}, ""), {}, (), (), "")
    assert not any(validity_of(status, history))
