"""The station from a script: the REST interface in Python.

```python
from station.client import Station

with Station() as station:
    station.home()  # you have seen that the way is clear; then it goes to the robot's working pose
    run = station.start(trajectory={"kind": "circle", "radius": 0.01, "period": 20.0}, duration=20.0)
    station.wait(run)
    station.download(run, "circle.mcap")
```
"""

import json
import secrets
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import quote

import httpx

from station.errors import StationError

if TYPE_CHECKING:
    from station.setpoints import Setpoints

#: Of REST as this client speaks it, and as `GET /api/status` tells it; stations of version 0.1.0 do not, and speak 1.
FORMAT = 1
#: Between two looks at the status while waiting [s]; each of them also keeps the lease.
LOOK = 0.2
#: An answer takes no longer [s], but for what moves something home or renders a report.
PATIENCE = 70.0


class Refused(StationError):
    """The station refuses: the state, another operator or a value does not allow it."""


class RunFailed(StationError):
    """A run that did not come to its end."""


class Station:
    """A running station."""

    def __init__(self, url: str = "http://127.0.0.1:8000", token: str | None = None, name: str = "script") -> None:
        """`token` is demanded beyond loopback; `name` is shown while the script is operator."""
        self._client = secrets.token_hex(16)
        headers = {"x-ctr-client": self._client, "x-ctr-name": quote(name)}
        if token is not None:
            headers["authorization"] = f"Bearer {token}"
        self._headers = headers
        self._http = httpx.Client(base_url=url, headers=headers, timeout=PATIENCE)
        self._understood = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the lease back and hang up; what moves goes on moving."""
        try:
            self._http.delete("/api/operator", timeout=2.0)
        except httpx.HTTPError:
            return  # the station has gone: so has its lease
        finally:
            self._http.close()

    def status(self) -> dict[str, Any]:
        """Everything at one look: state, run, devices, joints [rad or m], tips [m], force [N]; None for what is old."""
        return self._ask("GET", "/api/status")

    def become_operator(self, *, take_over: bool = False) -> None:
        """Take the lease; not needed as long as nobody else has it.

        Raises:
            Refused: somebody else is operator.
        """
        self._ask("POST", "/api/operator", {"take_over": take_over})

    def start(
        self,
        experiment: str | None = None,
        case: str | None = None,
        *,
        trajectory: Mapping[str, Any] | None = None,
        controller: Mapping[str, Any] | None = None,
        load: Mapping[str, Any] | None = None,
        duration: float | None = None,
    ) -> str:
        """Start an experiment by name, or a motion from where the robot is; the run's id.

        Raises:
            Refused: the state, another operator or a value does not allow it.
        """
        wish = {
            "experiment": experiment, "case": case, "trajectory": trajectory, "controller": controller,
            "load": load, "duration": duration,
        }  # fmt: skip
        return self._ask("POST", "/api/start", {key: value for key, value in wish.items() if value is not None})[
            "run_id"
        ]

    def stop(self) -> str:
        """Stop every axis; always accepted. What a person should know about it; empty when it is done."""
        return self._send("POST", "/api/stop", {})["note"]  # at once, whatever the station's format

    def reset(self) -> None:
        """Go on after a stop, hold or fault that somebody has looked at."""
        self._ask("POST", "/api/reset", {})

    def home(self, timeout: float = 300.0, *, then_working_pose: bool = True) -> None:
        """Home every stage, go to the robot's working pose, if it has one, and wait until the station is READY.

        Whoever calls this has seen that the way is clear. From the working pose motions have room.

        Raises:
            Refused: neither CONNECTED nor READY.
            StationError: not READY in time, or stopped.
        """
        self._ask("POST", "/api/home", {"way_is_clear": True, "then_working_pose": then_working_pose})
        deadline = time.monotonic() + timeout
        while (status := self.status())["state"] in ("HOMING", "HOMED", "RUNNING"):
            if time.monotonic() > deadline:
                raise StationError(f"not READY within {timeout:g} s, but {status['state']}: {status['says']}")
            time.sleep(LOOK)
        if status["state"] != "READY":
            raise StationError(f"homing ended with {status['state']}: {status['cause'] or status['says']}")

    def goto(self, joints: Mapping[str, float] | None = None, timeout: float = 300.0) -> None:
        """Go to joints [rad or m] by name, all at the same time, and wait until they are there; None: the working pose.

        Joints that are not named stay where they are.

        Raises:
            Refused: not READY, or a pose that cannot be or is too near to a snap.
            RunFailed: stopped or held on the way.
            StationError: not there in time.
        """
        self.wait(self._ask("POST", "/api/goto", {} if joints is None else {"joints": joints})["run_id"], timeout)

    def tare(self) -> None:
        """Zero the force sensors."""
        self._ask("POST", "/api/tare", {})

    def jog(self, space: str, velocity: tuple[float, ...]) -> None:
        """Move for the next 0.3 s: `joints` [rad/s or m/s], the `tip` [m/s], or its `direction` [rad/s]."""
        self._ask("POST", "/api/jog", {"space": space, "velocity": velocity})

    def wait(self, run: str, timeout: float | None = None) -> dict[str, Any]:
        """Wait until a run has ended and its recording is finished; the status then.

        Raises:
            RunFailed: it was stopped, held or ended by a fault; the text says why.
            StationError: not in time.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            status = self.status()
            on = status["run"]
            if on is None or on["id"] != run:
                raise RunFailed(f"run {run} is not the station's last one")
            if status["state"] != "RUNNING" and not on["recording"]:
                if status["state"] != "READY":
                    raise RunFailed(f"run {run} ended with {status['state']}: {status['cause']}")
                return status
            if deadline is not None and time.monotonic() > deadline:
                raise StationError(f"run {run} goes on after {timeout:g} s")
            time.sleep(LOOK)

    def wait_for(self, state: str, timeout: float) -> dict[str, Any]:
        """Wait for a state; the status then.

        Raises:
            StationError: not in time, or a fault.
        """
        deadline = time.monotonic() + timeout
        while (status := self.status())["state"] != state:
            if status["state"] == "FAULT":
                raise StationError(f"FAULT: {status['cause']}")
            if time.monotonic() > deadline:
                raise StationError(f"not {state} within {timeout:g} s, but {status['state']}: {status['says']}")
            time.sleep(LOOK)
        return status

    def runs(self) -> list[dict[str, Any]]:
        """What was recorded, the newest first."""
        return self._ask("GET", "/api/runs")

    def download(self, run: str, file: str | Path, case: str = "") -> Path:
        """Write the recording of a run (MCAP) to a file; its path.

        Raises:
            Refused: no such run.
            StationError: the file cannot be written.
        """
        path = Path(file)
        try:
            query = {"case": case} if case else {}
            with self._http.stream("GET", f"/api/runs/{quote(run, safe='')}/recording", params=query) as answer:
                if answer.is_error:
                    answer.read()
                    raise Refused(_reason(answer))
                with path.open("wb") as out:
                    for part in answer.iter_bytes():
                        out.write(part)
        except httpx.HTTPError as error:
            raise StationError(f"{self._http.base_url}: {error}") from None
        except OSError as error:
            raise StationError(f"{path}: cannot be written: {error.strerror}") from None
        return path

    def telemetry(self, rate: float = 30.0) -> Iterator[dict[str, Any]]:
        """Samples as they come, `rate` a second at most.

        What nobody renews at present, as while stages are homed or a device is silent, is None.
        Each says how many ticks of the loop were `skipped` since the one before it, and how many the loop `missed`.

        Raises:
            StationError: the station has gone.
        """
        from websockets.exceptions import ConnectionClosed, WebSocketException  # here: most scripts need httpx only
        from websockets.sync.client import connect

        self._understand()
        url = str(self._http.base_url.join("/api/telemetry")).replace("http", "ws", 1)
        try:
            with connect(f"{url}?rate={rate:g}", additional_headers=self._headers, proxy=None) as socket:
                for message in socket:
                    yield json.loads(message)
        except (OSError, WebSocketException, ConnectionClosed) as error:
            raise StationError(f"{url}: {error}") from None

    def setpoints(self, **asked: Any) -> "Setpoints":
        """Lead the tip: `with station.setpoints() as tip: tip.go(0.001, 0.0, 0.0)`.

        A run begins; when the block ends the tip comes to rest and the run ends. The last place wins. Silence of
        0.2 s lets the tip come to rest, 2 s end the run.

        Args:
            asked: `frame` ("start": places are told from the tip at the start, or "world"), `speed` [m/s],
                `acceleration` [m/s^2] and `reach` [m] that the tip keeps to, `turning` [rad/s] that its direction
                does, `silence`, `end`, `duration` [s], `controller`; a direction may be told where its `task` is
                "position_and_direction".

        Raises:
            StationError: on entering: the state, another operator or a value does not allow it.
        """
        from station.setpoints import Setpoints

        self._understand()
        url = str(self._http.base_url.join("/api/setpoints")).replace("http", "ws", 1)
        return Setpoints(url, self._headers, asked)

    def _understand(self) -> None:
        """Before the first word: see that the station speaks the same REST.

        Raises:
            StationError: it speaks a later one, or does not answer.
        """
        if self._understood:
            return
        told = self._send("GET", "/api/status").get("format", 1)
        if told > FORMAT:
            raise StationError(
                f"{self._http.base_url}: the station's REST has format {told}, later than {FORMAT}, the latest that"
                " this client speaks: update ctr-station here"
            )
        self._understood = True

    def _ask(self, method: str, path: str, body: Any = None) -> Any:
        self._understand()
        return self._send(method, path, body)

    def _send(self, method: str, path: str, body: Any = None) -> Any:
        try:
            answer = self._http.request(method, path, json=body)
        except httpx.HTTPError as error:
            raise StationError(f"{self._http.base_url}: the station does not answer ({error})") from None
        if answer.is_error:
            raise Refused(_reason(answer))
        return answer.json()


def _reason(answer: httpx.Response) -> str:
    try:
        return str(answer.json()["error"])
    except (ValueError, KeyError, TypeError):
        return f"answer {answer.status_code} from {answer.url}"
