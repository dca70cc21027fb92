"""The wait for a streamed run ends with the run, with its control process and with its client."""

import asyncio
from collections.abc import Iterator

import pytest
from starlette.types import Message
from starlette.websockets import WebSocket, WebSocketDisconnect

from station.control.states import State
from station.experiments.experiment import Case
from station.service.commands import StreamAgreement
from station.service.runs import RunRequest
from tests.harness.played_station import PlayedStation, played_station
from tests.harness.virtual_station import VirtualStation
from tests.harness.waiting import NET
from web.access.identity import Role, Sender
from web.access.lease import Lease
from web.api.setpoints import _wait_until_ready, until_accepting, until_over

ANNA = Sender(Role.OPERATOR, "anna", "Anna", "127.0.0.1")


@pytest.fixture
def played(case: Case) -> Iterator[PlayedStation]:
    with played_station(VirtualStation(case)) as station:
        yield station


def settling(played: PlayedStation) -> RunRequest:
    """Start a streamed run, and let the control loop report that the run settles."""
    run = played.supervisor.send(StreamAgreement(duration=5.0)).started
    played.tick(2)
    played.reported()
    assert played.state is State.RUNNING
    return run


def test_wait_for_a_streamed_run_ends_with_the_control_process(played: PlayedStation) -> None:
    run = settling(played)
    played.kill_control()

    async def waits() -> bool:
        accepting = await asyncio.wait_for(until_accepting(played.supervisor, run), NET)
        await asyncio.wait_for(until_over(run), NET)
        return accepting

    assert not asyncio.run(waits())
    assert run.end.result(0).state is State.FAULT


def test_wait_for_a_streamed_run_ends_with_a_stop_that_is_reset_at_once(played: PlayedStation) -> None:
    run = settling(played)
    played.supervisor.stop("stopped by a viewer")
    played.supervisor.reset()
    played.tick()
    played.reported()
    assert not asyncio.run(asyncio.wait_for(until_accepting(played.supervisor, run), NET))
    assert run.end.result(0) == (State.STOPPED, "stopped by a viewer")


def test_wait_for_a_streamed_run_ends_with_its_client_and_does_not_renew_its_lease(played: PlayedStation) -> None:
    run, now = settling(played), [0.0]
    lease = Lease(lambda: now[0])
    lease.take(ANNA.client, ANNA.name)
    before, now[0] = lease.holder(), 1.0

    async def unused(*_: object) -> Message:
        raise AssertionError("nothing is sent or received while the run settles")

    permit = played.supervisor.permit(lambda: True)
    socket = WebSocket({"type": "websocket", "state": {"permit": permit}}, unused, unused)
    with pytest.raises(WebSocketDisconnect):
        asyncio.run(asyncio.wait_for(_wait_until_ready(socket, played.supervisor, lease, ANNA, run), NET))
    assert lease.holder() == before
