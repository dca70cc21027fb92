"""If a start raises an unexpected exception, its run counts as failed and the queue is paused."""

import pytest

from station.service.commands import Start
from station.service.permits import Permit
from station.service.run_queue import EntryState, QueueEntry, RunQueue
from station.service.runs import RunRequest
from station.service.supervisor import Supervisor
from tests.harness.played_station import played_station
from tests.harness.virtual_station import VirtualStation, usual_case


class DefectiveStart(Start):
    """Start whose code has a defect."""

    def execute(self, station: Supervisor, permit: Permit) -> RunRequest:
        raise ZeroDivisionError("no such case")


def test_an_unexpected_exception_of_a_start_fails_its_run_and_pauses_the_queue(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with played_station(VirtualStation(usual_case())) as station:
        station.settle()
        queue = RunQueue(station.supervisor)
        queue.add(
            [QueueEntry("circle", DefectiveStart()), QueueEntry("helix", DefectiveStart())], station.supervisor.permit()
        )
        queue.step()

        first, second = queue.entries
        assert (first.state, second.state) == (EntryState.FAILED, EntryState.WAITING)
        assert "internal error ZeroDivisionError('no such case')" in queue.paused
    assert "Traceback" in capsys.readouterr().err
