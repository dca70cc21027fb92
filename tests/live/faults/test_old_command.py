"""A command is void after a later STOP or reset, or after its client has disconnected; it then moves nothing.

Commands to a live station wait here for a suspended recorder; `tests/virtual/faults` sends all of them in any order.
"""

import contextlib
import json
import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import psutil
from websockets.sync.client import connect

from tests.harness.children import children
from tests.harness.serving import Served
from tests.harness.slow_client import slow_client
from tests.harness.waiting import until

CIRCLE = {"trajectory": {"kind": "circle", "radius": 0.005, "period": 8.0}, "duration": 60.0}


def rests(station: Served, before: dict[str, Any]) -> None:
    """Check that the station is READY, and that neither its run nor its joints have changed since `before`."""
    now = station.status()
    assert now["state"] == "READY", now["run"]
    assert (now["run"] or {}).get("id") == (before["run"] or {}).get("id")
    assert now["joints"] == before["joints"]


def _outcome(station: Served, path: str) -> str:
    """Return the outcome of the newest command if it was sent to `path`, otherwise an empty text."""
    newest = next(entry for entry in station.rest.get("/api/log?count=10").json() if entry["who"] != "station")
    return newest["outcome"] if path in newest["what"] else ""


def _names(station: Served) -> list[str]:
    """Return the names of the station's child processes."""
    return [child.name() for child in children(station.process.pid)]


@contextmanager
def recorder_that_does_not_begin(station: Served) -> Iterator[None]:
    """Kill the recorder, let a reset start another one, and suspend that recorder during the block."""
    until(lambda: "ctr-recorder" in _names(station))  # a recorder has this name only after its start
    killed = station.child("ctr-recorder")
    killed.kill()
    with contextlib.suppress(psutil.NoSuchProcess):  # the station may have collected its exit status
        until(lambda: killed.status() == psutil.STATUS_ZOMBIE)
    known = {child.pid for child in psutil.Process(station.process.pid).children()}
    assert station.post("/api/reset").json()["note"] == "restarted: the recorder"
    (recorder,) = [child for child in psutil.Process(station.process.pid).children() if child.pid not in known]
    recorder.send_signal(signal.SIGSTOP)
    try:
        yield
    finally:
        with contextlib.suppress(psutil.NoSuchProcess):  # a reset may have ended the recorder
            recorder.send_signal(signal.SIGCONT)


def test_stop_and_reset_void_a_setpoint_session_that_waits_for_the_recorder(station: Served) -> None:
    with ExitStack() as stack:
        with recorder_that_does_not_begin(station):
            # Connect after the reset: the server closes a session that does not start within 20 s.
            socket = stack.enter_context(connect(f"ws://127.0.0.1:{station.port}/api/setpoints", proxy=None))
            station.rest.delete("/api/operator")
            socket.send("{}")
            station.wait_for(lambda status: status["operator"]["name"] is not None)  # it has read the message
            assert station.post("/api/stop").json() == {"state": "STOPPED", "note": "", "confirmed": True}
            assert station.post("/api/reset").status_code == 200
            station.wait_for(lambda status: status["state"] == "READY")
            before = station.status()
        answer = json.loads(socket.recv())
    assert "is void: the station was stopped by 'script at 127.0.0.1'" in answer.get("error", ""), answer
    rests(station, before)


def test_start_that_waits_for_the_recorder_is_void_if_its_client_disconnects(station: Served) -> None:
    before = station.status()
    with recorder_that_does_not_begin(station), slow_client(station.port) as client:
        client.send("POST", "/api/start", CIRCLE)
        client.hang_up()
    outcome = station.wait_for(lambda _: _outcome(station, "/api/start")) and _outcome(station, "/api/start")
    assert "its client disconnected" in outcome, outcome
    rests(station, before)
