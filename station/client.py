"""Python client of a running station's REST interface.

```python
from station.client import Station

with Station() as station:
    station.home()  # confirm that the path is clear; after homing the robot moves to its working pose
    run = station.start(trajectory={"kind": "circle", "radius": 0.01, "period": 20.0}, duration=20.0)
    station.wait(run)
    station.download(run, "circle.mcap")
```
"""

import contextlib
import json
import math
import secrets
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import quote

import httpx

from core.errors import CtrError

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

#: Newest REST format that this client supports; `GET /api/status` reports the format of a station as `format`.
FORMAT = 1
#: Words in a refusal that is due to another operator; the name of that operator precedes them.
NOT_OPERATOR = " is operator"
#: States of a station that has just started, which it leaves without a command.
STARTING = ("CONNECTING", "HOMED")
#: Interval between two status requests while a method waits [s]. Each request also renews the operator's lease.
POLL_INTERVAL_S = 0.2
#: Timeout of a request [s]. Homing and the rendering of a report may take longer.
REQUEST_TIMEOUT_S = 70.0
#: Longest wait for a station that has just started [s]; after an installation it first compiles its code.
START_TIMEOUT_S = 300.0


class StationError(CtrError):
    """The station does not answer, refuses a request, or sends an unexpected response."""


class StationRefused(StationError):
    """The station refuses a request: the station's state, another operator or a value does not allow it."""


class NotOperator(StationRefused):
    """Another client is the operator, so the station refuses the command; the text says who and what to do."""


class RunFailed(StationError):
    """A run has ended in STOPPED, HOLD or FAULT instead of completing its motion."""


class Setpoints:
    """Stream of setpoints for a `with` block: the start of the block starts a run, and its end ends the run."""

    def __init__(self, url: str, headers: dict[str, str], options: dict[str, Any]) -> None:
        self._url, self._headers, self._options = url, headers, options
        self._socket: ClientConnection | None = None
        self._start_time = 0.0
        self.run = ""  #: id of the run
        #: tip at the start of the run, in the world frame [m]
        self.start: tuple[float, float, float] = (math.nan, math.nan, math.nan)
        #: direction of the tip at the start of the run, in the world frame; None: the direction is not controlled
        self.direction: tuple[float, float, float] | None = None
        self.newest: dict[str, Any] = {}  #: latest answer of the station; its keys are listed in `go`

    def __enter__(self) -> Self:
        from websockets.exceptions import WebSocketException  # local: most scripts need only httpx
        from websockets.sync.client import connect

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
        from websockets.exceptions import WebSocketException

        if self._socket is None:
            return
        try:
            self._socket.send(json.dumps({"end": True}))
            for _ in self._socket:
                pass  # receive the remaining answers and the message about the end of the run
        except (OSError, WebSocketException):
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
        return self.send({"tip": [x, y, z], "time": time.perf_counter(), **pointing})

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
        """Yield the time since the start of the stream [s] once in each `period` [s], until `duration` [s] is over."""
        count = 0
        while (now := time.monotonic() - self._start_time) < duration:
            yield now
            count = max(count + 1, math.floor((time.monotonic() - self._start_time) / period))
            time.sleep(max(0.0, self._start_time + count * period - time.monotonic()))

    def _exchange(self, message: dict[str, Any]) -> dict[str, Any]:
        from websockets.exceptions import ConnectionClosed

        assert self._socket is not None, "use `with station.setpoints() as tip:`"  # noqa: S101
        with contextlib.suppress(OSError, ConnectionClosed):  # the last received message has the reason
            self._socket.send(json.dumps(message))
        return self._receive()

    def _receive(self) -> dict[str, Any]:
        from websockets.exceptions import ConnectionClosed

        assert self._socket is not None  # noqa: S101
        try:
            answer: dict[str, Any] = json.loads(self._socket.recv())
        except (OSError, ConnectionClosed) as error:
            raise StationError(f"the run has ended: {error}") from None
        if "error" in answer and len(answer) == 1:
            raise _refusal(answer["error"])
        if "ended" in answer:
            raise StationError(f"the run has ended: {answer['ended']} {answer['cause']}".strip())
        return answer


class Station:
    """Connection of a script to a running station over its REST interface.

    The first command other than STOP waits while a station that has just started connects to its devices.
    """

    def __init__(self, url: str = "http://127.0.0.1:8000", token: str | None = None, name: str = "script") -> None:
        """Prepare the connection, which the first request opens.

        Args:
            url: address of the station.
            token: access token; required unless the station is on this computer.
            name: name that other clients see while this script is the operator.
        """
        self._client = secrets.token_hex(16)
        headers = {"x-ctr-client": self._client, "x-ctr-name": quote(name)}
        if token is not None:
            headers["authorization"] = f"Bearer {token}"
        self._headers = headers
        self._http = httpx.Client(base_url=url, headers=headers, timeout=REQUEST_TIMEOUT_S)
        self._format_checked = self._connected = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the operator's lease and close the connection; an active run continues."""
        try:
            self._http.delete("/api/operator", timeout=2.0)
        except httpx.HTTPError:
            return  # the station has ended, so its lease has ended too
        finally:
            self._http.close()

    def status(self) -> dict[str, Any]:
        """Return the status: state, run, devices, joints [rad or m], tips [m], force [N]; stale values are None."""
        return self._request("GET", "/api/status")

    def become_operator(self, *, take_over: bool = False) -> None:
        """Become the operator of the station; this is unnecessary while no other client is the operator.

        Raises:
            NotOperator: another client is the operator.
        """
        self._request("POST", "/api/operator", {"take_over": take_over})

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
        """Start an experiment by name, or a motion from the present pose; return the run's id.

        Raises:
            NotOperator: another client is the operator.
            StationRefused: the station's state or a value does not allow the start.
        """
        request = {
            "experiment": experiment, "case": case, "trajectory": trajectory, "controller": controller,
            "load": load, "duration": duration,
        }  # fmt: skip
        given = {key: value for key, value in request.items() if value is not None}
        return self._request("POST", "/api/start", given)["run_id"]

    def stop(self) -> str:
        """Stop every axis, in every state. Return a message for the operator, which is usually empty."""
        # `_send`, not `_request`: a check of the format must not delay or prevent a STOP.
        return self._send("POST", "/api/stop", {})["note"]

    def connect(self) -> None:
        """Search for the devices and connect them; a station also does this by itself when it starts."""
        self._request("POST", "/api/connect", {})

    def reset(self) -> None:
        """Reset the station after a person has checked the cause of a STOP, HOLD or FAULT."""
        self._request("POST", "/api/reset", {})

    def home(self, timeout: float = 300.0, *, then_working_pose: bool = True) -> None:
        """Home every stage, move to the working pose if the robot has one, and wait until the station is READY.

        The caller confirms that the path of the tubes is clear. The working pose is a suitable start for motions.

        Raises:
            StationRefused: the state is neither CONNECTED nor READY.
            StationError: the station is not READY within `timeout` [s], or homing was stopped.
        """
        self._request("POST", "/api/home", {"way_is_clear": True, "then_working_pose": then_working_pose})
        deadline = time.monotonic() + timeout
        while (status := self.status())["state"] in ("HOMING", "HOMED", "RUNNING"):
            if time.monotonic() > deadline:
                raise StationError(f"not READY within {timeout:g} s, but {status['state']}: {status['message']}")
            time.sleep(POLL_INTERVAL_S)
        if status["state"] != "READY":
            raise StationError(f"homing ended with {status['state']}: {_cause(status) or status['message']}")

    def goto(self, joints: Mapping[str, float] | None = None, timeout: float = 300.0) -> None:
        """Move joints, given by name, to positions [rad or m] and wait for the end; None: move to the working pose.

        All joints move at the same time. Joints that are not named keep their position.

        Raises:
            StationRefused: the state is not READY, or the pose is impossible or too near to a snap.
            RunFailed: the motion ended in STOPPED, HOLD or FAULT.
            StationError: the motion did not end within `timeout` [s].
        """
        body = {} if joints is None else {"joints": joints}
        self.wait(self._request("POST", "/api/goto", body)["run_id"], timeout)

    def tare(self, *, untouched: bool = False) -> None:
        """Tare the force sensors.

        With `untouched` the caller confirms that nothing touches the robot, so that any force is removed.

        Raises:
            StationRefused: the state is not READY, or the tip has contact, which a tare would hide.
        """
        self._request("POST", "/api/tare", {"untouched": untouched})

    def mark(self, text: str) -> None:
        """Mark the present moment of the run in its recording, for example "touched the tip".

        Raises:
            StationRefused: no run is being recorded.
        """
        self._request("POST", "/api/mark", {"text": text})

    def set_stiffness(self, stiffness: tuple[float, float, float]) -> None:
        """Change the stiffness of the tip along the axes of the motion's `stiffness_frame` [N/m], within 1 s.

        Raises:
            StationRefused: no motion runs, the motion was started without a stiffness, or the stiffness is too low for
                the delay of the joints' response to a force.
        """
        self._request("PUT", "/api/stiffness", {"stiffness": stiffness})

    def jog(self, space: str, velocity: tuple[float, ...]) -> None:
        """Jog for the next 0.3 s; `space`: `joints` [rad/s or m/s], `tip` [m/s], or `direction` of the tip [rad/s]."""
        self._request("POST", "/api/jog", {"space": space, "velocity": velocity})

    def apply_load(self, load: Mapping[str, Any]) -> None:
        """Apply a load to the tip or shaft of a virtual lab's robot now, such as {"kind": "constant", ...}."""
        self._request("POST", "/api/load", {"load": load})

    def inject_faults(self, *faults: Mapping[str, Any]) -> None:
        """Inject faults such as {"kind": "mute", "device": "tracker"} into a virtual lab; no argument clears them."""
        self._request("POST" if faults else "DELETE", "/api/faults", {"faults": faults} if faults else None)

    def wait(self, run: str, timeout: float | None = None) -> dict[str, Any]:
        """Wait until a run has ended and its recording is finished; return the status.

        Raises:
            RunFailed: the run ended in STOPPED, HOLD or FAULT; the text has the cause.
            StationError: the run did not end within `timeout` [s].
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            status = self.status()
            latest = status["run"]
            if latest is None or latest["id"] != run:
                raise RunFailed(f"run {run} is not the present or last run of the station")
            if status["state"] != "RUNNING" and not latest["recording"]:
                if status["state"] != "READY":
                    raise RunFailed(f"run {run} ended with {status['state']}: {_cause(status)}")
                return status
            if deadline is not None and time.monotonic() > deadline:
                raise StationError(f"run {run} has not ended within {timeout:g} s")
            time.sleep(POLL_INTERVAL_S)

    def wait_for(self, state: str, timeout: float) -> dict[str, Any]:
        """Wait until the station is in this state; return the status.

        Raises:
            StationError: the station did not reach the state within `timeout` [s], or is in FAULT.
        """
        deadline = time.monotonic() + timeout
        while (status := self.status())["state"] != state:
            if status["state"] == "FAULT":
                raise StationError(f"FAULT: {_cause(status)}")
            if time.monotonic() > deadline:
                raise StationError(f"not {state} within {timeout:g} s, but {status['state']}: {status['message']}")
            time.sleep(POLL_INTERVAL_S)
        return status

    def runs(self) -> list[dict[str, Any]]:
        """Return the recorded runs, the newest first."""
        return self._request("GET", "/api/runs")

    def download(self, run: str, file: str | Path, case: str = "") -> Path:
        """Write the recording of a run (MCAP) to a file; return its path.

        Raises:
            StationRefused: there is no such run.
            StationError: the file cannot be written.
        """
        path = Path(file)
        try:
            query = {"case": case} if case else {}
            with self._http.stream("GET", f"/api/runs/{quote(run, safe='')}/recording", params=query) as answer:
                if answer.is_error:
                    answer.read()
                    raise _refusal(_reason(answer))
                with path.open("wb") as out:
                    for part in answer.iter_bytes():
                        out.write(part)
        except httpx.HTTPError as error:
            raise StationError(f"{self._http.base_url}: {error}") from None
        except OSError as error:
            raise StationError(f"{path}: cannot be written: {error.strerror}") from None
        return path

    def telemetry(self, rate: float = 30.0) -> Iterator[dict[str, Any]]:
        """Yield telemetry samples as they arrive, at most `rate` samples a second.

        Stale values are None, for example while stages are being homed or a device is silent. `skipped` is the number
        of ticks since the previous sample. `missed` is the number of ticks that the control loop missed.

        Raises:
            StationRefused: the rate is outside its bounds.
            StationError: the connection failed, or the station has ended.
        """
        from websockets.exceptions import InvalidStatus, WebSocketException
        from websockets.sync.client import connect

        self._check_format()
        url = str(self._http.base_url.join("/api/telemetry")).replace("http", "ws", 1)
        try:
            with connect(f"{url}?rate={rate:g}", additional_headers=self._headers, proxy=None) as socket:
                for message in socket:
                    yield json.loads(message)
        except InvalidStatus as refused:
            response = refused.response
            raise StationRefused(_error_in(response.body or b"") or f"{url}: answer {response.status_code}") from None
        except (OSError, WebSocketException) as error:
            raise StationError(f"{url}: {error}") from None

    def setpoints(self, **options: Any) -> Setpoints:
        """Stream setpoints of the tip: `with station.setpoints() as tip: tip.go(0.001, 0.0, 0.0)`.

        The start of the block starts a run. The tip moves to the position that was sent last. At the end of the block
        the tip comes to rest and the run ends. Without a message for 0.2 s the tip also comes to rest; after 2 s
        without a message the run ends. The options `silence` and `end` change these times.

        Args:
            options: `frame` is "start" (positions relative to the tip at the start) or "world". The setpoint has the
                bounds `speed` [m/s], `acceleration` [m/s^2] and `reach` [m]; `turning` [rad/s] bounds its direction.
                The times are `silence`, `end` and `duration` [s]. `controller` has the keys of the controller; a
                direction may be sent if its `task` is "position_and_direction".

        Raises:
            NotOperator: at the start of the block: another client is the operator.
            StationRefused: at the start of the block: the state or a value does not allow the stream.
        """
        self._check_format()
        self._wait_connected()
        url = str(self._http.base_url.join("/api/setpoints")).replace("http", "ws", 1)
        return Setpoints(url, self._headers, options)

    def _check_format(self) -> None:
        """Check once, before the first request, that the station's REST format is supported.

        Raises:
            StationError: the station uses a newer format, or does not answer.
        """
        if self._format_checked:
            return
        reported = self._connection_status()["format"]
        if reported > FORMAT:
            raise StationError(
                f"{self._http.base_url}: the station's REST has format {reported}, but this client supports at most"
                f" format {FORMAT}: update ctr-station on this computer"
            )
        self._format_checked = True

    def _wait_connected(self) -> None:
        """Wait at most `START_TIMEOUT_S` until the station has connected to its devices; do this once."""
        deadline = time.monotonic() + START_TIMEOUT_S
        while not self._connected and time.monotonic() < deadline:
            time.sleep(POLL_INTERVAL_S)
            self._connection_status()
        self._connected = True  # later commands do not wait: the station refuses them with the reason

    def _connection_status(self) -> dict[str, Any]:
        """Return the status, and note whether the station has connected to its devices."""
        status = self._send("GET", "/api/status")
        self._connected = status.get("state") not in STARTING
        return status

    def _request(self, method: str, path: str, body: Any = None) -> Any:
        self._check_format()
        if method == "POST" and path != "/api/stop":
            self._wait_connected()
        return self._send(method, path, body)

    def _send(self, method: str, path: str, body: Any = None) -> Any:
        try:
            answer = self._http.request(method, path, json=body)
        except httpx.HTTPError as error:
            raise StationError(f"{self._http.base_url}: the station does not answer ({error})") from None
        if answer.is_error:
            raise _refusal(_reason(answer))
        return answer.json()


def _cause(status: Mapping[str, Any]) -> str:
    """Return the cause of a status with its details; older stations send no details."""
    return f"{status['cause']} ({details})" if (details := status.get("details", "")) else str(status["cause"])


def _refusal(reason: str) -> StationRefused:
    """Return the typed error of a refusal."""
    if NOT_OPERATOR not in reason:
        return StationRefused(reason)
    who, _, _ = reason.partition(NOT_OPERATOR)
    return NotOperator(
        f"{who}{NOT_OPERATOR}, so this script may not send commands: press Release in that operator's page and start"
        " the script again, or take over with station.become_operator(take_over=True)"
    )


def _reason(answer: httpx.Response) -> str:
    return _error_in(answer.content) or f"answer {answer.status_code} from {answer.url}"


def _error_in(body: bytes | bytearray) -> str:
    """Return the reason in the body of a refusal; empty if the body has none."""
    try:
        return str(json.loads(body)["error"])
    except (ValueError, KeyError, TypeError):
        return ""
