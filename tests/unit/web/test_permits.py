"""Permit of a request: issued when the request arrives; it becomes void if the client disconnects."""

import asyncio
import socket
from collections.abc import Iterator
from typing import Any

import pytest
from starlette.requests import HTTPConnection
from starlette.types import Message, Receive, Scope, Send

from station.service.permits import Permit, VoidError
from station.service.station_file import load_station
from station.service.supervisor import Supervisor
from web.access.connections import _Connection
from web.api.commands import permit_of, with_permits


@pytest.fixture
def supervisor() -> Iterator[Supervisor]:
    """Yield the supervisor of a station that is OFF."""
    supervisor = Supervisor(load_station(None).bench())
    yield supervisor
    supervisor.close()


def permit_when_the_body_is_there(supervisor: Supervisor, state: dict[str, Any], meanwhile: Any) -> Permit:
    """Return the permit of a request; `meanwhile` runs between its first line and its body."""
    found: list[Permit] = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        await receive()
        found.append(permit_of(HTTPConnection(scope)))

    async def receive() -> Message:
        meanwhile()
        return {"type": "http.request", "body": b"{}"}

    async def send(message: Message) -> None:
        raise AssertionError(message)

    asyncio.run(with_permits(app, supervisor)({"type": "http", "state": state}, receive, send))
    return found[0]


def test_a_stop_voids_a_request_whose_body_has_not_arrived(supervisor: Supervisor) -> None:
    permit = permit_when_the_body_is_there(supervisor, {}, lambda: supervisor.stop("stopped by a viewer, 'Anna'"))
    with pytest.raises(VoidError, match="'start' is void: the station was stopped by a viewer, 'Anna' after this"):
        permit.check("start")
    permit_when_the_body_is_there(supervisor, {}, lambda: None).check("start")


def test_a_reset_is_void_after_a_stop_and_not_after_another_reset(supervisor: Supervisor) -> None:
    permit = supervisor.permit()
    supervisor._permits.void("reset by 'Berta'", stop=False)
    permit.check("reset")
    with pytest.raises(VoidError, match="the station was reset by 'Berta' after"):
        permit.check("start")
    supervisor.stop()
    with pytest.raises(VoidError, match="the station was stopped by the operator after"):
        permit.check("reset")


def test_a_clients_disconnect_voids_its_request_before_the_server_has_read_it(supervisor: Supervisor) -> None:
    async def hang_up() -> None:
        ours, theirs = socket.socketpair()
        transport, _ = await asyncio.get_running_loop().create_connection(asyncio.Protocol, sock=ours)
        connection = _Connection(transport, ("127.0.0.1", 1), 0.0)
        permit = supervisor.permit(connection.gone)
        permit.check("start")
        theirs.send(b"more")
        permit.check("start")
        theirs.close()  # the event loop does not run before the next line
        with pytest.raises(VoidError, match="its client disconnected"):
            permit.check("start")
        permit.lasting().check("calibrate")
        transport.close()

    asyncio.run(hang_up())
