"""The endpoint at which the virtual lab gives the true shape of its tubes to simulated cameras, and its client.

A camera sends a datagram and receives the shape of the lab's last tick. The station's other processes, above all the
controller, have no client: they know only what the devices measure.
"""

import contextlib
import socket
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array
from station.lab.endpoints import HOST, Readable, UdpDeviceEnd
from station.lab.plant import TubeShape

#: Request for the present shape.
REQUEST = b"shape"
#: Longest wait for an answer, in real time [s]. The lab polls its endpoints every millisecond.
ANSWER_TIMEOUT_S = 0.05
#: Number of values in an answer before the tubes' ends: time, number of tubes, contact, force (3).
HEAD = 6


class TimedShape(NamedTuple):
    """True shape with its time."""

    time: float  #: time of the shape, by the station's clock [s]
    shape: TubeShape


class ShapeServer:
    """Endpoint of the lab; it is polled and never waits."""

    def __init__(self, readable: Readable) -> None:
        self._end = UdpDeviceEnd(HOST, 0, readable)
        self.port = self._end.port

    @property
    def files(self) -> list[int]:
        """Return the file descriptor whose datagrams the lab waits for."""
        return self._end.files

    def poll(self, shape: Callable[[], TubeShape], now: float) -> None:
        """Answer the requests that have arrived with `shape()` at the time `now` of the station's clock [s]."""
        requests = [sender for data, sender in self._end.receive() if data == REQUEST]
        if requests:
            answer = pack(TimedShape(now, shape()))
            for sender in requests:
                self._end.send(answer, sender)

    def close(self) -> None:
        """Close the port."""
        self._end.close()


def pack(timed: TimedShape) -> bytes:
    """Return a shape as a datagram of little-endian numbers."""
    shape = timed.shape
    head = (timed.time, len(shape.ends), shape.contact, *shape.force)
    return np.concatenate((head, shape.ends, shape.line.ravel())).astype("<f8").tobytes()


def unpack(datagram: bytes) -> TimedShape | None:
    """Return the shape in a datagram; None if the datagram is damaged."""
    if len(datagram) % 8 or len(datagram) < 8 * HEAD:
        return None
    numbers: Array = np.frombuffer(datagram, "<f8").astype(np.float64)
    if not 0.0 < numbers[1] <= len(numbers):  # true for NaN, too
        return None
    tubes = int(numbers[1])
    rest = numbers[HEAD + tubes :]
    if not len(rest) or len(rest) % 7:
        return None
    shape = TubeShape(rest.reshape(-1, 7), numbers[HEAD : HEAD + tubes], numbers[3:6], float(numbers[2]))
    return TimedShape(float(numbers[0]), shape)


class ShapeClient:
    """Client of a simulated camera, which requests the true shape."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(ANSWER_TIMEOUT_S)

    def request(self, port: int) -> TimedShape | None:
        """Return the present shape of the lab at `port`; None if the lab does not answer in time."""
        try:
            self._socket.setblocking(False)
            with contextlib.suppress(BlockingIOError):  # drop answers that came too late for their requests
                while self._socket.recv(65536):
                    pass
            self._socket.settimeout(ANSWER_TIMEOUT_S)
            self._socket.sendto(REQUEST, (HOST, port))
            return unpack(self._socket.recv(65536))
        except OSError:  # also the timeout
            return None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
