"""A station process without a web server: `python -m tests.harness.lone_station FOLDER RATE ENDPOINTS`.

The process answers each line of its input with a line of JSON. The lines are `start`, `stop`, `home`, `reset`, `gone`
(the operator has disconnected), `busy` (one thread keeps the interpreter's lock for a while) and `status`. The process
ends when its input ends.
"""

import ctypes
import hashlib
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil

from core.errors import CtrError
from station.control.clock import StationClock
from station.lab.lab_server import devices_at
from station.service.commands import Home, Start
from station.service.station_file import load_station
from station.service.supervisor import Supervisor
from tests.harness.calm import CLOCK, SETTINGS
from tests.harness.children import children
from tests.harness.root import ROOT
from tests.harness.waiting import NET, until
from tests.harness.watched_lab import WatchedLab


class LoneStation:
    """The test's side: a handle of the station process."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self.process = process

    def ask(self, what: str) -> dict[str, Any]:
        """Send one line to the station and return its answer."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{what}\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def child(self, name: str) -> psutil.Process:
        """Return the station's child process that the system lists as ctr-NAME."""
        (found,) = until(lambda: children(self.process.pid, f"ctr-{name}"), name)  # named only after its start
        return found

    def end(self) -> None:
        """Close the station's input, so that the process ends, and wait for it."""
        if self.process.stdin is not None:
            self.process.stdin.close()
        self.process.wait(NET)
        if self.process.stdout is not None:
            self.process.stdout.close()


@contextmanager
def lone_station(
    folder: Path, lab: WatchedLab | None = None, clock: StationClock = CLOCK, stages: Mapping[str, Any] | None = None
) -> Iterator[LoneStation]:
    """Yield a station that is READY, on a watched lab with its clock or on its own virtual lab.

    `stages` replaces `[devices.stages]` of the station file; tracker and sensors still belong to the lab.
    """
    rate, endpoints = (clock.rate, None) if lab is None else (lab.clock.rate, lab.endpoints)
    setup = json.dumps({"lab": endpoints, "stages": stages})
    command = [sys.executable, "-m", "tests.harness.lone_station", str(folder), str(rate), setup]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    station = LoneStation(process)
    try:
        assert station.ask("status")["state"] == "READY"
        yield station
    finally:
        station.end()


def main() -> None:
    """Run the station's side: execute the lines of the input."""
    folder, rate, setup = sys.argv[1], float(sys.argv[2]), json.loads(sys.argv[3])
    # A fifth of the periods in 10 s must be late to cause HOLD: other programs delay fewer, and a test can delay so
    # many.
    calm = {"overruns": {**SETTINGS["overruns"], "hold_share": 0.2}}
    bench = load_station(None, calm if rate < 1.0 else {}).bench()
    clock = CLOCK if rate == CLOCK.rate else StationClock(rate)
    bench = replace(bench, clock=clock, on_operator_loss="hold")
    if setup["lab"] is not None:
        devices = devices_at(setup["lab"], bench.lab, clock)
        changed = {} if setup["stages"] is None else {"stages": setup["stages"]}
        bench = replace(bench, devices=devices.model_copy(update=changed))
    supervisor = Supervisor(bench, Path(folder))
    try:
        supervisor.open()
        supervisor.wait_ready(NET)
        _settled(supervisor)
        for line in sys.stdin:
            sys.stdout.write(f"{json.dumps(_answer(supervisor, line.strip()))}\n")
            sys.stdout.flush()
    finally:
        supervisor.close()


def _keep_the_lock(seconds: float) -> None:
    """Keep the interpreter's lock for `seconds`, while a thread that needs no lock works even longer."""
    works = threading.Thread(target=hashlib.pbkdf2_hmac, args=("sha256", b"", b"", 10_000_000), daemon=True)
    works.start()
    time.sleep(0.1)
    ctypes.PyDLL(None).usleep(int(1e6 * seconds))


def _settled(supervisor: Supervisor) -> None:
    while supervisor.status().state.name in ("CONNECTING", "CONNECTED", "HOMED"):
        time.sleep(0.02)


def _answer(supervisor: Supervisor, what: str) -> dict[str, Any]:
    refused = note = ""
    try:
        match what:
            case "start":
                supervisor.send(Start(experiment="demo"))  # the demo first goes to its start pose
            case "stop":
                note = supervisor.stop().text
            case "reset":
                note = supervisor.reset()
                _settled(supervisor)
            case "home":
                supervisor.send(Home(way_is_clear=True, then_working_pose=False))
            case "gone":
                supervisor.operator_gone()
            case "busy":
                _keep_the_lock(supervisor.bench.clock.real(1.3))
    except CtrError as error:
        refused = str(error)
    status = supervisor.status()
    return {
        "state": status.state.name,
        "phase": status.phase.name,
        "cause": status.cause,
        "details": status.details,
        "run": "" if status.run is None else status.run.id,
        "refused": refused,
        "note": note,
        "recovered": [path.name for path in supervisor.runs.recorder.recovered],
    }


if __name__ == "__main__":
    main()
