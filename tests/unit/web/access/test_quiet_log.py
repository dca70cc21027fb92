"""Log lines that clients cause are limited."""

import asyncio
import logging

import pytest
from websockets.asyncio.server import serve

from web.access.quiet_log import INTERVAL_S, LOGGERS, OncePerInterval, limit_log


def record(text, cause=None):
    found = None if cause is None else (type(cause), cause, None)
    return logging.LogRecord("websockets.server", logging.ERROR, "", 0, text, (), found)


def test_a_failed_handshake_is_logged_once_per_interval_with_the_number_of_the_others():
    now = 0.0
    limit = OncePerInterval(lambda: now)
    first = record("opening handshake failed", ValueError("line\nbreak"))
    assert limit.filter(first)
    assert (first.getMessage(), first.exc_info) == ("opening handshake failed: line break", None)
    assert not any(limit.filter(record("opening handshake failed")) for _ in range(937))
    now = INTERVAL_S
    later = record("opening handshake failed")
    assert limit.filter(later)
    assert later.getMessage() == "opening handshake failed (937 more before)"


def test_errors_that_clients_do_not_cause_are_logged_each_time_with_their_traceback():
    limit = OncePerInterval()
    for _ in range(3):
        other = record("Exception in ASGI application", ValueError("x"))
        assert limit.filter(other)
        assert other.exc_info


def test_garbage_sent_to_a_websocket_server_causes_one_log_line(caplog: pytest.LogCaptureFixture):
    for name in LOGGERS:  # an earlier test of this process may have sent garbage, too
        logging.getLogger(name).filters.clear()
    limit_log()

    async def send_garbage() -> None:
        async with serve(lambda _socket: asyncio.sleep(0), "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            for _ in range(20):
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                writer.write(b"\x00garbage\r\n\r\n")
                await reader.read()
                writer.close()
                await writer.wait_closed()

    with caplog.at_level(logging.ERROR):
        asyncio.run(send_garbage())
    assert len(caplog.records) == 1
    assert caplog.records[0].exc_info is None
