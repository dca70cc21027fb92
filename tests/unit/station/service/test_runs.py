"""Numbering of runs, and their lifetime: a run is known while it is the newest one and its process runs."""

from collections.abc import Iterator

import pytest

from station.config.controllers import ControllerFile
from station.config.motions import HoldMotion, Orders
from station.config.robots import RobotFile
from station.control.messages import StateNotice
from station.control.process import ring_width
from station.control.ring import Ring
from station.control.states import State
from station.control.task import MotionTask
from station.service.runs import Runs, StartRequest
from station.service.station_file import load_station


@pytest.fixture
def runs(paper: RobotFile) -> Iterator[Runs]:
    ring = Ring(ring_width(paper))
    runs = Runs(load_station(None).bench(), ring, None)
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
    assert run.id == f"{runs.session}-{run.number}"


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
