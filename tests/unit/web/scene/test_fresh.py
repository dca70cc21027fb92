"""What may be drawn as it is: only what is measured now."""

from typing import NamedTuple

import numpy as np
import pytest

from core.robot.robot import Array, Robot
from station.control.ring import Timing
from station.control.states import State
from station.control.task import Phase
from station.control.telemetry import Channels
from station.devices.interfaces import Severity
from station.service.standing import standing
from station.service.status import STALE, Status
from web.scene.fresh import TIP_AGE, Fresh, fresh
from web.scene.history import History

ALL = Fresh(row=True, joints=True, tip=True, force=True)


class Told(NamedTuple):
    """Rows that have come, and the station's state."""

    channels: Channels
    history: History
    rows: Array

    def fresh(self, state: State = State.RUNNING, age: float = 0.0) -> Fresh:
        row = self.rows[-1]
        values = {name: self.channels.of(row, name) for name in self.channels.groups}
        timing, old = Timing(0, 0, {}, {}, ""), standing(self.channels, row)
        status = Status(state, "", None, False, Phase.NONE, 0.0, age, timing, values, (), (), "", old)
        return fresh(status, self.history)


def telemetry(robot: Robot, *, held: float = 0.0, sensors: int = 0, stages: int = 0) -> Told:
    """A second of rows; for the last `held` [s] of it time and raw values go on and the estimates are held."""
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
        channels.of(rows, "held")[still] = 1.0
    channels.of(rows, "trouble")[:] = (stages, 0, sensors)
    history = History(channels)
    history.take(rows)
    return Told(channels, history, rows)


def test_everything_that_is_measured_may_be_drawn(paper_robot: Robot) -> None:
    told = telemetry(paper_robot)
    assert told.fresh() == ALL
    assert told.fresh().says == ""
    assert told.fresh(age=STALE + 0.1) == Fresh(row=False, joints=False, tip=False, force=False)


@pytest.mark.parametrize("state", [State.HOMING, State.FAULT, State.CONNECTED])
def test_a_tip_and_a_force_that_stand_while_rows_go_on_are_old(paper_robot: Robot, state: State) -> None:
    now = telemetry(paper_robot, held=TIP_AGE + 0.05).fresh(state)
    assert now == Fresh(row=True, joints=True, tip=False, force=False)
    assert now.says == "not measured now: tip, force"


def test_a_fault_under_which_everything_is_measured_hides_nothing(paper_robot: Robot) -> None:
    assert telemetry(paper_robot).fresh(State.FAULT) == ALL


def test_between_two_frames_of_the_tracker_the_tip_is_not_old(paper_robot: Robot) -> None:
    assert telemetry(paper_robot, held=0.5 * TIP_AGE).fresh().tip


def test_a_device_in_trouble_is_not_drawn_as_measured(paper_robot: Robot) -> None:
    assert telemetry(paper_robot, sensors=Severity.HOLD).fresh() == ALL._replace(force=False)
    assert telemetry(paper_robot, stages=Severity.FAULT).fresh() == ALL._replace(joints=False)
    assert telemetry(paper_robot, sensors=Severity.WARN).fresh() == ALL


def test_where_nothing_is_measured_there_is_no_trace(paper_robot: Robot) -> None:
    assert len(telemetry(paper_robot).history.trace) == 9
    assert len(telemetry(paper_robot, held=0.5).history.trace) == 5


def test_before_the_first_row_nothing_is_known(paper_robot: Robot) -> None:
    history = History(Channels(paper_robot))
    status = Status(State.OFF, "", None, False, Phase.NONE, 0.0, 9.0, Timing(0, 0, {}, {}, ""), {}, (), (), "")
    assert not any(fresh(status, history))
