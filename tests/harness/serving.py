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

from tests.harness.calm import RATE, SETTINGS
from tests.harness.root import ROOT
from tests.harness.waiting import NET, until


class Served:
    """A running station."""

    def __init__(self, process: "subprocess.Popen[bytes]", port: int, tokens: list[str], said: Path) -> None:
        self.process = process
        self.said = said  #: what it has written to its terminal
        self.port = port
        self.url = f"http://127.0.0.1:{port}"
        self.tokens = tokens  #: the viewers', then the operators'; none on loopback
        headers = {"authorization": f"Bearer {tokens[-1]}"} if tokens else {}
        self.rest = httpx.Client(base_url=self.url, timeout=NET, headers=headers)

    def status(self) -> dict[str, Any]:
        answer = self.rest.get("/api/status")
        assert answer.status_code == 200, answer.text
        return answer.json()

    def post(self, path: str, body: Any = None) -> httpx.Response:
        return self.rest.post(path, json={} if body is None else body)

    def wait_for(self, what: Any) -> dict[str, Any]:
        """The first status for which `what(status)` holds."""
        status: dict[str, Any] = {}

        def holds() -> bool:
            status.clear()
            status.update(self.status())
            return what(status)

        until(holds, status)
        return status

    def ready(self) -> None:
        """READY and without an operator, whatever came before."""
        self.rest.post("/api/operator", json={"take_over": True})
        if (state := self.status()["state"]) == "RUNNING":
            self.post("/api/stop")
        elif state == "OFF":
            self.post("/api/connect")
        self.rest.delete("/api/faults")
        if self.status()["state"] in ("STOPPED", "HOLD", "FAULT"):
            self.post("/api/reset")
        status = self.wait_for(lambda status: status["state"] in ("READY", "CONNECTED") and not status["stale"])
        if status["state"] == "CONNECTED":
            self.post("/api/home", {"way_is_clear": True})
        status = self.wait_for(lambda status: status["state"] == "READY" and not status["stale"])
        if abs(status["joints"]["inner_translation"] + 0.1) > 0.02:
            self._go_to_the_usual_pose()
        self.rest.delete("/api/operator")

    def _go_to_the_usual_pose(self) -> None:
        """By the way to an experiment's start, for instance after homing."""
        assert self.post("/api/start", {"experiment": "fig7"}).status_code == 202
        self.wait_for(lambda status: status["phase"] in ("settling", "moving"))
        self.post("/api/stop")
        self.post("/api/reset")
        self.wait_for(lambda status: status["state"] == "READY")

    def child(self, name: str) -> psutil.Process:
        """Its child that is listed under that name: ctr-control, ctr-lab, ctr-recorder."""
        for child in psutil.Process(self.process.pid).children():
            if child.name() == name:
                return child
        raise AssertionError(f"there is no {name}")

    def control_process(self) -> psutil.Process:
        """The child that runs the loop."""
        return self.child("ctr-control")

    def end(self, by: signal.Signals = signal.SIGINT) -> int:
        """Ctrl-C, or another signal; the exit status."""
        self.rest.close()
        if self.process.poll() is None:
            self.process.send_signal(by)
        return self.process.wait(NET)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def shared_memory(process: int) -> set[Path]:
    """That this process uses."""
    lines = Path(f"/proc/{process}/maps").read_text(encoding="utf-8").splitlines()
    return {Path(line.split()[-1]) for line in lines if "/dev/shm/psm_" in line}


def calm(rate: float, settings: str = "") -> str:
    """A station's file with these settings, and with what lets it bear a busy computer."""
    tables = SETTINGS | {"clock": {**SETTINGS["clock"], "rate": rate}}
    # No processor of its own: the other stations on this computer would crowd on what is left.
    return (
        "own_core = false\n"
        + settings
        + "".join(
            f"[{table}]\n" + "".join(f"{key} = {value}\n" for key, value in keys.items())
            for table, keys in tables.items()
        )
    )


@contextmanager
def serving(*arguments: str, settings: str = "", rate: float | None = RATE) -> Iterator[Served]:
    """A station with these settings of its file.

    Its clock goes at `rate` and it bears a busy computer; None: in real time, as strict as a bench's.
    """
    port = free_port()
    command = [sys.executable, "-c", "from web.cli import main; main()", "serve", "--no-browser", "--port", str(port)]
    with tempfile.TemporaryDirectory() as data, Path(data, "said.txt").open("w+", encoding="utf-8") as said:
        config = Path(data, "station.toml")
        config.write_text(settings if rate is None else calm(rate, settings), encoding="utf-8")
        # Into a file: a pipe that nobody empties would stop a station that has much to say.
        process = subprocess.Popen(
            [*command, "--config", str(config), "--data", data, *arguments],
            stdout=said,
            stderr=subprocess.STDOUT,
            cwd=ROOT,
        )
        served = None
        try:
            text = _until_started(process, Path(said.name))
            tokens = [line.split("?token=")[1].split()[0] for line in text.splitlines() if "?token=" in line]
            served = Served(process, port, tokens, Path(said.name))
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
    def answers() -> bool:
        try:
            return bool(served.status())
        except httpx.TransportError:
            return False

    until(answers)
