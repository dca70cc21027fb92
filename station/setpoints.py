"""Leading the tip from a script, message by message; see `Station.setpoints`."""

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
    """Somebody who leads the tip, from the moment that it may be led until the block's end."""

    def __init__(self, url: str, headers: dict[str, str], asked: dict[str, Any]) -> None:
        self._url, self._headers, self._asked = url, headers, asked
        self._socket: ClientConnection | None = None
        self._begun = 0.0
        self.run = ""  #: its id
        self.start: tuple[float, float, float] = (
            math.nan,
            math.nan,
            math.nan,
        )  #: the tip at the start, in the world [m]
        self.direction: tuple[float, float, float] | None = None  #: then, in the world; None: it is not controlled
        self.newest: dict[str, Any] = {}  #: the last answer

    def __enter__(self) -> Self:
        try:
            self._socket = connect(self._url, additional_headers=self._headers, proxy=None)
        except (OSError, WebSocketException) as error:
            raise StationError(f"{self._url}: {error}") from None
        self.run = self._say(self._asked)["run_id"]
        begun = self._hear()
        x, y, z = begun["tip"]
        self.start, self._begun = (x, y, z), time.monotonic()
        if "direction" in begun:
            x, y, z = begun["direction"]
            self.direction = (x, y, z)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let the tip come to rest, and wait until it has."""
        if self._socket is None:
            return
        try:
            self._socket.send(json.dumps({"end": True}))
            for _ in self._socket:
                pass  # what is left of the answers, and how it ended
        except (OSError, WebSocketException, ConnectionClosed):
            return  # the run has ended before
        finally:
            self._socket.close()

    def go(self, x: float, y: float, z: float, direction: tuple[float, float, float] | None = None) -> dict[str, Any]:
        """Ask the tip to be at a place [m] and to point in a direction, soon; what it does now.

        Args:
            x: the place, in the `frame` of the beginning.
            y: the same.
            z: the same.
            direction: always in the world, its length does not matter; the controller's task must ask for one. Left
                out, the last one stands; before any that of the start is kept.

        Returns:
            time [s], `measured`, `estimated` and `desired` tip [m], `force` [N], `error` [m], what holds it back, and
            where it is controlled `direction_measured` and `direction_desired`, in the world.

        Raises:
            StationError: the place or the direction was refused, or the run has ended; the text says why.
        """
        # With its time: what other programs hold up on its way does not shake the tip.
        told = {} if direction is None else {"direction": list(direction)}
        return self.say({"tip": [x, y, z], "time": time.monotonic(), **told})

    def move(self, x: float, y: float, z: float) -> dict[str, Any]:
        """Ask the tip to move at a velocity [m/s]; the same as `go` otherwise."""
        return self.say({"velocity": [x, y, z]})

    def say(self, message: dict[str, Any]) -> dict[str, Any]:
        """Say anything that `WS /api/setpoints` takes, a place with a time of one's own for instance; as `go`."""
        answer = self._say(message)
        if answer["refused"]:
            raise StationError(answer["refused"])
        self.newest = answer
        return answer

    def every(self, period: float, duration: float = math.inf) -> Iterator[float]:
        """Seconds since the tip may be led, one after each `period` [s], for a `duration` [s]."""
        count = 0
        while (now := time.monotonic() - self._begun) < duration:
            yield now
            count = max(count + 1, math.floor((time.monotonic() - self._begun) / period))
            time.sleep(max(0.0, self._begun + count * period - time.monotonic()))

    def _say(self, message: dict[str, Any]) -> dict[str, Any]:
        assert self._socket is not None, "lead within `with station.setpoints() as tip:`"  # noqa: S101
        with contextlib.suppress(OSError, ConnectionClosed):  # what was heard last tells why
            self._socket.send(json.dumps(message))
        return self._hear()

    def _hear(self) -> dict[str, Any]:
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
