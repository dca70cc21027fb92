"""Runs are numbered, found by their number while they are the newest, and forgotten with the process that knew them."""

from collections.abc import Iterator

import pytest

from station.config.controllers import ControllerFile
from station.config.motions import HoldMotion, Orders
from station.config.robots import RobotFile
from station.control.messages import Notice
from station.control.process import ring_width
from station.control.ring import Ring
from station.control.states import State
from station.control.task import Task
from station.service.runs import Runs
from station.service.start import Start
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
def start(paper: RobotFile) -> Start:
    return Start(Task(ControllerFile().controller(paper), Orders(HoldMotion(), paper.robot()), 2.0), "hold")


def test_a_run_is_current_once_it_is_accepted_and_its_first_notice_may_come_before(runs: Runs, start: Start) -> None:
    run = runs.prepare(start)

    assert runs.find(run.number) is start
    assert runs.current is None
    runs.accepted(run)
    assert runs.current is run
    assert run.id == f"{runs.session}-{run.number}"


def test_a_refused_one_leaves_the_last_one_current(runs: Runs, start: Start) -> None:
    first = runs.prepare(start)
    runs.accepted(first)
    second = runs.prepare(start)
    assert runs.find(first.number) is start  # the end of one may be told while the next is asked for
    runs.refused(second)

    assert runs.current is first
    assert runs.find(second.number) is None
    assert runs.prepare(start).number == second.number + 1


def test_nothing_is_known_any_more_after_the_control_process_has_gone(runs: Runs, start: Start) -> None:
    run = runs.prepare(start)
    runs.accepted(run)
    runs.forget()

    assert runs.current is None
    assert runs.find(run.number) is None


def test_without_a_folder_nothing_is_recorded_and_nothing_is_wrong(runs: Runs, start: Start) -> None:
    run = runs.prepare(start)
    runs.accepted(run)
    assert not runs.recording
    assert runs.problem() == ""
    assert runs.pid is None
    for state in (State.RUNNING, State.READY):
        runs.state_changed(Notice(state, "", run.number))
        runs.heard(Notice(state, "", run.number))
    runs.interrupted("killed")
