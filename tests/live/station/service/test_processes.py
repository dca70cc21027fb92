"""Start, supervision and restart of a station's processes, and the recording of a run on them."""

import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest

from station.config.controllers import ControllerFile
from station.config.motions import HoldMotion, Orders
from station.config.robots import RobotFile
from station.control.commands import Connect, Execute, Reset, Stop, Tare
from station.control.messages import StateNotice
from station.control.process import ring_width
from station.control.ring import Ring
from station.control.states import RefusedError, State
from station.control.task import MotionTask
from station.recording.read import read_case
from station.recording.run_outcome import RunOutcome
from station.service import control_host
from station.service import processes as processes_module
from station.service.control_host import ControlReport, ExitReport
from station.service.fallback_stop import StopOutcome
from station.service.processes import CONTROL_LABEL, LAB_LABEL, ProcessSupervisor
from station.service.runs import Runs, StartRequest
from station.service.station_file import load_station
from tests.harness.calm import SETTINGS
from tests.harness.leftovers import nothing_left_behind
from tests.harness.waiting import NET, until


@pytest.fixture(autouse=True, scope="module")
def nothing_is_left_behind() -> Iterator[None]:
    """Check that nothing outlives the module, whose tests restart the processes that they share."""
    with nothing_left_behind(30.0):
        yield


class Started(NamedTuple):
    """Running lab and control process, and the reports that they have sent."""

    processes: ProcessSupervisor
    runs: Runs
    reports: list[ControlReport]
    ended: list[ExitReport]

    def stopped(self) -> list[StopOutcome]:
        return [report for report in self.reports if isinstance(report, StopOutcome)]

    def state(self) -> State:
        states = (report.state for report in reversed(self.reports) if isinstance(report, StateNotice))
        return next(states, State.OFF)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def started(nothing_is_left_behind: None, paper: RobotFile, data: Path) -> Iterator[Started]:
    bench, ring = load_station(None, SETTINGS).bench(), Ring(ring_width(paper))
    reports, ended = list[ControlReport](), list[ExitReport]()
    runs = Runs(bench, ring, data)
    processes = ProcessSupervisor(bench, ring, reports.append, ended.append, runs.problem)
    started = Started(processes, runs, reports, ended)
    runs.open()
    processes.open()
    try:
        until(lambda: started.state() is State.READY)
        yield started
    finally:
        processes.close()
        runs.close()
        ring.close(remove=True)


def hold(paper: RobotFile) -> StartRequest:
    return StartRequest(
        MotionTask(ControllerFile().controller(paper), Orders(HoldMotion(), paper.robot()), 3600.0), "hold"
    )


def test_recording_of_a_run_is_reported_until_it_is_finished(started: Started, paper: RobotFile, data: Path) -> None:
    runs = started.runs
    run = runs.prepare(hold(paper))
    started.processes.control.send(Execute(replace(run.start.task, run=run.number)))
    runs.accepted(run)
    until(lambda: started.state() is State.RUNNING)
    assert runs.recording
    started.processes.control.send(Stop())
    until(lambda: started.state() is State.STOPPED)
    runs.on_state(StateNotice(State.STOPPED, "stopped by the operator", run.number))
    until(lambda: not runs.recording)

    (file,) = (data / run.id).glob("*.mcap")
    assert read_case(file).label is RunOutcome.STOPPED
    started.processes.control.send(Reset())
    until(lambda: started.state() is State.READY)


def test_stages_stop_and_another_control_process_starts_after_a_kill_of_the_first(started: Started) -> None:
    processes = started.processes
    assert processes.failed() == ()
    first = processes.pids()["control"]
    os.kill(first, signal.SIGKILL)
    until(lambda: bool(started.ended))

    assert started.ended[0].how == "the control process ended by signal 9"
    assert until(started.stopped)[0].text.startswith("3 stages on ")
    assert processes.failed() == (CONTROL_LABEL,)
    with pytest.raises(RefusedError, match="has ended"):
        processes.control.send(Stop())
    started.reports.clear()
    processes.end_failed(processes.failed())
    processes.restart()
    # A starting process answers every command and does not lose a STOP.
    with pytest.raises(RefusedError):
        processes.control.send(Tare())
    processes.control.stop()
    until(lambda: StateNotice(State.OFF, "stopped by the operator", 0) in started.reports)
    processes.control.send(Connect())
    until(lambda: started.state() is State.READY)
    assert processes.failed() == ()
    assert processes.pids()["control"] != first


def test_hung_processes_are_killed_and_replaced_and_the_stages_are_stopped(
    started: Started, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This test is the last one of its processes, which it ends."""
    processes = started.processes
    started.reports.clear()
    monkeypatch.setattr(control_host, "STOP_REPLY_TIMEOUT_S", NET)
    # The watchdog must not kill the process first.
    monkeypatch.setattr(processes, "_tick_timeout", 3600.0)
    monkeypatch.setattr(processes_module, "SUSPENDED_AFTER_S", 3600.0)
    before = processes.pids()
    os.kill(before["control"], signal.SIGSTOP)
    outcome = processes.control.stop()
    assert outcome.confirmed
    assert outcome.text.startswith("the control process did not answer 'stop' within 1 s and was ended; 3 stages on ")
    assert until(started.stopped)[0].text.startswith("3 stages on ")

    os.kill(before["lab"], signal.SIGSTOP)
    failed = processes.failed()
    assert failed == (LAB_LABEL, CONTROL_LABEL)
    processes.end_failed(failed)
    started.reports.clear()
    processes.restart()
    until(lambda: started.state() is State.READY)
    os.kill(processes.pids()["control"], signal.SIGSTOP)
    stopped = processes.end_control()
    assert stopped.confirmed, stopped.text
    assert stopped.text.startswith("3 stages on ")
    with pytest.raises(RefusedError, match="the station is ending"):
        processes.restart()
