"""Clients that send a request to a live station and read its answer later, while the test continues."""

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from tests.harness.waiting import NET


class Answer(NamedTuple):
    """The station's answer to a request."""

    status: int
    body: dict[str, Any]


class SlowClient:
    """A client whose connection the station has served before, so the station reads a new request at once."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=NET)
        self._host = f"127.0.0.1:{port}"
        self.send("GET", "/api/operator")
        assert self.answer().status == 200

    def send(self, method: str, path: str, body: Any = None) -> None:
        """Send a whole request; do not wait for its answer."""
        text = b"" if body is None else json.dumps(body).encode()
        head = f"{method} {path} HTTP/1.1\r\nhost: {self._host}\r\ncontent-length: {len(text)}\r\n"
        self._socket.sendall(f"{head}content-type: application/json\r\n\r\n".encode() + text)

    def answer(self) -> Answer:
        """Wait for the answer."""
        with self._socket.makefile("rb") as lines:
            status, length = int(lines.readline().split()[1]), 0
            while line := lines.readline().strip():
                name, _, value = line.partition(b":")
                length = int(value) if name.lower() == b"content-length" else length
            return Answer(status, json.loads(lines.read(length)))

    def hang_up(self) -> None:
        self._socket.close()


@contextmanager
def slow_client(port: int) -> Iterator[SlowClient]:
    client = SlowClient(port)
    try:
        yield client
    finally:
        client.hang_up()
