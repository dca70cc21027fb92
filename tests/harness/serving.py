"""A real station for tests: `ctr-station serve` in a process of its own, on a free port."""

import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import psutil

from tests.harness.root import ROOT


class Served:
    """A running station."""

    def __init__(self, process: "subprocess.Popen[bytes]", port: int, tokens: list[str]) -> None:
        self.process = process
        self.port = port
        self.url = f"http://127.0.0.1:{port}"
        self.tokens = tokens  #: the viewers', then the operators'; none on loopback
        headers = {"authorization": f"Bearer {tokens[-1]}"} if tokens else {}
        self.rest = httpx.Client(base_url=self.url, timeout=10.0, headers=headers)

    def status(self) -> dict[str, Any]:
        answer = self.rest.get("/api/status")
        assert answer.status_code == 200, answer.text
        return answer.json()

    def post(self, path: str, body: Any = None) -> httpx.Response:
        return self.rest.post(path, json={} if body is None else body)

    def wait_for(self, what: Any, timeout: float) -> dict[str, Any]:
        """The first status for which `what(status)` holds."""
        deadline = time.monotonic() + timeout
        while True:
            status = self.status()
            if what(status):
                return status
            assert time.monotonic() < deadline, f"not within {timeout} s: {status}"
            time.sleep(0.02)

    def ready(self) -> None:
        """READY and without an operator, whatever came before."""
        self.rest.post("/api/operator", json={"take_over": True})
        if self.status()["state"] == "RUNNING":
            self.post("/api/stop")
        if self.status()["state"] in ("STOPPED", "HOLD", "FAULT"):
            self.post("/api/reset")
        status = self.wait_for(lambda status: status["state"] in ("READY", "CONNECTED") and not status["stale"], 20.0)
        if status["state"] == "CONNECTED":
            self.post("/api/home", {"way_is_clear": True})
        status = self.wait_for(lambda status: status["state"] == "READY" and not status["stale"], 100.0)
        if abs(status["joints"]["inner_translation"] + 0.1) > 0.02:
            self._go_to_the_usual_pose()
        self.rest.delete("/api/operator")

    def _go_to_the_usual_pose(self) -> None:
        """By the way to an experiment's start, for instance after homing."""
        assert self.post("/api/start", {"experiment": "fig7"}).status_code == 202
        self.wait_for(lambda status: status["phase"] in ("settling", "moving"), 40.0)
        self.post("/api/stop")
        self.post("/api/reset")
        self.wait_for(lambda status: status["state"] == "READY", 10.0)

    def child(self, name: str) -> psutil.Process:
        """Its child that is listed under that name: ctr-control, ctr-lab, ctr-recorder."""
        for child in psutil.Process(self.process.pid).children():
            if child.name() == name:
                return child
        raise AssertionError(f"there is no {name}")

    def control_process(self) -> psutil.Process:
        """The child that runs the loop."""
        return self.child("ctr-control")

    def end(self) -> int:
        """Ctrl-C; the exit status."""
        self.rest.close()
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.process.wait(15.0)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def shared_memory() -> set[str]:
    folder = Path("/dev/shm")
    return {path.name for path in folder.glob("psm_*")}


#: Other tests' browsers take the time of a computer that a bench would have for itself.
PATIENT = "[overruns]\nhold_in_a_row = 1000\nhold_share = 1.0\nfault_in_a_row = 5000\n"


@contextmanager
def serving(*arguments: str) -> Iterator[Served]:
    """A station that bears a busy computer, unless it is given a configuration."""
    port = free_port()
    command = [sys.executable, "-c", "from web.cli import main; main()", "serve", "--no-browser", "--port", str(port)]
    with tempfile.TemporaryDirectory() as data, Path(data, "said.txt").open("w+", encoding="utf-8") as said:
        if "--config" not in arguments:
            config = Path(data, "patient.toml")
            config.write_text(PATIENT, encoding="utf-8")
            arguments = ("--config", str(config), *arguments)
        # Into a file: a pipe that nobody empties would stop a station that has much to say.
        process = subprocess.Popen(
            [*command, "--data", data, *arguments],
            stdout=said,
            stderr=subprocess.STDOUT,
            cwd=ROOT,
        )
        served = None
        try:
            text = _until_started(process, Path(said.name))
            tokens = [line.split("?token=")[1].split()[0] for line in text.splitlines() if "?token=" in line]
            served = Served(process, port, tokens)
            _until_answering(served)
            yield served
            text = Path(said.name).read_text()
            # A page's request that is cut off by the end of the server is told as a traceback, too.
            tracebacks = text.split("Traceback (most recent call last)")[1:]
            assert all("timeout graceful shutdown exceeded" in each for each in tracebacks), text[-4000:]
        finally:
            if served is not None:
                served.end()
            else:
                process.kill()
                process.wait()


def _until_started(process: "subprocess.Popen[bytes]", said: Path) -> str:
    while "is at http" not in (text := said.read_text()):
        assert process.poll() is None, f"the station did not start: {text}"
        time.sleep(0.05)
    return text


def _until_answering(served: Served) -> None:
    deadline = time.monotonic() + 10.0
    while True:
        try:
            served.status()
            break
        except httpx.TransportError:
            assert time.monotonic() < deadline
            time.sleep(0.05)
