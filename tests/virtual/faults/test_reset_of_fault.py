"""A reset by a program ends HOLD and STOPPED, but never a FAULT."""

from collections.abc import Iterator

import pytest

from station.control.commands import Reset
from station.control.states import RefusedError, State
from tests.harness.played_station import PlayedStation, played_station
from tests.harness.virtual_station import VirtualStation, usual_case

BY_PROGRAM = Reset(of_fault=False)


@pytest.fixture
def station() -> Iterator[PlayedStation]:
    with played_station(VirtualStation(usual_case()).ready()) as station:
        station.settle()
        yield station


def test_reset_by_a_program_leaves_stopped(station: PlayedStation) -> None:
    station.supervisor.stop()
    assert station.state is State.STOPPED
    station.supervisor.send(BY_PROGRAM)
    station.becomes(State.READY)


def test_reset_by_a_program_does_not_clear_a_fault_of_the_stages(station: PlayedStation) -> None:
    station.virtual.fail("mute", "stages")
    station.becomes(State.FAULT)
    with pytest.raises(RefusedError, match="a person must check the cause of the FAULT"):
        station.supervisor.send(BY_PROGRAM)
    # The control process refuses it, too: a fault may come after the check in the station process.
    with pytest.raises(RefusedError, match="a person must check the cause of the FAULT"):
        station.supervisor.command_control(BY_PROGRAM)
    assert station.state is State.FAULT
    station.virtual.mend()
    station.supervisor.send(Reset())
    station.becomes(State.CONNECTED)  # silent stages may have lost their positions


def test_reset_by_a_program_does_not_restart_a_dead_control_process(station: PlayedStation) -> None:
    station.kill_control()
    assert station.supervisor.status().state is State.FAULT
    with pytest.raises(RefusedError, match="a person must check the cause of the FAULT"):
        station.supervisor.send(BY_PROGRAM)
