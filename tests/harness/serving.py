"""A live station for tests: `ctr-station serve` in a separate process, on a free port."""

import math
import re
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

from station.client import STARTING
from tests.harness.calm import RATE, SETTINGS
from tests.harness.children import children
from tests.harness.root import ROOT
from tests.harness.waiting import NET, until

#: Usual pose of the preset robot, and how far a test may leave it before the next test returns to it [rad, m]. Tests of
#: motions from the current pose expect that they are possible.
USUAL_POSE = {"outer_rotation": (0.0, 0.2), "inner_rotation": (0.5 * math.pi, 0.2), "inner_translation": (-0.1, 0.02)}


class Served:
    """Handle of a running station."""

    def __init__(self, process: "subprocess.Popen[bytes]", port: int, tokens: list[str], said: Path) -> None:
        self.process = process
        self.said = said  #: file with the output of the station's terminal
        self.port = port
        self.url = f"http://127.0.0.1:{port}"
        self.tokens = tokens  #: tokens of viewers and of operators, in this order; empty on loopback
        headers = {"authorization": f"Bearer {tokens[-1]}"} if tokens else {}
        self.rest = httpx.Client(base_url=self.url, timeout=NET, headers=headers)

    def status(self) -> dict[str, Any]:
        answer = self.rest.get("/api/status")
        assert answer.status_code == 200, answer.text
        return answer.json()

    def post(self, path: str, body: Any = None) -> httpx.Response:
        return self.rest.post(path, json={} if body is None else body)

    def wait_for(self, what: Any) -> dict[str, Any]:
        """Poll the status until `what(status)` is true, and return it."""
        status: dict[str, Any] = {}

        def holds() -> bool:
            status.clear()
            status.update(self.status())
            return what(status)

        until(holds, status)
        return status

    def ready(self) -> None:
        """Return the station to READY and without an operator, whatever its state is."""
        self.rest.post("/api/operator", json={"take_over": True})
        if (state := self.status()["state"]) == "RUNNING":
            self.post("/api/stop")
        elif state == "OFF":
            self.post("/api/connect")
        self.rest.delete("/api/faults")
        self.post("/api/load", {"load": {"kind": "none"}})  # an obstacle of the lab stays after its run
        if self.status()["state"] in ("STOPPED", "HOLD", "FAULT"):
            self.post("/api/reset")
        status = self.wait_for(lambda status: status["state"] in ("READY", "CONNECTED") and not status["stale"])
        if status["state"] == "CONNECTED":
            self.post("/api/home", {"way_is_clear": True})
            self._while_homing()
        status = self.wait_for(lambda status: status["state"] == "READY" and not status["stale"])
        if any(abs(status["joints"][name] - usual) > far for name, (usual, far) in USUAL_POSE.items()):
            self._go_to_the_usual_pose()
        self.rest.delete("/api/operator")

    def _while_homing(self) -> None:
        """Wait while the homing makes progress, without a limit: a rotation below its zero turns once more and back."""
        while (status := self.status())["state"] == "HOMING":
            self.wait_for(lambda now, before=status["message"]: now["message"] != before)

    def _go_to_the_usual_pose(self) -> None:
        """Move the robot to the usual pose, for example after homing, by an experiment that starts there."""
        until(lambda: self.post("/api/start", {"experiment": "fig7"}).status_code == 202)  # once the force has decayed
        self.wait_for(lambda status: status["phase"] in ("settling", "moving"))
        self.post("/api/stop")
        self.post("/api/reset")
        self.wait_for(lambda status: status["state"] == "READY")

    def rest_of_joints(self) -> list[float]:
        """Wait until the joints have not moved for half a second of the loop, and return their positions."""
        seen: list[float] = []
        since = 0

        def rests(status: dict[str, Any]) -> bool:
            nonlocal seen, since
            joints, ticks = list(status["joints"].values()), status["loop"]["ticks"]
            if joints != seen or status["stale"]:
                seen, since = joints, ticks
            return ticks - since >= 250

        self.wait_for(rests)
        return seen

    def child(self, name: str) -> psutil.Process:
        """Return the station's child process that the system lists as `name`, for example ctr-control."""
        return until(lambda: children(self.process.pid, name), name)[0]  # a process has its name only after its start

    def control_process(self) -> psutil.Process:
        """Return the child process that runs the control loop."""
        return self.child("ctr-control")

    def end(self, by: signal.Signals = signal.SIGINT) -> int:
        """End the station by Ctrl-C or another signal; return its exit status."""
        self.rest.close()
        if self.process.poll() is None:
            self.process.send_signal(by)
        return self.process.wait(NET)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def shared_memory(process: int) -> set[Path]:
    """Return the files of the shared memory that a process uses."""
    lines = Path(f"/proc/{process}/maps").read_text(encoding="utf-8").splitlines()
    return {Path(line.split()[-1]) for line in lines if "/dev/shm/psm_" in line}


def calm(rate: float, settings: str = "") -> str:
    """Return the text of a station file with the given settings, and with settings that tolerate a busy computer."""
    tables = SETTINGS | {"clock": {**SETTINGS["clock"], "rate": rate}}
    # The control loop has no reserved processor, because the other stations would then share the remaining ones.
    return (
        "own_core = false\n"
        + settings
        + "".join(
            f"[{table}]\n" + "".join(f"{key} = {value}\n" for key, value in keys.items())
            for table, keys in tables.items()
        )
    )


@contextmanager
def serving(*arguments: str, settings: str = "", rate: float | None = RATE, connected: bool = True) -> Iterator[Served]:
    """Yield a running station with the given settings in its station file.

    The station's clock runs at `rate` times real time, and the settings tolerate a busy computer. If `rate` is None,
    the clock is real time, and the settings are as strict as on a bench. With `connected` the station's devices are
    connected.
    """
    # The station chooses its port: a port that is free now may be taken before the station listens.
    command = [sys.executable, "-c", "from web.cli import main; main()", "serve", "--no-browser", "--port", "0"]
    with tempfile.TemporaryDirectory() as data, Path(data, "said.txt").open("w+", encoding="utf-8") as said:
        config = Path(data, "station.toml")
        config.write_text(settings if rate is None else calm(rate, settings), encoding="utf-8")
        # The output goes to a file, because a pipe that is not read would block the station when it is full.
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
            (port,) = re.findall(r"ctr-station is at http\S*:(\d+)/", text)
            served = Served(process, int(port), tokens, Path(said.name))
            _until_answering(served, connected)
            yield served
            text = Path(said.name).read_text()
            assert "Traceback (most recent call last)" not in text, text[-4000:]
        finally:
            if served is not None:
                served.end()
            else:
                process.kill()
                process.wait()


def _until_started(process: "subprocess.Popen[bytes]", said: Path) -> str:
    while "(Ctrl-C stops it)" not in (text := said.read_text()):  # the end of the line with the address
        assert process.poll() is None, f"the station did not start: {text}"
        time.sleep(0.05)
    return text


def _until_answering(served: Served, connected: bool) -> None:
    def answers() -> bool:
        try:
            return served.status()["state"] not in STARTING or not connected
        except httpx.TransportError:
            return False

    until(answers)
