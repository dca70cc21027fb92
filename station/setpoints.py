"""Client that streams setpoints of the tip to a station over a WebSocket; see `Station.setpoints`."""

import contextlib
import json
import math
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Any, Self

from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import ClientConnection, connect

from station.errors import StationError


class Setpoints:
    """Stream of setpoints for a `with` block: the start of the block starts a run, and its end ends the run."""

    def __init__(self, url: str, headers: dict[str, str], options: dict[str, Any]) -> None:
        self._url, self._headers, self._options = url, headers, options
        self._socket: ClientConnection | None = None
        self._start_time = 0.0
        self.run = ""  #: id of the run
        self.start: tuple[float, float, float] = (
            math.nan,
            math.nan,
            math.nan,
        )  #: tip at the start of the run, in the world frame [m]
        #: direction of the tip at the start of the run, in the world frame; None: the direction is not controlled
        self.direction: tuple[float, float, float] | None = None
        self.newest: dict[str, Any] = {}  #: latest answer of the station; `go` lists its keys

    def __enter__(self) -> Self:
        try:
            self._socket = connect(self._url, additional_headers=self._headers, proxy=None)
        except (OSError, WebSocketException) as error:
            raise StationError(f"{self._url}: {error}") from None
        self.run = self._exchange(self._options)["run_id"]
        started = self._receive()
        x, y, z = started["tip"]
        self.start, self._start_time = (x, y, z), time.monotonic()
        if "direction" in started:
            x, y, z = started["direction"]
            self.direction = (x, y, z)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the stream and wait until the tip has come to rest."""
        if self._socket is None:
            return
        try:
            self._socket.send(json.dumps({"end": True}))
            for _ in self._socket:
                pass  # receive the remaining answers and the message about the end of the run
        except (OSError, WebSocketException, ConnectionClosed):
            return  # the run had already ended
        finally:
            self._socket.close()

    def go(self, x: float, y: float, z: float, direction: tuple[float, float, float] | None = None) -> dict[str, Any]:
        """Send a setpoint: a position [m] and optionally a direction of the tip; return the present state of the tip.

        Args:
            x: first coordinate, in the `frame` chosen at the start [m].
            y: second coordinate [m].
            z: third coordinate [m].
            direction: direction vector in the world frame, of any length; the task of the controller must include the
                direction. None: the latest direction remains; before the first one, the tip's direction at the start.

        Returns:
            `time` [s], `measured`, `estimated` and `desired` tip [m], `force` [N], `error` [m], and the limits that
            slow the motion. If the direction is controlled, also `direction_measured` and `direction_desired` in the
            world frame.

        Raises:
            StationError: the position or the direction was refused, or the run has ended; the message has the reason.
        """
        # With the sender's time the station compensates varying delays of messages, which would shake the tip.
        pointing = {} if direction is None else {"direction": list(direction)}
        return self.send({"tip": [x, y, z], "time": time.monotonic(), **pointing})

    def move(self, x: float, y: float, z: float) -> dict[str, Any]:
        """Send a velocity of the tip [m/s]; the answer and the errors are those of `go`."""
        return self.send({"velocity": [x, y, z]})

    def send(self, message: dict[str, Any]) -> dict[str, Any]:
        """Send any message of `WS /api/setpoints`, e.g. a position with a custom time; the rest is as for `go`."""
        answer = self._exchange(message)
        if answer["refused"]:
            raise StationError(answer["refused"])
        self.newest = answer
        return answer

    def every(self, period: float, duration: float = math.inf) -> Iterator[float]:
        """Yield the time since the start of the stream [s] after each `period` [s], for a `duration` [s]."""
        count = 0
        while (now := time.monotonic() - self._start_time) < duration:
            yield now
            count = max(count + 1, math.floor((time.monotonic() - self._start_time) / period))
            time.sleep(max(0.0, self._start_time + count * period - time.monotonic()))

    def _exchange(self, message: dict[str, Any]) -> dict[str, Any]:
        assert self._socket is not None, "use `with station.setpoints() as tip:`"  # noqa: S101
        with contextlib.suppress(OSError, ConnectionClosed):  # the last received message has the reason
            self._socket.send(json.dumps(message))
        return self._receive()

    def _receive(self) -> dict[str, Any]:
        assert self._socket is not None  # noqa: S101
        try:
            answer: dict[str, Any] = json.loads(self._socket.recv())
        except (OSError, ConnectionClosed) as error:
            raise StationError(f"the run has ended: {error}") from None
        if "error" in answer and len(answer) == 1:
            raise StationError(answer["error"])
        if "ended" in answer:
            raise StationError(f"the run has ended: {answer['ended']} {answer['cause']}".strip())
        return answer
