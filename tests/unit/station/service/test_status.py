"""Status of a station: the control process reports it while it runs, and the station process sets it afterwards."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest

from core.robot.robot import Robot
from station.config.controllers import ControllerFile
from station.config.motions import HoldMotion, Orders
from station.config.robots import RobotFile
from station.control.clock import REAL_TIME_CLOCK
from station.control.messages import DeviceStatus
from station.control.ring import HEARTBEAT, PHASE, PREPARED_LATE, RUN, STATE, STUCK, Ring
from station.control.states import State
from station.control.task import MotionTask, Phase
from station.control.telemetry import Channels
from station.devices.interfaces import Condition
from station.service.runs import RunRequest, StartRequest
from station.service.status import StateMonitor


class Watched(NamedTuple):
    ring: Ring
    monitor: StateMonitor

    def report(self, state: State, cause: str = "") -> bool:
        """Report a state like the control process: first in the ring, then through its pipe."""
        self.ring.counters[STATE] = state
        return self.monitor.set_reported(state, cause)


@pytest.fixture
def watched(paper_robot: Robot) -> Iterator[Watched]:
    channels = Channels(paper_robot)
    ring = Ring(len(channels))
    yield Watched(ring, StateMonitor(ring, channels, REAL_TIME_CLOCK))
    ring.close(remove=True)


def run(paper: RobotFile, number: int) -> RunRequest:
    task = MotionTask(ControllerFile().controller(paper), Orders(HoldMotion(), paper.robot()), 2.0)
    return RunRequest(number, f"x-{number}", StartRequest(task, "hold"))


def test_state_is_off_before_the_first_report(watched: Watched) -> None:
    watched.ring.counters[STATE] = State.READY
    assert watched.monitor.state is State.OFF


def test_functions_that_were_compiled_while_the_loop_ran_are_a_warning_with_their_number(watched: Watched) -> None:
    assert watched.monitor.snapshot(None, False, "", ()).warnings == ()
    watched.ring.counters[PREPARED_LATE] = 3
    (warning,) = watched.monitor.snapshot(None, False, "", ()).warnings
    assert warning.startswith("3 compiled functions were prepared while the control loop was running")


def test_station_that_starts_is_connecting_without_old_data_until_its_first_report(watched: Watched) -> None:
    watched.monitor.begin()
    shown = watched.monitor.snapshot(None, False, "", ())
    assert (shown.state, shown.age) == (State.CONNECTING, 0.0)
    # A STOP that has come first is in the ring before its report.
    watched.ring.counters[STATE], watched.ring.numbers[HEARTBEAT] = State.OFF, REAL_TIME_CLOCK.now()
    assert watched.monitor.state is State.OFF
    watched.report(State.OFF, "stopped by the operator")
    watched.ring.counters[STATE] = State.READY
    assert watched.monitor.state is State.OFF


def test_status_prefers_the_state_in_the_ring_to_the_reported_state(watched: Watched) -> None:
    assert watched.report(State.READY)
    watched.ring.counters[STATE] = State.RUNNING

    assert watched.monitor.state is State.RUNNING
    assert watched.monitor.reported is State.READY


def test_repeated_report_of_a_state_counts_as_one_entry(watched: Watched) -> None:
    assert [watched.report(state) for state in (State.READY, State.READY, State.RUNNING, State.READY)] == [
        True, False, True, True,
    ]  # fmt: skip
    assert watched.monitor.entered[State.READY] == 2


def test_state_is_fault_after_the_end_of_the_control_process_despite_the_ring(watched: Watched) -> None:
    watched.report(State.RUNNING)
    cause = watched.monitor.fault("the control process ended by signal 9", "the stages are being stopped")
    assert cause == "the control process ended by signal 9; the stages are being stopped"
    watched.monitor.set_stop_outcome("3 stages say that they have stopped")

    status = watched.monitor.snapshot(None, False, "", ())
    assert status.state is State.FAULT
    assert status.cause.split("; ") == [
        "the control process ended by signal 9", "3 stages say that they have stopped",
    ]  # fmt: skip
    assert watched.monitor.entered[State.FAULT] == 1


def test_fault_reported_before_the_end_of_the_control_process_is_the_cause(watched: Watched) -> None:
    watched.report(State.FAULT, "the stages at /dev/x do not answer")

    assert watched.monitor.fault("the control process ended with status 0", "") == (
        "the stages at /dev/x do not answer"
    )
    watched.monitor.forget()
    assert watched.monitor.state is State.OFF


def test_phase_and_run_in_the_status_belong_together(watched: Watched, paper: RobotFile) -> None:
    watched.report(State.RUNNING)
    watched.ring.counters[RUN], watched.ring.counters[PHASE] = 7, Phase.MOVING

    assert watched.monitor.snapshot(run(paper, 7), True, "", ()).phase is Phase.MOVING
    assert watched.monitor.snapshot(run(paper, 8), True, "", ()).phase is Phase.NONE  # the new run has had no tick yet


def test_status_combines_device_reports_refusals_and_warnings(watched: Watched) -> None:
    device = DeviceStatus(name="tracker", condition=Condition.FAULT, severity=4, text="no frames for 1 s", details={})
    watched.monitor.devices = (device,)
    watched.monitor.refusals = ("no real-time scheduling",)
    watched.ring.counters[STUCK] = 1

    status = watched.monitor.snapshot(None, False, "'calibrate tubes' has reserved the robot", ("the tubes snap",))
    assert status.devices == (device,)
    assert status.warnings[:2] == ("the tubes snap", "no real-time scheduling")
    assert "cannot follow its stages" in status.warnings[2]
    assert status.reserved.startswith("'calibrate tubes'")
    assert watched.monitor.device_problems() == "no frames for 1 s"


def test_cause_of_a_hold_precedes_the_end_of_the_control_process(watched: Watched) -> None:
    watched.report(State.HOLD, "the tracker is silent")

    watched.monitor.fault("the control process ended by signal 9", "the stages are being stopped")
    watched.monitor.set_stop_outcome("3 stages stopped")
    assert watched.monitor.cause == (
        "the tracker is silent; then the control process ended by signal 9; 3 stages stopped"
    )


def test_late_outcome_of_the_fallback_stop_changes_nothing_after_a_reset(watched: Watched) -> None:
    watched.report(State.RUNNING)
    watched.monitor.fault("the control process ended by signal 9", "the stages are being stopped")
    watched.monitor.forget()
    watched.report(State.HOLD, "the tracker is silent")
    watched.monitor.set_stop_outcome("3 stages stopped")
    assert watched.monitor.cause == "the tracker is silent"


def test_status_warns_while_a_followed_target_needs_more_than_the_stages_have(watched: Watched) -> None:
    channels, written = watched.monitor._channels, []
    for number in range(60):
        row = np.zeros(len(channels))
        channels.of(row, "time")[:] = 0.1 * number
        channels.of(row, "target_followed")[:] = number < 50
        channels.of(row, "at_bound")[1] = number % 4 == 0
        watched.ring.write(row)
        written.append(watched.monitor.snapshot(None, False, "", ()).warnings)

    (warning,) = written[49]
    assert "exceeds the speed or travel of the stages (at a limit: inner_rotation 26 % of the time)" in warning
    assert written[3] == written[-1] == ()
