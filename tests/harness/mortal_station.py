"""A station on a watched lab, started by a shell in a terminal, that a test ends in any way.

The station is `ctr-station serve`, with the devices of the lab in its station file, as at a practice bench.
"""

import fcntl
import json
import os
import re
import select
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import psutil
from websockets.sync.client import connect

from station.lab.lab_server import devices_at
from tests.harness.calm import CLOCK
from tests.harness.root import ROOT
from tests.harness.waiting import NET, until
from tests.harness.watched_lab import WatchedLab

SERVE = "from web.cli import main; main()"
#: The processes of the station beside its own; the system lists them as ctr-NAME.
HELPERS = ("control", "guard", "recorder", "gateway")


class MortalStation:
    """Handle of the station, of its shell and of its terminal."""

    def __init__(self, shell: "subprocess.Popen[bytes]", terminal: int, said: Path, lab: WatchedLab) -> None:
        self.shell, self.lab, self._terminal, self._said = shell, lab, terminal, said
        self._closed = threading.Event()
        self._reading = threading.Thread(target=self._read, name="terminal", daemon=True)
        self._reading.start()
        (address,) = until(lambda: re.findall(r"ctr-station is at (http\S*?)/?\s", self.said()), "address")
        self.rest = httpx.Client(base_url=address, timeout=NET)
        self.url = address
        (self.parent,) = psutil.Process(shell.pid).children()
        (self.station,) = self.parent.children()
        self.processes: dict[str, psutil.Process] = {"station": self.station}
        for name in HELPERS:
            self.processes[name] = until(lambda name=name: self._child(f"ctr-{name}"), name)

    def _child(self, name: str) -> psutil.Process | None:
        with suppress(psutil.NoSuchProcess):
            return next((child for child in self.station.children() if child.name() == name), None)
        return None

    def said(self) -> str:
        """Return what the terminal has shown."""
        return self._said.read_text(encoding="utf-8", errors="replace")

    def _read(self) -> None:
        with self._said.open("ab", buffering=0) as file, suppress(OSError):
            while not self._closed.is_set():
                if select.select([self._terminal], [], [], 0.05)[0]:  # a read that waits would keep the terminal open
                    file.write(os.read(self._terminal, 4096))

    def press(self, key: bytes) -> None:
        """Press a key at the terminal."""
        os.write(self._terminal, key)

    def close_terminal(self) -> None:
        """Close the window of the terminal."""
        if not self._closed.is_set():
            self._closed.set()
            self._reading.join()
            os.close(self._terminal)

    def signal_group(self, number: int) -> None:
        """Send a signal to the group of the terminal's foreground processes."""
        os.killpg(os.getpgid(self.station.pid), number)

    def signal(self, number: int, *names: str) -> None:
        """Send a signal to the processes with these names, all within a moment."""
        for name in names:
            os.kill(self.processes[name].pid, number)

    def status(self) -> dict[str, Any]:
        return self.rest.get("/api/status").json()

    def becomes(self, state: str) -> None:
        """Wait for a state."""
        until(lambda: self.status()["state"] == state, state)

    def in_phase_moving(self) -> bool:
        """Return whether the motion itself is executed, after the stages have rested; fail in HOLD, with the cause."""
        now = self.status()
        assert now["state"] != "HOLD", now["cause"]
        return now["phase"] == "moving"

    def ends_by(self, cause: str) -> None:
        """Wait for HOLD by a cause, which the station learns shortly after the state."""
        until(lambda: (now := self.status())["state"] == "HOLD" and now["cause"].startswith(cause), cause)

    def said_soon(self, text: str) -> None:
        """Wait until the terminal shows a text."""
        until(lambda: text in self.said(), text)

    def end(self) -> None:
        """End whatever is left of the station."""
        self.rest.close()
        every = [*self.processes.values(), self.parent]
        for process in every:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        self.shell.kill()
        self.shell.wait()
        self.close_terminal()
        psutil.wait_procs(every, timeout=NET)


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(str(k))} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


@contextmanager
def mortal_station(lab: WatchedLab, folder: Path) -> Iterator[MortalStation]:
    """Yield a station that is READY on a lab, in a terminal of its own."""
    patient = replace(lab.clock, patience=CLOCK.patience)  # a busy computer keeps simulated devices silent
    devices = devices_at(lab.endpoints, lab.config, patient).model_dump(exclude_none=True)
    settings = "own_core = false\nfifo = false\n[overruns]\nhold_in_a_row = 1000\nhold_share = 1.0\n"
    settings += "fault_in_a_row = 5000\n[devices]\n" + "".join(
        f"{kind} = {_toml(table)}\n" for kind, table in devices.items()
    )
    config, said = folder / "station.toml", folder / "said.txt"
    config.write_text(settings, encoding="utf-8")
    said.touch()
    command = [
        sys.executable, "-c", SERVE, "serve", "--no-browser", "--port", "0", "--config", str(config),
        "--data", str(folder), "--igtl", "127.0.0.1:0",
    ]  # fmt: skip
    terminal, end = os.openpty()

    def own_terminal() -> None:
        os.setsid()
        fcntl.ioctl(end, termios.TIOCSCTTY, 0)

    # A shell leads the session, and a second one is the station's parent. A shell replaces itself by its last command.
    # The first shell then waits for the terminal, because the end of a session ends its foreground processes.
    leader, parent = (["sh", "-c", f'"$@"; {then}', "sh"] for then in ("read _", ":"))
    shell = subprocess.Popen(
        [*leader, *parent, *command], stdin=end, stdout=end, stderr=end, cwd=ROOT, preexec_fn=own_terminal
    )
    os.close(end)
    station = MortalStation(shell, terminal, said, lab)
    try:
        station.becomes("READY")
        yield station
    finally:
        station.end()


# Ways to move


def _start(station: MortalStation, experiment: str) -> None:
    answer = station.rest.post("/api/start", json={"experiment": experiment})
    assert answer.status_code == 202, answer.text


def jog(station: MortalStation) -> None:
    answer = station.rest.post("/api/jog", json={"space": "joints", "velocity": [0.3, 0.0, 0.0]})
    assert answer.status_code < 300, answer.text


def stream(station: MortalStation) -> None:
    """Stream setpoints from a thread for as long as the station accepts them."""
    opened = threading.Event()

    def send() -> None:
        with suppress(Exception), connect(f"{station.url.replace('http', 'ws')}/api/setpoints", proxy=None) as client:
            client.send(json.dumps({"frame": "start"}))
            while not json.loads(client.recv()).get("ready"):
                pass
            opened.set()
            began = time.monotonic()
            while True:
                client.send(json.dumps({"position": [0.0, 0.0, 0.004 * (time.monotonic() - began)]}))
                time.sleep(0.02)

    threading.Thread(target=send, daemon=True).start()
    assert opened.wait(NET)


def home(station: MortalStation) -> None:
    answer = station.rest.post("/api/home", json={"way_is_clear": True})
    assert answer.status_code < 300, answer.text


def calibration(station: MortalStation) -> None:
    answer = station.rest.post("/api/calibration/start", json={"what": "tracker", "effort": 0.5, "way_is_clear": True})
    assert answer.status_code == 202, answer.text


#: Experiments for the motions that are runs.
EXPERIMENTS = {"motion": "demo", "follow": "follow", "force": "touch"}
MOTIONS: Mapping[str, Callable[[MortalStation], None]] = {
    **{motion: partial(_start, experiment=name) for motion, name in EXPERIMENTS.items()},
    "jog": jog,
    "stream": stream,
    "homing": home,
    "calibration": calibration,
}


def moving(station: MortalStation, motion: str) -> float:
    """Start a motion, wait until the stages have moved for a while and still move; return the time then [s]."""
    MOTIONS[motion](station)
    if motion in EXPERIMENTS:  # the stages rest before the motion itself
        until(station.in_phase_moving, "phase")
    first, clock = station.lab.last_step(), station.lab.clock

    def moves() -> bool:
        if motion == "jog":
            jog(station)  # one request lasts 0.3 s
        last = station.lab.last_step()
        return last > first + 0.2 and clock.now() - last < 0.05

    until(moves, f"motion of a {motion}")
    return clock.now()
