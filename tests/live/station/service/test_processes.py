"""A station's processes: started, watched, stopped for when they die, started anew; and a run's recording on them."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from station.config.controllers import ControllerFile
from station.config.motions import HoldMotion, Orders
from station.config.robots import RobotFile
from station.control.messages import Notice
from station.control.process import ring_width
from station.control.ring import Ring
from station.control.states import Event, RefusedError, State
from station.control.task import Task
from station.recording.label import Label
from station.recording.read import read_case
from station.service.control_host import Ending, Said
from station.service.processes import CONTROL, LAB, Processes
from station.service.runs import Runs
from station.service.start import Start
from station.service.station_file import load_station
from tests.harness.calm import SETTINGS
from tests.harness.waiting import until


@pytest.fixture
def grace() -> float:
    return 30.0


class Started(NamedTuple):
    """Processes, and what they have said."""

    processes: Processes
    runs: Runs
    heard: list[Said]
    ended: list[Ending]

    def state(self) -> State:
        return next((said.state for said in reversed(self.heard) if isinstance(said, Notice)), State.OFF)


@pytest.fixture
def started(paper: RobotFile, tmp_path: Path) -> Iterator[Started]:
    bench, ring = load_station(None, SETTINGS).bench(), Ring(ring_width(paper))
    heard, ended = list[Said](), list[Ending]()
    runs = Runs(bench, ring, tmp_path)
    processes = Processes(bench, ring, heard.append, ended.append, runs.problem)
    started = Started(processes, runs, heard, ended)
    runs.open()
    processes.open()
    try:
        until(lambda: started.state() is State.READY)
        yield started
    finally:
        processes.close()
        runs.close()
        ring.close(remove=True)


def hold(paper: RobotFile) -> Start:
    return Start(Task(ControllerFile().controller(paper), Orders(HoldMotion(), paper.robot()), 3600.0), "hold")


def test_a_killed_control_process_ends_with_its_stages_stopped_and_is_started_anew(started: Started) -> None:
    processes = started.processes
    assert processes.gone() == ()
    first = processes.pids()["control"]
    os.kill(first, signal.SIGKILL)
    until(lambda: bool(started.ended))

    assert started.ended[0].how == "the control process ended by signal 9"
    assert started.ended[0].stopped.startswith("3 stages on ")
    assert processes.gone() == (CONTROL,)
    with pytest.raises(RefusedError, match="gone"):
        processes.ask(Event.STOP)
    started.heard.clear()
    processes.end_dead(processes.gone())
    processes.start_anew()
    # Whatever is asked of one that is starting is answered, and a stop is not forgotten.
    with pytest.raises(RefusedError):
        processes.ask("tare")
    processes.stop()
    until(lambda: Notice(State.OFF, "stopped by the operator", 0) in started.heard)
    processes.ask(Event.CONNECT)
    until(lambda: started.state() is State.READY)
    assert processes.gone() == ()
    assert processes.pids()["control"] != first


def test_what_stands_still_is_ended_with_the_stages_stopped_and_replaced(
    started: Started, monkeypatch: pytest.MonkeyPatch
) -> None:
    processes = started.processes
    monkeypatch.setattr(processes, "_patience", 3600.0)  # as in the first ticks, or homing: no watchdog ends it
    before = processes.pids()
    os.kill(before["control"], signal.SIGSTOP)
    said = processes.stop()
    assert said.startswith("the control process did not answer 'stop' within 1 s and was ended; 3 stages on ")
    assert started.ended[0].stopped.startswith("3 stages on ")

    os.kill(before["lab"], signal.SIGSTOP)
    gone = processes.gone()
    assert gone == (LAB, CONTROL)
    processes.end_dead(gone)
    started.heard.clear()
    processes.start_anew()
    until(lambda: started.state() is State.READY)
    os.kill(processes.pids()["control"], signal.SIGSTOP)
    stopped = processes.end_control()
    assert stopped.seen, stopped.text
    assert stopped.text.startswith("3 stages on ")
    with pytest.raises(RefusedError, match="the station is ending"):
        processes.start_anew()


def test_a_run_is_recorded_until_its_recording_is_finished(started: Started, paper: RobotFile, tmp_path: Path) -> None:
    runs = started.runs
    run = runs.prepare(hold(paper))
    started.processes.ask(Event.START, task=run.start.task, run=run.number)
    runs.accepted(run)
    until(lambda: started.state() is State.RUNNING)
    assert runs.recording
    started.processes.ask(Event.STOP)
    until(lambda: started.state() is State.STOPPED)
    runs.heard(Notice(State.STOPPED, "stopped by the operator", run.number))
    until(lambda: not runs.recording)

    (file,) = (tmp_path / run.id).glob("*.mcap")
    assert read_case(file).label is Label.STOPPED
