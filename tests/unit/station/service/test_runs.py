"""Numbering of runs, and their lifetime: a run is known while it is the newest one and its process runs."""

import itertools
from collections.abc import Callable, Iterator
from datetime import datetime

import pytest

from station.config.controllers import ControllerFile
from station.config.motions import HoldMotion, Orders
from station.config.robots import RobotFile
from station.control.messages import StateNotice
from station.control.process import ring_width
from station.control.ring import Ring
from station.control.states import State
from station.control.task import MotionTask
from station.service.runs import RunEnd, Runs, StartRequest
from station.service.station_file import load_station


@pytest.fixture
def runs(paper: RobotFile) -> Iterator[Runs]:
    ring = Ring(ring_width(paper))
    moments = (datetime(2026, 1, 1, 12, 0, second) for second in itertools.count())  # each reading is a second later
    runs = Runs(load_station(None).bench(), ring, None, time_of_day=lambda: next(moments))
    runs.open()
    yield runs
    runs.close()
    ring.close(remove=True)


@pytest.fixture
def start(paper: RobotFile) -> StartRequest:
    return StartRequest(
        MotionTask(ControllerFile().controller(paper), Orders(HoldMotion(), paper.robot()), 2.0), "hold"
    )


def test_run_can_be_found_before_it_is_accepted_and_is_current_afterwards(runs: Runs, start: StartRequest) -> None:
    run = runs.prepare(start)

    assert runs.find(run.number) is start
    assert runs.current is None
    runs.accepted(run)
    assert runs.current is run


def test_names_of_session_and_run_have_the_times_of_their_starts(runs: Runs, start: StartRequest) -> None:
    assert runs.session == "20260101-120000"
    assert [runs.prepare(start).id for _ in range(2)] == ["20260101-120001-1", "20260101-120002-2"]


#: Notices of a run from the control process, and the end of the run.
ENDS = {
    "complete": ([State.RUNNING, State.READY], RunEnd(State.READY, "")),
    "stopped": ([State.RUNNING, State.STOPPED], RunEnd(State.STOPPED, "the cause")),
    "stopped and reset": ([State.RUNNING, State.STOPPED, State.READY], RunEnd(State.STOPPED, "the cause")),
    "in HOLD and reset": ([State.RUNNING, State.HOLD, State.READY], RunEnd(State.HOLD, "the cause")),
    "jog afterwards": ([State.RUNNING, State.READY, State.RUNNING, State.STOPPED], RunEnd(State.READY, "")),
}


@pytest.mark.parametrize(("states", "end"), ENDS.values(), ids=ENDS)
def test_end_of_a_run_is_its_first_state_after_the_motion(
    runs: Runs, start: StartRequest, states: list[State], end: RunEnd
) -> None:
    run = runs.prepare(start)
    runs.on_state(StateNotice(State.READY, "", run.number - 1))
    for state in states[:1]:
        runs.on_state(StateNotice(state, "", run.number))
    runs.accepted(run)
    assert not run.end.done()
    for state in states[1:]:
        runs.on_state(StateNotice(state, "" if state is State.READY else "the cause", run.number))
    assert run.end.result(0) == end


def test_run_of_homing_has_not_ended_before_its_motion(runs: Runs, start: StartRequest) -> None:
    run = runs.prepare(start)
    runs.accepted(run)
    for state in (State.HOMING, State.HOMED, State.READY, State.RUNNING):
        runs.on_state(StateNotice(state, "", run.number))
        assert not run.end.done()


@pytest.mark.parametrize("end", [Runs.forget, lambda runs: runs.interrupted("killed")], ids=["restart", "death"])
def test_end_of_the_control_process_ends_its_run(runs: Runs, start: StartRequest, end: Callable[[Runs], None]) -> None:
    run = runs.prepare(start)
    runs.accepted(run)
    end(runs)
    assert run.end.result(0).state is State.FAULT


def test_refused_run_leaves_the_previous_run_current(runs: Runs, start: StartRequest) -> None:
    first = runs.prepare(start)
    runs.accepted(first)
    second = runs.prepare(start)
    assert runs.find(first.number) is start  # the end of the first run may be reported while the next run is requested
    runs.refused(second)

    assert runs.current is first
    assert runs.find(second.number) is None
    assert runs.prepare(start).number == second.number + 1


def test_run_is_forgotten_after_the_end_of_the_control_process(runs: Runs, start: StartRequest) -> None:
    run = runs.prepare(start)
    runs.accepted(run)
    runs.forget()

    assert runs.current is None
    assert runs.find(run.number) is None


def test_run_without_a_folder_is_not_recorded_and_reports_no_problem(runs: Runs, start: StartRequest) -> None:
    run = runs.prepare(start)
    runs.accepted(run)
    assert not runs.recording
    assert runs.problem() == ""
    assert runs.recorder is None
    for state in (State.RUNNING, State.READY):
        runs.state_changed(StateNotice(state, "", run.number))
        runs.on_state(StateNotice(state, "", run.number))
    runs.interrupted("killed")
