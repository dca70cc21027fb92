"""Start and end of the server: busy ports, signals, killed processes."""

import json
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import httpx
import psutil
import pytest
from websockets.sync.client import connect

from tests.harness.root import ROOT
from tests.harness.serving import Served, serving, shared_memory
from tests.harness.waiting import NET

SERVE = [sys.executable, "-c", "from web.cli import main; main()", "serve", "--no-browser"]


def _serve(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([*SERVE, *arguments], capture_output=True, text=True, timeout=NET, cwd=ROOT, check=False)


def test_the_serve_command_reports_a_busy_port() -> None:
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 0))
        busy.listen()
        port = busy.getsockname()[1]
        ended = _serve("--port", str(port))
    assert ended.returncode == 2
    assert str(port) in ended.stderr
    assert "--port" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


def test_a_station_that_connects_to_its_devices_shows_the_page_refuses_motions_and_takes_a_stop() -> None:
    with serving(rate=0.1, connected=False) as station:
        assert station.status()["state"] == "CONNECTING"
        # The control process first compiles its code, and executes a STOP of that time after this.
        assert station.wait_for(lambda status: status["loop"]["ticks"] > 0)["state"] == "CONNECTING"
        assert "<title>" in station.rest.get("/").text
        refused = station.post("/api/start", {"trajectory": {"kind": "hold"}})
        assert (refused.status_code, "CONNECTING" in refused.json()["error"]) == (409, True), refused.text
        stopped = station.post("/api/stop").json()
        assert (stopped["state"], stopped["confirmed"]) == ("OFF", True)
        assert station.status()["action"] == "connect"
        station.ready()


def test_ctrl_c_stops_the_axes_first_and_leaves_no_files_or_processes(tmp_path: Path) -> None:
    with serving("--data", str(tmp_path)) as station, ExitStack() as clients:
        control, used = station.control_process(), shared_memory(station.process.pid)
        assert used
        telemetry = clients.enter_context(connect(f"ws://127.0.0.1:{station.port}/api/telemetry", proxy=None))
        telemetry.recv()
        station.ready()
        assert station.post("/api/start", {"trajectory": {"kind": "hold"}}).status_code == 202
        station.wait_for(lambda status: status["state"] == "RUNNING")
        for _ in range(3):
            # An incomplete request, for whose rest a server normally waits before it ends.
            half = clients.enter_context(socket.create_connection(("127.0.0.1", station.port)))
            head = f"POST /api/tare HTTP/1.1\r\nhost: 127.0.0.1:{station.port}\r\ncontent-type: application/json\r\n"
            half.sendall(f"{head}content-length: 100\r\n\r\n{{".encode())
        station.status()  # the server reads in the order of arrival, so it has read the incomplete requests then
        assert station.end() == 0
        assert not control.is_running()
        assert "every axis is stopped" in station.said.read_text()
    done, refused = (
        {
            entry["what"]: entry["time"]
            for line in (tmp_path / log).read_text().splitlines()
            if (entry := json.loads(line))
        }
        for log in ("audit.jsonl", "refused.jsonl")
    )
    # A control process that acknowledges the stop too slowly is ended, and then reports no state.
    assert done.get("state STOPPED", "") <= refused["POST /api/tare {"]
    assert not any(path.exists() for path in used)


def test_stop_and_ctrl_c_do_not_wait_for_requests_that_are_kept_open() -> None:
    with serving() as station, ExitStack() as clients:
        station.ready()
        control, stop = station.control_process(), f"{station.url}/api/stop"
        assert station.post("/api/start", {"trajectory": {"kind": "hold"}}).status_code == 202
        station.wait_for(lambda status: status["state"] == "RUNNING")
        head = f"POST /api/stop HTTP/1.1\r\nhost: 127.0.0.1:{station.port}\r\ncontent-"
        for number in range(150):  # more connections than one address may have
            half = clients.enter_context(socket.create_connection(("127.0.0.1", station.port)))
            half.sendall(
                (f"{head}type: application/json\r\ncontent-length: 100\r\n\r\n{{" if number % 2 else head).encode()
            )
        assert httpx.post(stop, json={}, timeout=NET, trust_env=False).json() == {
            "state": "STOPPED",
            "note": "",
            "confirmed": True,
        }
        station.process.send_signal(signal.SIGINT)
        with suppress(httpx.TransportError):  # this error occurs when the station has ended
            while "did not answer" not in httpx.post(stop, json={}, timeout=NET, trust_env=False).json()["note"]:
                pass
            pytest.fail("it ended, and STOP was told that it hangs")
        assert station.end() == 0
        assert not control.is_running()
        said = station.said.read_text()
        assert "every axis is stopped" in said
        assert "Traceback" not in said


def test_repeated_ctrl_c_does_not_interrupt_the_stations_shutdown() -> None:
    with serving() as station:
        while station.process.poll() is None:
            station.process.send_signal(signal.SIGINT)
            time.sleep(0.02)
        assert station.process.returncode == 0


def test_a_signal_to_all_processes_ends_the_station_in_order() -> None:
    """A service manager sends its signal to all processes of a service."""
    with serving() as station:
        station.ready()
        for child in psutil.Process(station.process.pid).children():
            with suppress(psutil.NoSuchProcess):  # it may have ended together with another one
                child.terminate()
        assert station.end(by=signal.SIGTERM) == 0
        assert "every axis is stopped" in station.said.read_text()


def test_axes_without_a_confirmed_stop_are_not_reported_as_stopped() -> None:
    with serving() as station:
        station.ready()
        for name in ("ctr-lab", "ctr-control"):
            station.child(name).send_signal(signal.SIGSTOP)
        assert station.end(by=signal.SIGTERM) == 1
        said = station.said.read_text()
        assert "every axis is stopped" not in said
        assert "press the emergency stop" in said


def test_a_killed_control_process_is_a_fault_at_once_and_a_reset_starts_a_new_one(station: Served) -> None:
    killed = station.control_process()
    killed.kill()
    status = station.wait_for(lambda s: s["state"] == "FAULT" and s["cause"])
    assert "signal 9" in status["cause"]
    station.wait_for(lambda s: s["stale"])
    stopped = station.post("/api/stop")  # accepted with a message, although no control process can execute it
    assert stopped.status_code in (200, 202)
    assert stopped.json()["state"] == "FAULT"
    assert station.post("/api/start", {"trajectory": {"kind": "hold"}}).status_code == 409
    assert station.post("/api/reset").json()["state"] == "READY"
    assert station.control_process().pid != killed.pid
    assert station.post("/api/start", {"trajectory": {"kind": "hold"}, "duration": 0.5}).status_code == 202
    station.wait_for(lambda s: s["state"] == "READY" and s["run"]["id"] != "")


def test_forwarding_headers_of_a_client_are_ignored(station: Served) -> None:
    headers = {"x-forwarded-for": "192.0.2.1", "x-forwarded-proto": "https", "forwarded": "for=192.0.2.1"}
    assert station.rest.get("/api/status", headers={**headers, "host": "evil.example"}).status_code == 403
    assert station.rest.get("/api/log?count=1").json()[0]["where"] == "127.0.0.1"
