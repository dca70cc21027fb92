"""From the first to the last: start, busy ports, ends of every kind."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil
from websockets.sync.client import connect

from tests.harness.root import ROOT
from tests.harness.serving import serving, shared_memory

SERVE = [sys.executable, "-c", "from web.cli import main; main()", "serve", "--no-browser"]


def _serve(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([*SERVE, *arguments], capture_output=True, text=True, timeout=60, cwd=ROOT, check=False)


def test_a_busy_port_is_named() -> None:
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 0))
        busy.listen()
        port = busy.getsockname()[1]
        ended = _serve("--port", str(port))
    assert ended.returncode == 2
    assert str(port) in ended.stderr
    assert "--port" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


def test_a_bad_configuration_is_refused_before_anything_starts(tmp_path: Path) -> None:
    file = tmp_path / "station.toml"
    file.write_text("[park]\nouter_rotation = 0.0\ninner_rotation = 0.0\ninner_translation = -0.5\n")
    ended = _serve("--config", str(file), "--port", "0")
    assert ended.returncode == 2
    assert "inner_translation" in ended.stderr
    assert "-0.13" in ended.stderr
    file.write_text("robott = 'paper'\n")
    assert "robott" in _serve("--config", str(file)).stderr


def test_ctrl_c_with_clients_connected_leaves_nothing_behind() -> None:
    before = shared_memory()
    with serving() as station:
        control = station.control_process()
        address = f"ws://127.0.0.1:{station.port}"
        with connect(f"{address}/api/telemetry", proxy=None) as telemetry:
            telemetry.recv(timeout=2.0)
            assert station.end() == 0
        assert not control.is_running()
    assert shared_memory() <= before


def test_the_control_process_ends_when_the_station_process_is_killed() -> None:
    before = shared_memory()
    with serving() as station:
        station.ready()
        body = {"trajectory": {"kind": "sinusoid", "amplitude": 0.01, "frequency": 0.2}, "duration": 60.0}
        assert station.post("/api/start", body).status_code == 202
        station.wait_for(lambda s: s["run"]["phase"] == "moving")
        control = station.control_process()
        os.kill(station.process.pid, signal.SIGKILL)
        killed = time.monotonic()
        while control.is_running() and control.status() != psutil.STATUS_ZOMBIE:
            assert time.monotonic() - killed < 5.0
            time.sleep(0.005)
    deadline = time.monotonic() + 5.0
    while not shared_memory() <= before:
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_killed_control_process_is_a_fault_at_once_and_a_reset_starts_a_new_one() -> None:
    with serving() as station:
        killed = station.control_process()
        killed.kill()
        status = station.wait_for(lambda s: s["state"] == "FAULT")
        assert "signal 9" in status["cause"]
        station.wait_for(lambda s: s["stale"])
        stopped = station.post("/api/stop")  # nobody is there to carry it out: taken, with words
        assert stopped.status_code in (200, 202)
        assert stopped.json()["state"] == "FAULT"
        assert station.post("/api/start", {"trajectory": {"kind": "hold"}}).status_code == 409
        assert station.post("/api/reset").json()["state"] == "READY"
        assert station.control_process().pid != killed.pid
        assert station.post("/api/start", {"trajectory": {"kind": "hold"}, "duration": 0.5}).status_code == 202
        station.wait_for(lambda s: s["state"] == "READY" and s["run"]["id"] != "")
