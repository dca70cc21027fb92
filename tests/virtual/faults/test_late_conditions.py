"""A command is void if, after its check, its sender is no longer operator or the robot is reserved."""

from collections.abc import Callable, Iterator
from functools import partial

import pytest

from station.control.commands import Command, Jog
from station.control.states import State
from station.experiments.experiment import Case
from station.service.commands import Goto, Home, Start
from station.service.permits import Permit, VoidError
from tests.harness.played_station import PlayedStation, played_station
from tests.harness.virtual_station import VirtualStation
from web.access.lease import Lease

COMMANDS = (
    Start(experiment="demo"),
    Goto(joints={"outer_rotation": 0.1}),
    Jog(space="joints", velocity=(0.01, 0.0, 0.0)),
    Home(way_is_clear=True),
)


#: Number of checks of the permit before the check that follows the slow check of the motion.
EARLY_CHECKS = {"start": 1, "goto": 1, "jog": 0, "home": 1}


@pytest.fixture(scope="module")
def played(case: Case) -> Iterator[PlayedStation]:
    with played_station(VirtualStation(case)) as station:
        yield station


def permit_with(played: PlayedStation, command: Command, meanwhile: Callable[[], object]) -> Permit:
    """Return a permit that calls `meanwhile` after the slow check of the command."""
    calls = [meanwhile, *EARLY_CHECKS[command.name] * (lambda: None,)]

    def check() -> str:
        if calls:
            calls.pop()()
        return ""

    return played.supervisor.permit().on(check)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_take_over_voids_a_command_of_the_earlier_operator_that_is_checked(
    played: PlayedStation, command: Command
) -> None:
    played.settle()
    lease = Lease()
    anna = lease.take("anna", "Anna")
    permit = permit_with(played, command, partial(lease.take, "ben", "Ben", over=True)).on(partial(lease.ended, anna))
    with pytest.raises(VoidError, match="is void: 'Ben' is operator instead of 'Anna'"):
        played.supervisor.send(command, permit)
    played.tick(20)
    assert played.state is State.READY


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_reservation_of_the_robot_voids_a_command_that_is_checked(played: PlayedStation, command: Command) -> None:
    played.settle()
    supervisor = played.supervisor
    reserve = partial(supervisor.reserve, "'calibrate' has reserved the robot", supervisor.permit())
    permit = permit_with(played, command, reserve)
    try:
        with pytest.raises(VoidError, match="is void: 'calibrate' has reserved the robot"):
            played.supervisor.send(command, permit)
    finally:
        supervisor.release()
    played.tick(20)
    assert played.state is State.READY
