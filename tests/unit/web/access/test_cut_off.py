"""Requests that the server's end cancels are answered, and log no exception."""

import asyncio
from typing import Any

import pytest
from starlette.types import Message, Receive, Scope, Send

from web.access.connections import Connections


async def _waits(_scope: Scope, _receive: Receive, _send: Send) -> None:
    await asyncio.Event().wait()


async def _cut(connections: Connections, kind: str) -> list[Message]:
    """Return the messages that a client receives when its request is cancelled."""
    sent: list[Message] = []

    async def send(message: Message) -> None:
        sent.append(message)

    scope: dict[str, Any] = {"type": kind, "client": ("127.0.0.1", 5), "headers": []}
    task = asyncio.create_task(connections(scope, None, send))  # type: ignore[arg-type]
    await asyncio.sleep(0)
    task.cancel()
    await task
    return sent


def test_a_request_cancelled_by_the_servers_end_is_answered() -> None:
    connections = Connections(_waits, 10)
    connections.end()
    start, body = asyncio.run(_cut(connections, "http"))
    assert start["status"] == 503
    assert body["body"] == b'{"error":"the station is ending"}'
    (closed,) = asyncio.run(_cut(connections, "websocket"))
    assert (closed["code"], closed["reason"]) == (1012, "the station is ending")


def test_a_request_cancelled_before_the_servers_end_stays_cancelled() -> None:
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(_cut(Connections(_waits, 10), "http"))
