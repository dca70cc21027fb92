"""The station's state: the control process's word while it lives, the station's own when it has died."""

from collections.abc import Iterator
from typing import NamedTuple

import pytest

from core.robot.robot import Robot
from station.config.controllers import ControllerFile
from station.config.motions import HoldMotion, Orders
from station.config.robots import RobotFile
from station.control.clock import REAL_TIME
from station.control.messages import DeviceStatus
from station.control.ring import PHASE, RUN, STATE, STUCK, Ring
from station.control.states import State
from station.control.task import Phase, Task
from station.control.telemetry import Channels
from station.devices.interfaces import Condition
from station.service.start import Run, Start
from station.service.status import StateMonitor


class Watched(NamedTuple):
    ring: Ring
    monitor: StateMonitor

    def tells(self, state: State, cause: str = "") -> bool:
        """As the control process does it: first into the ring, then through its pipe."""
        self.ring.counters[STATE] = state
        return self.monitor.hear(state, cause)


@pytest.fixture
def watched(paper_robot: Robot) -> Iterator[Watched]:
    channels = Channels(paper_robot)
    ring = Ring(len(channels))
    yield Watched(ring, StateMonitor(ring, channels, REAL_TIME))
    ring.close(remove=True)


def run(paper: RobotFile, number: int) -> Run:
    task = Task(ControllerFile().controller(paper), Orders(HoldMotion(), paper.robot()), 2.0)
    return Run(number, f"x-{number}", Start(task, "hold"))


def test_it_is_off_until_something_is_told(watched: Watched) -> None:
    watched.ring.counters[STATE] = State.READY
    assert watched.monitor.state is State.OFF


def test_the_ring_is_newer_than_what_was_told(watched: Watched) -> None:
    assert watched.tells(State.READY)
    watched.ring.counters[STATE] = State.RUNNING

    assert watched.monitor.state is State.RUNNING
    assert watched.monitor.said is State.READY


def test_a_state_is_entered_once_however_often_it_is_told(watched: Watched) -> None:
    assert [watched.tells(state) for state in (State.READY, State.READY, State.RUNNING, State.READY)] == [
        True, False, True, True,
    ]  # fmt: skip
    assert watched.monitor.entered(State.READY) == 2


def test_a_dead_control_process_is_a_fault_whatever_the_ring_says(watched: Watched) -> None:
    watched.tells(State.RUNNING)
    cause = watched.monitor.fault("the control process ended by signal 9", "3 stages say that they have stopped")

    status = watched.monitor.look(None, False, "", ())
    assert status.state is State.FAULT
    assert status.cause == cause
    assert cause.split("; ") == [
        "the control process ended by signal 9", "3 stages say that they have stopped", "reset to start it anew",
    ]  # fmt: skip
    assert watched.monitor.entered(State.FAULT) == 1


def test_its_last_word_is_the_cause_if_that_was_a_fault(watched: Watched) -> None:
    watched.tells(State.FAULT, "the stages at /dev/x do not answer")

    assert watched.monitor.fault("the control process ended with status 0", "") == (
        "the stages at /dev/x do not answer; reset to start it anew"
    )
    watched.monitor.forget()
    assert watched.monitor.state is State.OFF


def test_the_phase_is_that_of_the_run_that_is_shown(watched: Watched, paper: RobotFile) -> None:
    watched.tells(State.RUNNING)
    watched.ring.counters[RUN], watched.ring.counters[PHASE] = 7, Phase.MOVING

    assert watched.monitor.look(run(paper, 7), True, "", ()).phase is Phase.MOVING
    assert watched.monitor.look(run(paper, 8), True, "", ()).phase is Phase.NONE  # its first tick is still to come


def test_what_others_know_and_what_is_wrong_are_shown_together(watched: Watched) -> None:
    device = DeviceStatus(name="tracker", condition=Condition.FAULT, severity=4, text="no frames for 1 s", details={})
    watched.monitor.hear_devices((device,))
    watched.monitor.hear_refused(("no real-time scheduling",))
    watched.ring.counters[STUCK] = 1

    status = watched.monitor.look(None, False, "'calibrate tubes' has the robot to itself", ("the tubes snap",))
    assert status.devices == (device,)
    assert status.warnings[:2] == ("the tubes snap", "no real-time scheduling")
    assert "cannot follow its stages" in status.warnings[2]
    assert status.reserved.startswith("'calibrate tubes'")
    assert watched.monitor.troubles() == "no frames for 1 s"


def test_what_held_the_robot_is_told_before_the_end_of_its_process(watched: Watched) -> None:
    watched.tells(State.HOLD, "the tracker is silent")

    assert watched.monitor.fault("the control process ended by signal 9", "3 stages stopped") == (
        "the tracker is silent; then the control process ended by signal 9; 3 stages stopped; reset to start it anew"
    )
