"""Start and end of the server: busy ports, a thousand clients that do not read, signals, killed processes."""

import base64
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path

import httpx
import psutil
import pytest
from websockets.sync.client import connect

from tests.harness.root import ROOT
from tests.harness.serving import Served, serving, shared_memory
from tests.harness.waiting import NET

HOLD = {"trajectory": {"kind": "hold"}}
LISTENERS = 1000
#: Largest growth of the station's memory for all clients together [bytes]; a row for one client has about 3 kB.
ROOM = 200e6
FREE = {"trajectory": {"kind": "circle", "radius": 0.002, "period": 20.0}, "duration": 600.0}
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


@pytest.fixture(scope="module")
def slow() -> Iterator[Served]:
    """A station whose clock is slow, so that a timeout of 1 s lasts 10 s of real time; it has just started."""
    with serving(rate=0.1, connected=False) as station:
        yield station


def test_a_station_that_connects_to_its_devices_shows_the_page_refuses_motions_and_takes_a_stop(slow: Served) -> None:
    assert slow.status()["state"] == "CONNECTING"
    # The control process first compiles its code, and executes a STOP of that time after this.
    assert slow.wait_for(lambda status: status["loop"]["ticks"] > 0)["state"] == "CONNECTING"
    assert "<title>" in slow.rest.get("/").text
    refused = slow.post("/api/start", HOLD)
    assert (refused.status_code, "CONNECTING" in refused.json()["error"]) == (409, True), refused.text
    stopped = slow.post("/api/stop").json()
    assert (stopped["state"], stopped["confirmed"]) == ("OFF", True)
    assert slow.status()["action"] == "connect"


def deaf(port: int, number: int, opened: ExitStack) -> socket.socket:
    """Connect from one of 20 addresses with default buffers, request 100 rows per second, and read nothing."""
    listener = socket.create_connection(("127.0.0.1", port), source_address=(f"127.0.1.{1 + number % 20}", 0))
    opened.enter_context(listener)
    key = base64.b64encode(os.urandom(16)).decode()
    listener.sendall(
        f"GET /api/telemetry?rate=100 HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
        f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    return listener


def test_a_thousand_telemetry_clients_that_do_not_read_delay_no_other_client(slow: Served):
    slow.ready()
    station = psutil.Process(slow.process.pid)
    before = station.memory_info().rss
    assert slow.post("/api/start", FREE).status_code == 202
    slow.wait_for(lambda status: status["phase"] == "moving")
    with ExitStack() as opened:
        for number in range(LISTENERS):
            deaf(slow.port, number, opened)
        ticks = slow.status()["loop"]["ticks"]
        # After so many rows all buffers of the clients that do not read are full.
        status = slow.wait_for(lambda status: status["loop"]["ticks"] > ticks + 1_500)
        assert (status["state"], status["phase"]) == ("RUNNING", "moving"), status["cause"]
        assert station.num_fds() < LISTENERS
        grown = station.memory_info().rss - before
        assert grown < ROOM, f"{1e-6 * grown:.0f} MB"
        assert slow.post("/api/stop").json()["state"] == "STOPPED"
    slow.ready()


def test_a_signal_to_all_processes_ends_the_station_in_order(slow: Served) -> None:
    """A service manager sends its signal to all processes of a service. This test ends its station."""
    slow.ready()
    for child in psutil.Process(slow.process.pid).children():
        with suppress(psutil.NoSuchProcess):  # it may have ended together with another one
            child.terminate()
    assert slow.end(by=signal.SIGTERM) == 0
    assert "every axis is stopped" in slow.said.read_text()


# ---- the end of a station


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a data folder that has FIFOs in place of files."""
    folder = tmp_path_factory.mktemp("data")
    for run in ("a", "b"):
        (folder / run).mkdir()
        for name in ("notes.json", "curves.json", "report.html", "experiment.toml"):
            os.mkfifo(folder / run / name)
    os.mkfifo(folder / "a" / "summary.json")
    (folder / "a" / "run.mcap").write_bytes(b"")
    (folder / "b" / "summary.json").write_text("{}")
    (folder / "experiments").mkdir()
    os.mkfifo(folder / "experiments" / "pipe.toml")
    return folder


@pytest.fixture(scope="module")
def blocked(data: Path) -> Iterator[Served]:
    """A station on this data folder."""
    with serving("--data", str(data)) as station:
        yield station


def test_fifos_in_the_data_folder_delay_neither_start_nor_stop(blocked: Served) -> None:
    blocked.ready()
    with ThreadPoolExecutor(60) as clients:
        paths = ["/api/runs", "/api/runs?deleted=true", "/api/runs/a", "/api/runs/b/curves?stored=true"] * 15
        pending = [clients.submit(httpx.get, blocked.url + path, timeout=NET) for path in paths]
        assert blocked.post("/api/start", HOLD).status_code == 202
        assert blocked.post("/api/stop").json()["confirmed"]
        assert {answer.result().status_code for answer in pending} <= {200, 503}
    assert [run["id"] for run in blocked.rest.get("/api/runs").json()][-2:] in (["a", "b"], ["b", "a"])
    assert blocked.rest.put("/api/runs/a/notes", json={"notes": "new"}).status_code == 422


def test_stop_and_repeated_ctrl_c_wait_for_no_open_request_stop_the_axes_first_and_leave_nothing(
    blocked: Served, data: Path
) -> None:
    """This test ends its station."""
    station, stop = blocked, f"{blocked.url}/api/stop"
    with ExitStack() as clients:
        control, used = station.control_process(), shared_memory(station.process.pid)
        assert used
        telemetry = clients.enter_context(connect(f"ws://127.0.0.1:{station.port}/api/telemetry", proxy=None))
        telemetry.recv()
        station.ready()
        assert station.post("/api/start", HOLD).status_code == 202
        station.wait_for(lambda status: status["state"] == "RUNNING")
        for number in range(150):  # more connections than one address may have
            half = clients.enter_context(socket.create_connection(("127.0.0.1", station.port)))
            head = f"POST /api/stop HTTP/1.1\r\nhost: 127.0.0.1:{station.port}\r\ncontent-"
            whole = f"{head}type: application/json\r\ncontent-length: 100\r\n\r\n{{"
            half.sendall((whole if number % 2 else head).encode())
        stopped = {"state": "STOPPED", "note": "", "confirmed": True}
        assert httpx.post(stop, json={}, timeout=NET, trust_env=False).json() == stopped
        station.ready()
        assert station.post("/api/start", HOLD).status_code == 202
        station.wait_for(lambda status: status["state"] == "RUNNING")
        for _ in range(3):
            # An incomplete request, for whose rest a server normally waits before it ends.
            half = clients.enter_context(socket.create_connection(("127.0.0.1", station.port)))
            half.sendall(whole.replace("stop", "tare").encode())
        station.status()  # the server reads in the order of arrival, so it has read the incomplete requests then
        with suppress(httpx.TransportError):  # this error occurs when the station has ended
            while station.process.poll() is None:
                station.process.send_signal(signal.SIGINT)
                answer = httpx.post(stop, json={}, timeout=NET, trust_env=False).json()
                assert "did not answer" not in answer["note"], "it ended, and STOP was told that it hangs"
        assert station.end() == 0
        assert not control.is_running()
        assert "every axis is stopped" in station.said.read_text()
    assert not any(path.exists() for path in used)
    done, refused = (
        {entry["what"]: entry["time"] for line in (data / log).read_text().splitlines() if (entry := json.loads(line))}
        for log in ("audit.jsonl", "refused.jsonl")
    )
    # A control process that acknowledges the stop too slowly is ended, and then reports no state.
    assert done.get("state STOPPED", "") <= refused["POST /api/tare {"]


def test_axes_without_a_confirmed_stop_are_not_reported_as_stopped() -> None:
    with serving() as station:
        station.ready()
        for name in ("ctr-lab", "ctr-control"):
            station.child(name).send_signal(signal.SIGSTOP)
        assert station.end(by=signal.SIGTERM) == 1
        said = station.said.read_text()
        assert "every axis is stopped" not in said
        assert "press the emergency stop" in said
