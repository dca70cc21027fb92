"""A station without a web server, as a process for tests: `python -m tests.harness.lone_station FOLDER [ENDPOINTS]`.

It answers each line of its input with a line of JSON: `start`, `stop`, `home`, `reset` and
`status`; it ends with its input.
"""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil

from core.errors import CtrError
from station.desk import Desk
from station.lab.live_bench import lab_bench
from station.station_file import load_station
from station.supervisor import Supervisor
from tests.harness.root import ROOT


class LoneStation:
    """The test's side."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self.process = process

    def ask(self, what: str) -> dict[str, Any]:
        """Its answer."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{what}\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def child(self, name: str) -> psutil.Process:
        """Its child that is listed as ctr-NAME."""
        (found,) = [c for c in psutil.Process(self.process.pid).children() if c.name() == f"ctr-{name}"]
        return found

    def end(self) -> None:
        """Close its input; it ends by itself."""
        if self.process.stdin is not None:
            self.process.stdin.close()
        self.process.wait(20.0)
        if self.process.stdout is not None:
            self.process.stdout.close()


@contextmanager
def lone_station(folder: Path, endpoints: Any = None) -> Iterator[LoneStation]:
    """One that is READY: on the devices at `endpoints`, or on a virtual lab of its own."""
    command = [sys.executable, "-m", "tests.harness.lone_station", str(folder)]
    if endpoints is not None:
        command.append(json.dumps(endpoints))
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    station = LoneStation(process)
    try:
        assert station.ask("status")["state"] == "READY"
        yield station
    finally:
        station.end()


def main() -> None:
    """The station's side."""
    bench = load_station(None).bench()
    if len(sys.argv) > 2:
        bench = replace(bench, devices=lab_bench(json.loads(sys.argv[2]), bench.lab))
    supervisor = Supervisor(bench, Path(sys.argv[1]))
    try:
        supervisor.wait_ready(120.0)
        _settled(supervisor)
        desk = Desk(supervisor)
        for line in sys.stdin:
            sys.stdout.write(f"{json.dumps(_answer(supervisor, desk, line.strip()))}\n")
            sys.stdout.flush()
    finally:
        supervisor.close()


def _settled(supervisor: Supervisor) -> None:
    while supervisor.status().state.name in ("CONNECTING", "CONNECTED", "HOMED"):
        time.sleep(0.02)


def _answer(supervisor: Supervisor, desk: Desk, what: str) -> dict[str, Any]:
    refused = ""
    try:
        match what:
            case "start":
                desk.start_experiment("demo")  # from its start pose, wherever the robot is now
            case "stop":
                supervisor.stop()
            case "reset":
                supervisor.reset()
                _settled(supervisor)
            case "home":
                supervisor.home()
    except CtrError as error:
        refused = str(error)
    status, recording = supervisor.status(), supervisor.recording
    return {
        "state": status.state.name,
        "phase": status.phase.name,
        "cause": status.cause,
        "run": status.run,
        "refused": refused,
        "recovered": [path.name for path in recording.recovered] if recording else [],
    }


if __name__ == "__main__":
    main()
